"""A live run: three lanes as processes, and the threads that feed them."""

from alight.runner.live.health import FlightHealth, LaneState
from alight.runner.live.interface import Capacity, Listener
from alight.runner.live.live import Live

__all__ = ["Capacity", "FlightHealth", "LaneState", "Listener", "Live"]
