"""First poses: rotations from the pictures, turned into the world by GPS baselines and the gimbal's attitude.

The pictures decide. A gimbal tag is believed only where it agrees with them, so that tags turned half round do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from alight.geometry import so3_exp, so3_log
from alight.motion.bundle_match import Index, Pair
from alight.records import F64

_AGREES = (
    0.35  # rad between gimbal and pictures: chains of relative rotations drift by a third of it, mistakes are far above
)
_AXIS_SIGMA = 0.15  # rad, of an optical axis from the gimbal in the absolute orientation
_SWEEPS = 30


@dataclass(frozen=True, eq=False)
class Oriented:
    """First poses of the photos of one connected component."""

    photos: Index  # (k,) photo numbers
    world_from_cam: F64  # (k, 3, 3)
    contradicted: Index  # photo numbers whose gimbal tag the pictures contradict
    guessed: bool  # the roll about a straight line of flight rests on the camera looking down


def components(count: int, pairs: Sequence[Pair]) -> list[Index]:
    """Return the photos of each connected component of two and more, largest first."""
    if not pairs:
        return []
    ij = np.array([(p.i, p.j) for p in pairs])
    graph = sparse.coo_array((np.ones(len(ij)), (ij[:, 0], ij[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label)
    return [np.flatnonzero(label == k) for k in np.argsort(-sizes, kind="stable") if sizes[k] > 1]


def _median_rotation(rotations: list[F64], start: F64) -> F64:
    """Return the geometric median on SO(3) by Weiszfeld steps: a minority of wrong neighbours does not move it."""
    R = start
    for _ in range(3):
        logs = np.array([so3_log(Q @ R.T) for Q in rotations])
        weight = 1.0 / np.maximum(np.linalg.norm(logs, axis=1), 1e-3)
        R = so3_exp((weight[:, None] * logs).sum(axis=0) / weight.sum()) @ R
    return R


def average_rotations(photos: Index, pairs: Sequence[Pair]) -> F64:
    """Return (k, 3, 3) `frame_from_cam` of one component, the frame being the first photo's camera (L1 averaging).

    Start: the spanning tree of most matches. Then each photo takes the median of what its neighbours say
    (Hartley et al. 2011, L1 rotation averaging).
    """
    slot = {int(p): s for s, p in enumerate(photos)}
    edges = [(slot[p.i], slot[p.j], p.j_from_i, len(p.matches)) for p in pairs if p.i in slot]
    says: list[list[tuple[int, F64]]] = [[] for _ in photos]  # R_s = R_other @ other_from_s
    for i, j, j_from_i, _ in edges:
        says[i].append((j, j_from_i))
        says[j].append((i, j_from_i.T))
    e = np.array([(i, j, 1.0 / m) for i, j, _, m in edges])
    graph = sparse.coo_array((e[:, 2], (e[:, 0].astype(int), e[:, 1].astype(int))), shape=(len(photos),) * 2).tocsr()
    order, parent = breadth_first_order(minimum_spanning_tree(graph), 0, directed=False)
    R = np.tile(np.eye(3), (len(photos), 1, 1))
    for s in order[1:]:
        R[s] = next(R[o] @ Q for o, Q in says[s] if o == parent[s])
    for _ in range(_SWEEPS):
        for s in order[1:]:
            R[s] = _median_rotation([R[o] @ Q for o, Q in says[s]], R[s])
    return R


def _wahba(world: F64, frame: F64, weight: F64) -> F64:
    """Return the rotation `world_from_frame` that best takes unit vectors (q, 3) to unit vectors (q, 3)."""
    U, _, Vt = np.linalg.svd((weight[:, None] * world).T @ frame)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)


def _robust_wahba(world: F64, frame: F64, sigma: F64, start: F64) -> tuple[F64, float]:
    R = start
    for _ in range(20):
        r2 = ((world - frame @ R.T) ** 2).sum(axis=1) / sigma**2
        R = _wahba(world, frame, 1.0 / (sigma**2 * (1.0 + r2)))
    r2 = ((world - frame @ R.T) ** 2).sum(axis=1) / sigma**2
    return R, float(np.log1p(r2).sum())


def _baselines(
    photos: Index, frame_from_cam: F64, pairs: Sequence[Pair], centres: F64, sigma: F64
) -> tuple[F64, F64, F64]:
    slot = {int(p): s for s, p in enumerate(photos)}
    world, frame, noise = [], [], []
    for p in pairs:
        b = centres[p.j] - centres[p.i]
        length = float(np.linalg.norm(b))
        if p.i in slot and np.isfinite(length) and length > 1e-6 and p.direction.any():
            world.append(b / length)
            frame.append(frame_from_cam[slot[p.i]] @ p.direction)
            noise.append(np.hypot(0.1, 1.5 * float(np.linalg.norm(sigma[[p.i, p.j]])) / length))
    return np.array(world).reshape(-1, 3), np.array(frame).reshape(-1, 3), np.array(noise)


def orient(photos: Index, pairs: Sequence[Pair], centres: F64, sigma: F64, gimbal: F64) -> Oriented:
    """Turn the averaged rotations of one component into the world.

    `centres` (n, 3) metres with `sigma` (n, 3) and `gimbal` (n, 3, 3) world_from_cam cover all photos, NaN = unknown.
    Evidence: directions between photos against GPS baselines, and the gimbal's axes, all robust. Two starts, one that
    believes the gimbal's heading and one that does not; the one that fits better wins.
    """
    frame_from_cam = average_rotations(photos, pairs)
    world, frame, noise = _baselines(photos, frame_from_cam, pairs, centres, sigma)
    tagged = np.isfinite(gimbal[photos]).all(axis=(1, 2))
    down = np.tile([0.0, 0.0, -1.0], (len(photos), 1))
    spread = np.linalg.svd(world, compute_uv=False) if len(world) else np.zeros(3)
    guessed = not tagged.any() and (len(spread) < 2 or spread[1] < 0.1 * spread[0])
    axes = [np.where(tagged[:, None], gimbal[photos][:, :, c], down if c == 2 else 0.0) for c in range(3)]
    used = tagged if tagged.any() else np.ones(len(photos), bool)
    fits = []
    for columns in ((2,), (0, 1, 2)) if tagged.any() else ((2,),):
        w = np.concatenate([world, *(axes[c][used] for c in columns)])
        f = np.concatenate([frame, *(frame_from_cam[used][:, :, c] for c in columns)])
        axis_sigma = _AXIS_SIGMA if tagged.any() else 0.5
        s = np.concatenate([noise, np.full(len(w) - len(world), axis_sigma)])
        start = _wahba(w, f, 1.0 / s**2)
        fits.append((*_robust_wahba(w, f, s, start), len(columns)))
    R = _best(fits, world, frame, noise, axes, frame_from_cam, used)
    world_from_cam = R @ frame_from_cam
    angle = np.array(
        [
            np.linalg.norm(so3_log(V @ G.T)) if ok else 0.0
            for V, G, ok in zip(world_from_cam, gimbal[photos], tagged, strict=True)
        ]
    )
    agrees = tagged & (angle < _AGREES)
    world_from_cam[agrees] = gimbal[photos][agrees]
    return Oriented(photos, world_from_cam, photos[tagged & ~agrees], guessed)


def _best(
    fits: list[tuple[F64, float, int]],
    world: F64,
    frame: F64,
    noise: F64,
    axes: list[F64],
    frame_from_cam: F64,
    used: Index,
) -> F64:
    """Return the rotation that fits baselines and all axes best: same yardstick for both starts."""

    def cost(R: F64) -> float:
        r2 = ((world - frame @ R.T) ** 2).sum(axis=1) / noise**2 if len(world) else np.zeros(0)
        a2 = [
            ((axes[c][used] - frame_from_cam[used][:, :, c] @ R.T) ** 2).sum(axis=1) / _AXIS_SIGMA**2 for c in range(3)
        ]
        return float(np.log1p(r2).sum() + sum(np.log1p(a).sum() for a in a2))

    return min((R for R, _, _ in fits), key=cost)
