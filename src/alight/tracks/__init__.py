"""Feature tracks: features of frames, tracked in time and across the rig."""

from alight.tracks.corners import corner_response, detect_corners
from alight.tracks.tracker import Tracker
from alight.tracks.view_transfer import epipolar_distance, inverse_depth

__all__ = ["Tracker", "corner_response", "detect_corners", "epipolar_distance", "inverse_depth"]
