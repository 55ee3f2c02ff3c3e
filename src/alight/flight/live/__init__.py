"""A live run: three lanes as processes, and the threads that feed them."""

from alight.flight.live.health import FlightHealth, LaneState
from alight.flight.live.interface import Capacity, Listener
from alight.flight.live.live import Live

__all__ = ["Capacity", "FlightHealth", "LaneState", "Listener", "Live"]
