"""Flights that are steered step by step, with disturbances and faults on command."""

from alight_sim.point_mass import FlightLimits, Wanted
from alight_sim.steered.bodies import Body
from alight_sim.steered.flight import NIMBLE, SteeredFlight, TrueBattery, TrueContact

__all__ = ["NIMBLE", "Body", "FlightLimits", "SteeredFlight", "TrueBattery", "TrueContact", "Wanted"]
