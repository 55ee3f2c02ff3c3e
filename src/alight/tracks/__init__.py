"""Feature tracks: features of frames, tracked in time and across the rig; people and cars that move."""

from alight.tracks.corners import corner_response, detect_corners
from alight.tracks.moving import MovingWatch
from alight.tracks.tracker import Tracker
from alight.tracks.view_transfer import epipolar_distance, inverse_depth

__all__ = ["MovingWatch", "Tracker", "corner_response", "detect_corners", "epipolar_distance", "inverse_depth"]
