"""Feature tracks: frames to features followed in time and across the rig."""

from alight.tracks.corners import corners, strength
from alight.tracks.epipolar import epipolar_distance, inverse_depth
from alight.tracks.tracker import Tracker

__all__ = ["Tracker", "corners", "epipolar_distance", "inverse_depth", "strength"]
