"""Measurement model of GPS/INS: the state, a slowly varying error and a white one (docs/method/motion.md, M14-M16)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp, so3_log
from alight.motion.ekf.state import (
    ATT,
    CORE,
    GYRO,
    MOUNT,
    NAV_ATT,
    NAV_POS,
    NAV_VEL,
    OFFSET,
    POS,
    TIME,
    VEL,
    FilterState,
)
from alight.records import NavSample
from alight.settings import FilterSettings

GIMBAL_MOUNTING_SIGMA = 0.03  # rad, of the rotation between a gimbal's tag and the camera
_OPEN_VELOCITY_SIGMA = 10.0  # m/s, at a start without a velocity
POSITION_ROWS, ATTITUDE_ROWS, VELOCITY_ROWS = slice(0, 3), slice(3, 6), slice(6, 9)  # of the (9,) sigmas


class Quantity(Enum):
    """A quantity that a row of GPS/INS may hold."""

    POSITION = "position"
    ATTITUDE = "attitude"
    VELOCITY = "velocity"
    RATE = "angular velocity"


@dataclass(frozen=True, eq=False)
class NavMeasurement:
    """One quantity of a GPS/INS row, linearised: residual = H error + noise."""

    quantity: Quantity
    residual: F64  # (3,)
    H: F64  # (3, CORE)
    variance: F64  # (3,) of the white noise


def sigmas(sample: NavSample, noise: FilterSettings) -> F64:
    """Return the (9,) 1-sigma of position, attitude (in the world) and velocity; defaults where a row has none."""
    position = _valid_or(sample.sigma_position, noise.position_sigma)
    attitude = _valid_or(sample.sigma_attitude, noise.attitude_sigma)
    if sample.world_from_body is not None:  # roll, pitch, yaw are about the axes of the body
        attitude = np.sqrt(np.diag(sample.world_from_body @ np.diag(attitude**2) @ sample.world_from_body.T))
    return np.concatenate([position, attitude, _valid_or(sample.sigma_velocity, noise.velocity_sigma)])


def _valid_or(sigma: F64 | None, default: float) -> F64:
    valid = sigma is not None and bool(np.isfinite(sigma).all()) and bool((np.asarray(sigma) > 0).all())
    return np.asarray(sigma, dtype=np.float64) if valid else np.full(3, default)


def whites(sigma: F64, noise: FilterSettings) -> F64:
    """Return the (9,) sigma of the white part, never above the whole (RTK is better than the setting)."""
    white = np.repeat([noise.nav_position_white, noise.nav_attitude_white, noise.nav_velocity_white], 3)
    return np.asarray(np.minimum(white, sigma))


def is_photo_tag(sample: NavSample) -> bool:
    """True if a row holds the tags of a photo: position and gimbal attitude, no velocity."""
    return sample.velocity_world is None


def mounting_sigma(sample: NavSample, noise: FilterSettings) -> float:
    """Return the 1-sigma in rad of the rotation from the INS to the cameras, at a start with this row."""
    if noise.mounting_sigma is not None:
        return noise.mounting_sigma
    return GIMBAL_MOUNTING_SIGMA if is_photo_tag(sample) else 0.0


def initial_state(sample: NavSample, sigma: F64, noise: FilterSettings) -> FilterState | None:
    """Make the first state from a row with position and attitude; None: the row lacks one.

    The position is exact in a map frame of its own (M14b), whose offset from the world is a state. Cameras cannot
    observe the first error of GPS; as an error of the position it would only disturb the poses.
    """
    if sample.position_world is None or sample.world_from_body is None:
        return None
    core = np.zeros(CORE)
    core[POS] = sample.position_world
    white = whites(sigma, noise)
    P = np.zeros((CORE, CORE))
    for value, drift, rows in (
        (POS, NAV_POS, POSITION_ROWS),
        (ATT, NAV_ATT, ATTITUDE_ROWS),
        (VEL, NAV_VEL, VELOCITY_ROWS),
    ):
        slow, fast = np.diag(sigma[rows] ** 2), np.diag(white[rows] ** 2)
        P[value, value], P[drift, drift] = slow + fast, slow  # value = measured - slow error - white error
        P[value, drift] = P[drift, value] = -slow
    P[OFFSET, OFFSET], P[OFFSET, NAV_POS], P[NAV_POS, OFFSET] = P[POS, POS], P[POS, NAV_POS], P[NAV_POS, POS]
    P[POS, POS], P[POS, NAV_POS], P[NAV_POS, POS] = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    if sample.velocity_world is None:
        P[VEL, VEL] = np.eye(3) * _OPEN_VELOCITY_SIGMA**2
        P[VEL, NAV_VEL], P[NAV_VEL, VEL] = np.zeros((3, 3)), np.zeros((3, 3))
    else:
        core[VEL] = sample.velocity_world
    P[MOUNT, MOUNT] = np.eye(3) * mounting_sigma(sample, noise) ** 2
    core[TIME], P[TIME, TIME] = noise.time_offset, noise.time_offset_sigma**2
    return FilterState(sample.t_ns, np.array(sample.world_from_body), core, P)


def measurements(state: FilterState, sample: NavSample, sigma: F64, noise: FilterSettings) -> list[NavMeasurement]:
    """Return position (M14), attitude (M15) and velocity (M16), each where the row holds it."""
    white, out = whites(sigma, noise) ** 2, []
    if sample.position_world is not None:
        residual = sample.position_world - (state.core[POS] + state.core[OFFSET] + state.core[NAV_POS])
        H = _selector(POS, OFFSET, NAV_POS)
        out.append(NavMeasurement(Quantity.POSITION, residual, H, white[POSITION_ROWS]))
    if sample.world_from_body is not None:
        expected = so3_exp(state.core[NAV_ATT]) @ state.R
        residual, H = so3_log(sample.world_from_body @ expected.T), _selector(ATT, NAV_ATT)
        out.append(NavMeasurement(Quantity.ATTITUDE, residual, H, white[ATTITUDE_ROWS]))
    if sample.velocity_world is not None:
        residual, H = sample.velocity_world - state.core[VEL] - state.core[NAV_VEL], _selector(VEL, NAV_VEL)
        out.append(NavMeasurement(Quantity.VELOCITY, residual, H, white[VELOCITY_ROWS]))
    return out


def rate_measurement(state: FilterState, sample: NavSample, noise: FilterSettings) -> NavMeasurement | None:
    """Return the angular velocity as a measurement of the state's; only used where no IMU drives the motion."""
    if sample.angular_velocity_body is None:
        return None
    residual = sample.angular_velocity_body - state.core[GYRO]
    return NavMeasurement(Quantity.RATE, residual, _selector(GYRO), np.full(3, noise.nav_rate_white**2))


def _selector(*parts: slice) -> F64:
    """Return the (3, CORE) matrix that adds up some parts of the core's errors."""
    H = np.zeros((3, CORE))
    for part in parts:
        H[:, part] = np.eye(3)
    return H
