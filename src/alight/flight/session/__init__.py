"""A landing that is flown: the live lanes, the executive, and an autopilot that takes its orders."""

from alight.flight.session.flight import FlightOutcome, FlightRequest, FlightStatus, fly_vehicle
from alight.flight.session.pilot import LandingPilot

__all__ = ["FlightOutcome", "FlightRequest", "FlightStatus", "LandingPilot", "fly_vehicle"]
