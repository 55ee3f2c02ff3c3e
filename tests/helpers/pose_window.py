"""Windows of rig poses and the points that they observe, for the tests of the filter's parts."""

from __future__ import annotations

import numpy as np
from point_flight import DOWN, NOISE

from alight.arrays import F64
from alight.geometry import Pose, so3_exp
from alight.motion.ekf.state import CLONE, CORE, FilterState
from alight.motion.observations import Clones, WindowObservations

ALIKE = NOISE.model_copy(update={"vague_share": 10.0, "pixel_repeat": 1e-9})  # each error by itself, any depth
CAMS = (Pose(DOWN, [0.1, 0.25, 0.0]), Pose(DOWN @ so3_exp([0.004, -0.003, 0.002]), [0.1, -0.25, 0.0]))


def clones_at(R: F64, p: F64, first_R: F64 | None = None, first_p: F64 | None = None) -> Clones:
    """Clones at poses (K, 3, 3), (K, 3); their first estimates are the same unless given."""
    return Clones(tuple(range(len(R))), R, p, R if first_R is None else first_R, p if first_p is None else first_p)


def moved(clones: Clones, error: F64) -> Clones:
    """Clones and first estimates with (6K,) errors added."""
    e = error.reshape(-1, CLONE)
    return clones_at(so3_exp(e[:, :3]) @ clones.R, clones.p + e[:, 3:])


def clone_slice(index: int) -> slice:
    """Rows of a clone in the covariance of a state."""
    return slice(CORE + CLONE * index, CORE + CLONE * (index + 1))


def project(R: F64, p: F64, rig_from_cam: Pose, x: F64) -> F64:
    """Normalised coordinates (..., 2) of world points (..., 3) in a camera of a rig at a pose (M11)."""
    q = ((x - p) @ R - rig_from_cam.translation) @ rig_from_cam.rotation
    return np.asarray(q[..., :2] / q[..., 2:3])


def seen_from(poses: Clones, x: F64, rng: np.random.Generator, noise: float = 0.0) -> WindowObservations:
    """Return observations of all points from all poses by both cameras."""
    z = np.array([[[project(R, p, c, q) for c in CAMS] for R, p in zip(poses.R, poses.p, strict=True)] for q in x])
    return WindowObservations(np.arange(len(x)), z + noise * rng.normal(size=z.shape), np.full(z.shape[:2], 1e-3))


def row_of_poses(rng: np.random.Generator, count: int = 4) -> Clones:
    """Return some poses 30 m up, a metre apart."""
    R = np.array([so3_exp(rng.normal(size=3) * 0.05) for _ in range(count)])
    p = np.array([[1.0 * k, 0.1 * k, 30.0] for k in range(count)]) + 0.1 * rng.normal(size=(count, 3))
    return clones_at(R, p)


def window_at(poses: Clones, *variances: float) -> FilterState:
    """Return a state with an independent clone at each pose; variances of rotation [rad^2] and position [m^2]."""
    state = FilterState(0, poses.R[0], np.zeros(CORE), np.eye(CORE) * 1e-12)
    for k, (R, p) in enumerate(zip(poses.R, poses.p, strict=True)):
        state.R, state.core[3:6] = R, p
        state.add_clone(k)
    state.P[CORE:, :] = state.P[:, CORE:] = 0.0
    state.P[CORE:, CORE:] = np.diag(np.tile(np.repeat(variances, 3), len(poses)))
    return state


def ground(rng: np.random.Generator, count: int = 20) -> F64:
    """Return points on the ground below."""
    return np.column_stack([rng.uniform(-8, 8, (count, 2)), rng.uniform(-2, 2, count)])


def scene(seed: int) -> tuple[WindowObservations, Clones]:
    """Points observed now and then from six poses, one behind the cameras; first estimates are a little off."""
    rng = np.random.default_rng(seed)
    R = np.array([so3_exp(rng.normal(size=3) * 0.05) for _ in range(6)])
    p = np.array([[1.0 * k, 0.1 * k, 30.0] for k in range(6)]) + 0.1 * rng.normal(size=(6, 3))
    first_R = np.array([so3_exp(rng.normal(size=3) * 1e-3) @ a for a in R])
    x = np.column_stack([rng.uniform(-8, 8, (30, 2)), rng.uniform(-2, 2, 30)])
    z = np.array([[[project(a, b, c, q) for c in CAMS] for a, b in zip(R, p, strict=True)] for q in x])
    z += 1e-3 * rng.normal(size=z.shape)
    z[rng.random(z.shape[:3]) < 0.3] = np.nan
    z[0, :, :, :] = -z[0]
    poses = clones_at(R, p, first_R, p + 0.02 * rng.normal(size=p.shape))
    return WindowObservations(np.arange(30), z, rng.uniform(5e-4, 2e-3, (30, 6))), poses
