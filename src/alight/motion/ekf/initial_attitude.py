"""Initial attitude without INS, from the course over ground by GPS and the motion in the image (M26)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Pose
from alight.motion.gps_ins import sigmas, whites
from alight.records import NavSample, Tracks
from alight.settings import FilterSettings

_MIN_GPS_BASELINE = 0.5  # m, least distance of two GPS positions whose direction is used
MIN_SHARED = 12  # least features that two exposures share; else the later one is the first of the next pair
_TILT_SIGMA = 0.1  # rad; the camera is assumed to look down
_MIN_HEADING_SIGMA = 0.05  # rad
MAX_START_SIGMA = 1.0 / 3.0  # rad, largest sigma of an initial heading: path and shift are three sigmas long
_INLIER = 0.01  # normalised coordinates; features with a larger residual are off the ground plane, or wrong


@dataclass(frozen=True, eq=False)
class CourseAttitude:
    """Attitude of a camera that is assumed to look straight down, with the heading from the course."""

    R: F64  # (3, 3) world_from_body
    sigma: F64  # (3,) rad about east, north, up

    def row(self, nav: NavSample, t_ns: int) -> NavSample:
        """Return a copy of the row `nav` with this attitude and the stamp `t_ns`."""
        about_body = np.sqrt((self.R.T**2) @ self.sigma**2)
        return replace(nav, t_ns=t_ns, world_from_body=self.R, sigma_attitude=about_body)


@dataclass(frozen=True, eq=False)
class PositionedExposure:
    """An exposure and the GPS row at its time, with a position but no attitude."""

    tracks: Tracks
    nav: NavSample

    def course_to(self, now: PositionedExposure, cam: Pose, settings: FilterSettings) -> CourseAttitude | None:
        """Return the attitude at a later exposure, `now`, by the course; None if undetermined. `cam`: body_from_cam."""
        assert self.nav.position_world is not None
        assert now.nav.position_world is not None
        way = (now.nav.position_world - self.nav.position_world)[:2]
        sigma, dt = sigmas(now.nav, settings), (now.nav.t_ns - self.nav.t_ns) * 1e-9
        drift = sigma**2 * (1.0 - np.exp(-dt / settings.nav_position_tau))  # by the GPS model (M10)
        way_sigma = float(np.sqrt(2.0 * (drift + whites(sigma, settings) ** 2)[:2].max()))
        return attitude_from_course(self.tracks, now.tracks, way, way_sigma, cam)


@dataclass(frozen=True)
class _Shift:
    """Shift of the ground in the image, in normalised coordinates, after the effect of a tilt was removed."""

    value: complex  # x + iy
    sigma: float  # 1-sigma perpendicular to the shift
    scale: float  # scale of the second image over the first; above 1 the camera descended


def attitude_from_course(
    before: Tracks, now: Tracks, way_world: F64, way_sigma: float, body_from_cam: Pose
) -> CourseAttitude | None:
    """Return the attitude at `now` of a camera that looks straight down; None if the images do not determine it.

    Args:
        way_world: (2,) metres east and north, GPS position of `now` less that of `before`.
        way_sigma: 1-sigma of each component, metres.
    """
    # the direction of flight in the image, against the motion of the ground, is compared with that in the world
    way = float(np.hypot(way_world[0], way_world[1]))
    _, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
    a, b = (_complex(t.normalised[k, 0]) for t, k in ((before, i), (now, j)))
    both = np.isfinite(a) & np.isfinite(b)
    if way < _MIN_GPS_BASELINE or both.sum() < MIN_SHARED:
        return None
    shift = _robust_shift(a[both], b[both])
    if shift is None:
        return None
    size = abs(shift.value)
    by_tilt = abs(shift.scale - 1.0) * _TILT_SIGMA / size
    heading = float(np.linalg.norm([_MIN_HEADING_SIGMA, way_sigma / way, shift.sigma / size, by_tilt]))
    x_axis = np.arctan2(way_world[1], way_world[0]) + np.angle(-shift.value)  # rad, of the image, from east
    c, s = np.cos(x_axis), np.sin(x_axis)
    world_from_cam = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    R = np.asarray(world_from_cam @ body_from_cam.rotation.T)
    return CourseAttitude(R, np.array([_TILT_SIGMA, _TILT_SIGMA, heading]))


def _complex(z: F64) -> NDArray[np.complex128]:
    return np.asarray(z[:, 0] + 1j * z[:, 1])


def _robust_shift(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> _Shift | None:
    """Return the shift t of the map b (1 + h . a) = c a + t by robust least squares; None if the motion is not clear.

    `a` and `b` (N,) are normalised coordinates x + iy of the features in both images. The term h removes the effect of
    a changed tilt, which shifts the image like a flight. The fit starts from the pair of features whose similarity has
    the most inliers, because the images may be rotated by any angle.
    """
    i, j = np.random.default_rng(0).integers(0, len(a), (2, 100))
    c = (b[j] - b[i]) / np.where(i == j, 1.0, a[j] - a[i])
    residual = np.abs(c[:, None] * a + (b[i] - c * a[i])[:, None] - b)
    used = residual[int(np.argmax((residual < 3.0 * _INLIER).sum(axis=1)))] < 3.0 * _INLIER
    u, v, zero, one = b.real, b.imag, np.zeros(len(a)), np.ones(len(a))
    x_row = [a.real, -a.imag, one, zero, -u * a.real, -u * a.imag]
    y_row = [a.imag, a.real, zero, one, -v * a.real, -v * a.imag]
    J = np.array([x_row, y_row]).transpose(2, 0, 1)  # (N, 2, 6) by the real and imaginary parts of c, t and h
    x, rows = np.zeros(6), J[:0].reshape(0, 6)
    for _ in range(6):
        if used.sum() < MIN_SHARED:
            return None
        rows, seen = J[used].reshape(-1, 6), np.column_stack([b[used].real, b[used].imag]).ravel()
        x, _, rank, _ = np.linalg.lstsq(rows, seen)
        if rank < 6:
            return None
        variance = float(((rows @ x - seen) ** 2).sum()) / max(len(seen) - 6, 1)
        residual = np.abs(_complex(J @ x) - b)
        used = residual < max(_INLIER, 3.0 * float(np.median(residual[used])))
    turn = np.array([[x[0], -x[1]], [x[1], x[0]]]) / np.hypot(x[0], x[1])
    value = complex(*(x[2:4] + turn @ x[4:6]))
    if abs(value) <= _INLIER:
        return None
    across = np.array([-value.imag, value.real]) / abs(value)
    by_map = np.concatenate([np.zeros(2), across, across @ turn])
    sigma = float(np.sqrt(variance * (by_map @ np.linalg.solve(rows.T @ rows, by_map))))
    return _Shift(value, sigma, float(np.hypot(x[0], x[1])))
