"""Conversions between NED, FRD and sea level outside and ENU, FLU and the ellipsoid inside; nothing else converts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from alight.arrays import F64
from alight.geometry import LocalFrame, enu_from_flu, matrix_from_quaternion
from alight.geometry.rotations import ENU_FROM_NED, FRD_FROM_FLU
from alight.records import Place
from alight.records.telemetry import FARTHEST_FROM_SEA

METRES_PER_DEGREE = 111_132.0  # of latitude


def enu(north: float, east: float, down: float) -> F64:
    """Return the ENU components (3,) of a vector given in NED, in the same unit."""
    return np.array([east, north, -down], dtype=np.float64)


def ned(vector_world: ArrayLike) -> F64:
    """Return the NED components (3,) of a vector (3,) given in ENU, in the same unit."""
    return enu(*np.asarray(vector_world, dtype=np.float64))  # its own inverse


def flu(x: float, y: float, z: float) -> F64:
    """Return the FLU components (3,) of a vector given in FRD, in the same unit."""
    return np.array([x, -y, -z], dtype=np.float64)


def frd(vector_body: ArrayLike) -> F64:
    """Return the FRD components (3,) of a vector (3,) given in FLU, in the same unit."""
    return flu(*np.asarray(vector_body, dtype=np.float64))  # its own inverse


def world_from_body_of(ned_from_frd: F64) -> F64:
    """Convert rotations from NED-from-FRD to ENU-from-FLU, both (..., 3, 3)."""
    return np.asarray(ENU_FROM_NED @ ned_from_frd @ FRD_FROM_FLU)


def world_from_body_of_quaternion(quaternion: ArrayLike) -> F64 | None:
    """Convert a NED-from-FRD quaternion (w, x, y, z) to an ENU-from-FLU matrix (3, 3); None: it is no rotation."""
    try:
        return world_from_body_of(matrix_from_quaternion(quaternion))
    except ValueError:
        return None


def world_from_body_of_angles(roll: float, pitch: float, yaw: float) -> F64 | None:
    """Convert NED/FRD roll, pitch and yaw, rad, to an ENU-from-FLU matrix (3, 3); None: an angle is not finite."""
    return enu_from_flu(yaw, pitch, roll) if np.isfinite([roll, pitch, yaw]).all() else None


def separation_of(ellipsoid: float, msl: float) -> float:
    """Return a receiver's ellipsoidal height minus its altitude above the sea, metres; NaN: only one is measured.

    A receiver that measures only one height reports it twice, or leaves the other height unset.
    """
    separation = ellipsoid - msl
    return separation if 0.0 < abs(separation) <= FARTHEST_FROM_SEA else math.nan


def metres_per_degree_east(place: Place) -> float:
    """Return the length of a degree of longitude at a position, metres; above 0 even at the poles."""
    return METRES_PER_DEGREE * max(math.cos(math.radians(place.latitude)), 1e-6)


def metres_between(a: Place, b: Place) -> float:
    """Return the distance between two positions near each other, metres; correct across the date line."""
    north = (b.latitude - a.latitude) * METRES_PER_DEGREE
    east = math.remainder(b.longitude - a.longitude, 360.0) * metres_per_degree_east(a)
    return math.hypot(north, east, b.altitude_msl - a.altitude_msl)


def shifted(place: Place, latitude: float, longitude: float, up: float) -> Place:
    """Return a position moved by `latitude` and `longitude` degrees and by `up` metres."""
    return Place(place.latitude + latitude, place.longitude + longitude, place.altitude_msl + up, place.above_home + up)


@dataclass(frozen=True, eq=False)
class EstimateTie:
    """Our position and the autopilot's at the same instant, which tie our world to the autopilot's coordinates.

    A target is sent relative to the vehicle, so an error that both positions share (GPS) has no effect.
    """

    local: LocalFrame
    position_world: F64  # (3,) metres, our position
    place: Place  # the autopilot's position

    def place_of(self, target_world: ArrayLike) -> Place:
        """Convert a target (3,) of our world to the autopilot's coordinates, including the autopilot's error."""
        lat, lon, height = self.local.to_geodetic(np.stack([self.position_world, np.asarray(target_world)]))
        return shifted(self.place, *(float(v[1] - v[0]) for v in (lat, lon, height)))
