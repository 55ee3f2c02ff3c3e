"""Ego-motion: tracks and GPS/INS (and IMU) to poses with covariance."""

from alight.motion.ekf.filter import MotionFilter

__all__ = ["MotionFilter"]
