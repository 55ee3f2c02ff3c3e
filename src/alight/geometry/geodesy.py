"""Geodetic and local coordinates: the ENU tangent plane at an origin, heights above the ellipsoid, CRS of rasters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alight.arrays import F32, F64
from alight.geometry.grid import Grid

_A = 6378137.0  # semi-major axis, metres
_E2 = 0.0066943799901413165  # squared eccentricity
MEAN_RADIUS = 6371008.8  # metres
# CRS of rasters that are not georeferenced
LOCAL_WKT = 'LOCAL_CS["local east north, origin not on Earth",UNIT["metre",1],AXIS["East",EAST],AXIS["North",NORTH]]'


def _ecef(latitude_deg: ArrayLike, longitude_deg: ArrayLike, height: ArrayLike) -> F64:
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    h = np.asarray(height, dtype=np.float64)
    n = _A / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    return np.stack(
        np.broadcast_arrays(
            (n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon), (n * (1 - _E2) + h) * np.sin(lat)
        ),
        axis=-1,
    )


@dataclass(frozen=True)
class LocalFrame:
    """World frame: East-North-Up about an origin given in degrees and metres above the WGS84 ellipsoid.

    Raises:
        ValueError: the origin is not a position on Earth.
    """

    latitude: float
    longitude: float
    height: float

    def __post_init__(self) -> None:
        finite = np.isfinite([self.latitude, self.longitude, self.height]).all()
        if not (finite and abs(self.latitude) <= 90 and abs(self.longitude) <= 360):
            raise ValueError(f"no place on Earth: {self.latitude}, {self.longitude}, {self.height}")

    @cached_property
    def _origin(self) -> F64:
        return _ecef(self.latitude, self.longitude, self.height)

    @cached_property
    def _enu_from_ecef(self) -> F64:
        la, lo = np.radians([self.latitude, self.longitude])
        return np.array(
            [
                [-np.sin(lo), np.cos(lo), 0.0],
                [-np.sin(la) * np.cos(lo), -np.sin(la) * np.sin(lo), np.cos(la)],
                [np.cos(la) * np.cos(lo), np.cos(la) * np.sin(lo), np.sin(la)],
            ]
        )

    def to_enu(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height: ArrayLike) -> F64:
        """Convert geodetic coordinates (degrees, metres above the ellipsoid) to (..., 3) ENU metres."""
        d = _ecef(latitude_deg, longitude_deg, height) - self._origin
        return np.asarray(d @ self._enu_from_ecef.T)

    def to_geodetic(self, enu: ArrayLike) -> tuple[F64, F64, F64]:
        """Convert (..., 3) ENU metres to latitude and longitude (degrees) and height above the ellipsoid (metres)."""
        p = np.asarray(enu, dtype=np.float64) @ self._enu_from_ecef + self._origin
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        r = np.hypot(x, y)
        lat = np.arctan2(z, r * (1 - _E2))
        for _ in range(6):  # fixed point: each iteration divides the error by 150
            n = _A / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
            lat = np.arctan2(z + _E2 * n * np.sin(lat), r)
        n = _A / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
        h = r * np.cos(lat) + z * np.sin(lat) - _A**2 / n
        return np.degrees(lat), np.degrees(np.arctan2(y, x)), h

    @property
    def crs(self) -> str:
        """PROJ text of the rasters' CRS: transverse Mercator centred on the origin, scale 1 (formats/outputs)."""
        return (
            f"+proj=tmerc +lat_0={self.latitude:.10f} +lon_0={self.longitude:.10f} +k=1 +x_0=0 +y_0=0 "
            "+datum=WGS84 +units=m +no_defs"
        )


def ellipsoid_fall(grid: Grid) -> F64:
    """Compute how far the ellipsoid lies below the tangent plane at the world's origin, (R, C) metres, at each cell.

    At the distance d from the origin it lies d^2 / (2 r) lower, with the mean Earth radius r: 7 mm at 300 m.
    """
    east, north = grid.xy()
    return np.asarray((east[None, :] ** 2 + north[:, None] ** 2) / (2 * MEAN_RADIUS))


def world_up(height: NDArray[np.floating[Any]], grid: Grid, local: LocalFrame) -> F32:
    """Convert heights above the ellipsoid, (R, C) metres, to heights above the tangent plane at the origin `local`."""
    return (height.astype(np.float64) - local.height - ellipsoid_fall(grid)).astype(np.float32)
