"""Rotations, rigid poses, cameras, the world grid and geodetic conversion; imports no other package of the project."""

from alight.geometry.cameras import Camera
from alight.geometry.geodesy import LOCAL_WKT, LocalFrame, ellipsoid_fall, world_up
from alight.geometry.grid import Box, Grid, box_of, ground_projection, plane_on
from alight.geometry.poses import Pose
from alight.geometry.rotations import (
    enu_from_flu,
    matrix_from_quaternion,
    quaternion_from_matrix,
    skew,
    slerp,
    so3_exp,
    so3_log,
)

__all__ = [
    "LOCAL_WKT",
    "Box",
    "Camera",
    "Grid",
    "LocalFrame",
    "Pose",
    "box_of",
    "ellipsoid_fall",
    "enu_from_flu",
    "ground_projection",
    "matrix_from_quaternion",
    "plane_on",
    "quaternion_from_matrix",
    "skew",
    "slerp",
    "so3_exp",
    "so3_log",
    "world_up",
]
