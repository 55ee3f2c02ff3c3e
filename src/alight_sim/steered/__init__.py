"""Flights that are steered step by step, with disturbances and faults on command."""

from alight_sim.point_mass import FlightLimits, Wanted
from alight_sim.steered.bodies import Body
from alight_sim.steered.flight import NIMBLE, FlownEstimate, SteeredFlight, TrueBattery
from alight_sim.steered.ground import TrueContact

__all__ = ["NIMBLE", "Body", "FlightLimits", "FlownEstimate", "SteeredFlight", "TrueBattery", "TrueContact", "Wanted"]
