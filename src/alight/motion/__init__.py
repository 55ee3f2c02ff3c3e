"""Ego-motion: tracks and GPS/INS (and IMU) to poses with covariance."""

from alight.motion.filter import MotionFilter
from alight.motion.late import LateFilter

__all__ = ["LateFilter", "MotionFilter"]
