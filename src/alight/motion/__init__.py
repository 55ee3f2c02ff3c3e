"""Ego-motion: tracks and GPS/INS (and IMU) to poses with covariance."""

from alight.motion.ekf.filter import MotionFilter
from alight.motion.ekf.out_of_sequence import RollbackFilter

__all__ = ["MotionFilter", "RollbackFilter"]
