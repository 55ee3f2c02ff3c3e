"""Flights that are steered step by step, and what may happen to them on command."""

from alight_sim.steered.bodies import Body
from alight_sim.steered.flight import NIMBLE, Battery, SteeredFlight, TrueContact

__all__ = ["NIMBLE", "Battery", "Body", "SteeredFlight", "TrueContact"]
