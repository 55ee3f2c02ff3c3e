"""A flight as it comes: three lanes as processes, and the threads that feed them."""

from alight.runner.live.health import FlightHealth, LaneState
from alight.runner.live.live import Capacity, Listener, Live

__all__ = ["Capacity", "FlightHealth", "LaneState", "Listener", "Live"]
