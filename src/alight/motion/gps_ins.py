"""Measurement model of GPS/INS: state, slowly varying error, and white error (docs/method/motion.md, M14-M16)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp, so3_log
from alight.motion.ekf.state import AT, CORE, FilterState
from alight.records import NavSample
from alight.settings import FilterSettings

_GIMBAL_MOUNTING_SIGMA = 0.03  # rad, of the rotation between a gimbal's tag and the camera
_OPEN_VELOCITY_SIGMA = 10.0  # m/s, for an initial state without a velocity


class Quantity(IntEnum):
    """A quantity that a row of GPS/INS may hold; the first three have slowly varying errors."""

    POSITION = 0
    ATTITUDE = 1
    VELOCITY = 2
    RATE = 3
    HEIGHT = 4

    @property
    def rows(self) -> slice:
        """Rows of the quantity in (9,) sigmas and slowly varying errors; not for RATE and HEIGHT."""
        return slice(3 * self, 3 * self + 3)

    @property
    def state(self) -> slice:
        """Rows of the core that the quantity measures."""
        return (AT.pos, AT.att, AT.vel, AT.gyro, slice(AT.pos.stop - 1, AT.pos.stop))[self]

    def of(self, sample: NavSample) -> F64 | None:
        """Return the quantity's value in a row of GPS/INS; None: not measured. Not for HEIGHT."""
        values = (sample.position_world, sample.world_from_body, sample.velocity_world, sample.angular_velocity_body)
        return values[self]


SLOW = (Quantity.POSITION, Quantity.ATTITUDE, Quantity.VELOCITY)  # quantities with slowly varying errors


@dataclass(frozen=True, eq=False)
class NavMeasurement:
    """One quantity of a GPS/INS row, linearised: residual = H error + noise."""

    quantity: Quantity
    residual: F64  # (3,); (1,) of a height
    H: F64  # (3 or 1, CORE) Jacobian with respect to the errors of the core
    variance: F64  # (3 or 1,) of the white noise


def sigmas(sample: NavSample, noise: FilterSettings) -> F64:
    """Return the (9,) 1-sigma of position, attitude (in world axes) and velocity; defaults where the row gives none."""
    position = _valid_or(sample.sigma_position, noise.position_sigma)
    attitude = _valid_or(sample.sigma_attitude, noise.attitude_sigma)
    if sample.world_from_body is not None:  # roll, pitch, yaw are about the axes of the body
        attitude = np.sqrt(np.diag(sample.world_from_body @ np.diag(attitude**2) @ sample.world_from_body.T))
    return np.concatenate([position, attitude, _valid_or(sample.sigma_velocity, noise.velocity_sigma)])


def _valid_or(sigma: F64 | None, default: float) -> F64:
    valid = sigma is not None and bool(np.isfinite(sigma).all()) and bool((np.asarray(sigma) > 0).all())
    return np.asarray(sigma, dtype=np.float64) if valid else np.full(3, default)


def whites(sigma: F64, noise: FilterSettings) -> F64:
    """Return the (9,) 1-sigma of the white part of the GPS/INS errors, whose total 1-sigma is `sigma` (9,)."""
    white = np.repeat([noise.nav_position_white, noise.nav_attitude_white, noise.nav_velocity_white], 3)
    return np.asarray(np.minimum(white, sigma))


def initial_state(sample: NavSample, sigma: F64, noise: FilterSettings) -> FilterState | None:
    """Create the first state from a GPS/INS row of 1-sigma `sigma` (9,); None if it lacks position or attitude.

    The position is exact in a map frame of its own (M14b), whose offset from the world is a state. Cameras cannot
    observe the initial error of GPS; as an error of the position it would only disturb the poses.
    """
    if sample.position_world is None or sample.world_from_body is None:
        return None
    core, white, P = np.zeros(CORE), whites(sigma, noise), np.zeros((CORE, CORE))
    core[AT.pos] = sample.position_world
    values, drifts = (AT.offset, AT.att, AT.vel), (AT.nav_pos, AT.nav_att, AT.nav_vel)
    for quantity, value, drift in zip(SLOW, values, drifts, strict=True):
        slow, fast = (np.diag(s[quantity.rows] ** 2) for s in (sigma, white))
        P[value, value], P[drift, drift] = slow + fast, slow  # value = measured - slow error - white error
        P[value, drift] = P[drift, value] = -slow
    mounting = noise.mounting_sigma
    if mounting is None:  # a row without velocity is the tag of a photo
        mounting = _GIMBAL_MOUNTING_SIGMA if sample.velocity_world is None else 0.0
    if sample.velocity_world is None:
        P[AT.vel, AT.vel] = np.eye(3) * _OPEN_VELOCITY_SIGMA**2
        P[AT.vel, AT.nav_vel] = P[AT.nav_vel, AT.vel] = 0.0
    else:
        core[AT.vel] = sample.velocity_world
    P[AT.mount, AT.mount] = np.eye(3) * mounting**2
    core[AT.time], P[AT.time, AT.time] = noise.time_offset, noise.time_offset_sigma**2
    return FilterState(sample.t_ns, np.array(sample.world_from_body), core, P)


def measurements(
    state: FilterState, sample: NavSample, sigma: F64, noise: FilterSettings, inertial: bool
) -> list[NavMeasurement]:
    """Return the linearised position (M14), attitude (M15) and velocity (M16), each if the row `sample` holds it.

    Unless an IMU drives the motion (`inertial`), the angular velocity is included. `sigma` (9,) is the row's 1-sigma.
    """
    core, R, out = state.core, sample.world_from_body, list[NavMeasurement]()

    def add(quantity: Quantity, residual: F64, variance: F64, *parts: slice) -> None:
        H = np.zeros((3, CORE))  # sums up these parts of the core's errors
        for part in parts:
            H[:, part] = np.eye(3)
        out.append(NavMeasurement(quantity, residual, H, variance))

    position, attitude, velocity = np.split(whites(sigma, noise) ** 2, 3)
    if sample.position_world is not None:
        residual = sample.position_world - (core[AT.pos] + core[AT.offset] + core[AT.nav_pos])
        add(Quantity.POSITION, residual, position, AT.pos, AT.offset, AT.nav_pos)
    elif sample.height_world is not None:
        up, H = core[AT.pos] + core[AT.offset] + core[AT.nav_pos], np.zeros((1, CORE))
        H[0, [part.stop - 1 for part in (AT.pos, AT.offset, AT.nav_pos)]] = 1.0
        out.append(NavMeasurement(Quantity.HEIGHT, sample.height_world - up[2:], H, position[2:]))
    if R is not None:
        expected = so3_exp(core[AT.nav_att]) @ state.R
        add(Quantity.ATTITUDE, so3_log(R @ expected.T), attitude, AT.att, AT.nav_att)
    if sample.velocity_world is not None:
        residual = sample.velocity_world - core[AT.vel] - core[AT.nav_vel]
        add(Quantity.VELOCITY, residual, velocity, AT.vel, AT.nav_vel)
    if not inertial and sample.angular_velocity_body is not None:
        residual = sample.angular_velocity_body - core[AT.gyro]
        add(Quantity.RATE, residual, np.full(3, noise.gyro_bias_sigma**2), AT.gyro)
    return out
