"""What GPS/INS measures: the state, a slowly varying error, a small white one (docs/method/motion.md, M14-M16)."""

from __future__ import annotations

import numpy as np

from alight.geometry import so3_exp, so3_log
from alight.motion.ekf.state import ATT, CORE, GYRO, NAV_ATT, NAV_POS, NAV_VEL, OFFSET, POS, TIME, VEL, FilterState
from alight.records import F64, NavSample
from alight.settings import FilterSettings

GIMBAL = 0.03  # rad, 1-sigma of the camera's mounting against a gimbal's tag: photos, told by that no velocity is known


def sigmas(sample: NavSample, noise: FilterSettings) -> F64:
    """Return the (9,) bounds of position, attitude (in the world) and velocity error; defaults where a row has none."""
    position = _or(sample.sigma_position, noise.position_sigma)
    attitude = _or(sample.sigma_attitude, noise.attitude_sigma)
    if sample.world_from_body is not None:  # roll, pitch, yaw are about the body's axes
        attitude = np.sqrt(np.diag(sample.world_from_body @ np.diag(attitude**2) @ sample.world_from_body.T))
    return np.concatenate([position, attitude, _or(sample.sigma_velocity, noise.velocity_sigma)])


def _or(sigma: F64 | None, default: float) -> F64:
    known = sigma is not None and bool(np.isfinite(sigma).all()) and bool((np.asarray(sigma) > 0).all())
    return np.asarray(sigma, dtype=np.float64) if known else np.full(3, default)


def whites(sigma: F64, noise: FilterSettings) -> F64:
    """Return the (9,) sigma of the white part, never above the bound itself (RTK is better than the setting)."""
    white = np.repeat([noise.nav_position_white, noise.nav_attitude_white, noise.nav_velocity_white], 3)
    return np.asarray(np.minimum(white, sigma))


def initial_state(sample: NavSample, sigma: F64, noise: FilterSettings) -> FilterState | None:
    """Make the first state of a row that has position and attitude; None: this row has not.

    The position is exact in a map of its own (M14b), whose offset from the world is a state: where the world lies to
    within the first error of GPS is nothing that cameras can tell, and learning it would only shake the poses.
    """
    if sample.position_world is None or sample.world_from_body is None:
        return None
    core = np.zeros(CORE)
    core[POS] = sample.position_world
    white = whites(sigma, noise)
    P = np.zeros((CORE, CORE))
    for value, drift, i in ((POS, NAV_POS, 0), (ATT, NAV_ATT, 3), (VEL, NAV_VEL, 6)):
        bound, shake = np.diag(sigma[i : i + 3] ** 2), np.diag(white[i : i + 3] ** 2)
        P[value, value], P[drift, drift] = bound + shake, bound  # value = measured - drift - white
        P[value, drift] = P[drift, value] = -bound
    P[OFFSET, OFFSET], P[OFFSET, NAV_POS], P[NAV_POS, OFFSET] = P[POS, POS], P[POS, NAV_POS], P[NAV_POS, POS]
    P[POS, POS], P[POS, NAV_POS], P[NAV_POS, POS] = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    if sample.velocity_world is None:
        P[VEL, VEL], P[VEL, NAV_VEL], P[NAV_VEL, VEL] = np.eye(3) * 10.0**2, np.zeros((3, 3)), np.zeros((3, 3))
    else:
        core[VEL] = sample.velocity_world
    mounting = noise.mounting_sigma
    if mounting is None:
        mounting = 0.0 if sample.velocity_world is not None else GIMBAL
    P[range(24, 27), range(24, 27)] = mounting**2
    core[TIME], P[TIME, TIME] = noise.time_offset, noise.time_offset_sigma**2
    return FilterState(sample.t_ns, np.array(sample.world_from_body), core, P)


def measurements(
    state: FilterState, sample: NavSample, sigma: F64, noise: FilterSettings
) -> list[tuple[F64, F64, F64]]:
    """Return (residual, H, variance), each of 3 rows: position (M14), attitude (M15), velocity (M16) where measured."""
    white, out = whites(sigma, noise) ** 2, []
    if sample.position_world is not None:
        expected = state.core[POS] + state.core[OFFSET] + state.core[NAV_POS]
        out.append((sample.position_world - expected, _selector(state, POS, OFFSET, NAV_POS), white[0:3]))
    if sample.world_from_body is not None:
        turned = so3_exp(state.core[NAV_ATT]) @ state.R
        out.append((so3_log(sample.world_from_body @ turned.T), _selector(state, ATT, NAV_ATT), white[3:6]))
    if sample.velocity_world is not None:
        out.append(
            (sample.velocity_world - state.core[VEL] - state.core[NAV_VEL], _selector(state, VEL, NAV_VEL), white[6:9])
        )
    return out


def rate_measurement(state: FilterState, sample: NavSample, noise: FilterSettings) -> tuple[F64, F64, F64] | None:
    """The angular velocity of a row as a measurement of the state's: only where no IMU drives the motion."""
    if sample.angular_velocity_body is None:
        return None
    variance = np.full(3, noise.nav_rate_white**2)
    return sample.angular_velocity_body - state.core[GYRO], _selector(state, GYRO), variance


def _selector(state: FilterState, *parts: slice) -> F64:
    H = np.zeros((3, len(state.P)))
    for part in parts:
        H[:, part] = np.eye(3)
    return H
