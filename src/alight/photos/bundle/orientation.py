"""Initial poses: relative rotations are averaged, then aligned with the world by GPS baselines and gimbal attitudes.

Images decide. A gimbal tag is used only if it agrees with the images, so tags that are half a turn off do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial.transform import Rotation

from alight.arrays import F64, I64, Mask
from alight.geometry import so3_exp, so3_log
from alight.photos.bundle.matching import Pair
from alight.photos.bundle.priors import COMMON_HEADING, HALF_TURN, gps_heading_sigma, levelled
from alight.photos.bundle.solver import Priors

_MAX_DISAGREEMENT = 0.35  # rad between gimbal and images; chains of rotations drift by a third of it
_AXIS_SIGMA = 0.15  # rad, 1-sigma of an axis by the gimbal in the absolute orientation
_MOST_COMMON_HEADING = 1.2  # rad; tags with a larger error are half a turn off, or useless
_DIRECTION_SIGMA = 0.1  # rad, 1-sigma of a direction between photos; over flat ground it correlates with the rotation
_NADIR_SIGMA = 0.5  # rad, 1-sigma of a camera that is assumed to look straight down, if no photo has an attitude
_MAX_BASELINE_ERROR = 5.0  # sigmas; a baseline with a larger error is wrong


@dataclass(frozen=True, eq=False)
class _Oriented:
    """Initial poses of the photos of one connected component."""

    photos: I64  # (k,) photo indices
    world_from_cam: F64  # (k, 3, 3)
    turned: I64  # indices of photos whose gimbal tag is half a turn off about the optical axis
    contradicted: I64  # indices of photos whose gimbal tag contradicts the pictures in any other way
    jumped: I64  # indices of photos whose GPS position contradicts the pictures
    guessed: bool  # whether the roll about a straight line of flight assumes that the camera looks down
    cost: float  # Cauchy cost of GPS baselines and attitudes
    baselines: int  # number of baselines
    heading: float  # rad, common error of the headings of all tags, clockwise from above


@dataclass(frozen=True, eq=False)
class FirstPoses:
    """Initial poses of all photos, and the tags that the images contradict."""

    centres: F64  # (n, 3) metres
    rotations: F64  # (n, 3, 3) world_from_cam
    groups: tuple[I64, ...]  # photo indices, grouped by connection through matches
    photos: I64  # indices of photos with a pose
    turned: I64  # indices of photos whose attitude tag is half a turn off
    contradicted: I64  # indices of photos whose attitude tag is wrong
    overruled: I64  # indices of photos whose heading tag has an error common to its group
    jumped: I64  # indices of photos whose GPS position is wrong
    warnings: list[str]
    climbs: bool  # whether a level flight fits better than the altitude tags, which are then ignored


def first_poses(pairs: Sequence[Pair], priors: Priors) -> FirstPoses | None:
    """Return initial poses for every connected component; None if no two photos with GPS are connected.

    If half of the altitude tags are more than two sigmas off the median altitude, a level flight at that altitude is
    tried; it is used if it lowers the cost by more than 0.1 per baseline.
    """
    n = len(priors.centres)
    gimbal = priors.world_from_body @ priors.body_from_cam
    rotations, centres = np.tile(np.eye(3), (n, 1, 1)), _fill_missing(priors.centres, pairs)
    located = np.asarray(np.isfinite(priors.centres).all(axis=1))
    groups = [g for g in components(n, pairs) if located[g].sum() >= 2]
    if not groups:
        return None
    found = [_orient(g, pairs, priors.centres, priors.sigma_centres, gimbal) for g in groups]
    level, climbs = levelled(priors), False
    off = np.abs(priors.centres - level.centres)[:, 2] / priors.sigma_centres[:, 2]
    if float(np.nanmedian(off)) > 2.0:
        flat = [_orient(g, pairs, level.centres, priors.sigma_centres, gimbal) for g in groups]
        gain = sum(f.cost for f in found) - sum(f.cost for f in flat)
        climbs = gain > 0.1 * sum(f.baselines for f in found)
        if climbs:
            found, centres = flat, _fill_missing(level.centres, pairs)
    for f in found:
        rotations[f.photos] = f.world_from_cam
    warnings = [
        f"{len(f.photos)} photos in one line without attitude: the camera is taken to look straight down"
        for f in found
        if f.guessed
    ]
    misled = [f for f in found if abs(f.heading) > max(0.2, 3.0 * gps_heading_sigma(f.photos, priors))]  # rad, sigmas
    warnings += [
        f"the headings in the attitude tags of {len(f.photos)} photos are off by {np.degrees(f.heading):+.0f} degrees "
        "alike: GPS and the pictures decide"
        for f in misled
    ]
    overruled = np.concatenate([*(f.photos for f in misled), np.empty(0, np.int64)])
    photos, turned, wrong, jumped = (
        np.sort(np.concatenate([getattr(f, name) for f in found]))
        for name in ("photos", "turned", "contradicted", "jumped")
    )
    return FirstPoses(centres, rotations, tuple(groups), photos, turned, wrong, overruled, jumped, warnings, climbs)


def _fill_missing(centres: F64, pairs: Sequence[Pair]) -> F64:
    """Return the positions `centres` (n, 3), with missing ones (NaN) filled from matched photos.

    A missing position becomes the mean position of matched photos, weighted by matches; without any, it becomes 0.
    """
    matches, out = np.zeros((len(centres), len(centres))), centres.copy()
    for p in pairs:
        matches[p.i, p.j] = matches[p.j, p.i] = len(p.matches)
    while True:
        known = np.asarray(np.isfinite(out).all(axis=1))
        weight = matches @ known
        new = ~known & (weight > 0)
        if not new.any():
            return np.nan_to_num(out)
        out[new] = (matches @ np.where(known[:, None], out, 0.0))[new] / weight[new, None]


def components(count: int, pairs: Sequence[Pair]) -> list[I64]:
    """Return the photo indices of each connected component of two or more photos, largest component first."""
    if not pairs:
        return []
    ij = np.array([(p.i, p.j) for p in pairs])
    graph = sparse.coo_array((np.ones(len(ij)), (ij[:, 0], ij[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label)
    return [np.flatnonzero(label == k) for k in np.argsort(-sizes, kind="stable") if sizes[k] > 1]


def _median_rotation(rotations: F64, start: F64) -> F64:
    """Return the geometric median (3, 3) of rotations (k, 3, 3) by Weiszfeld steps from the rotation `start`."""
    R = start
    for _ in range(3):
        logs = so3_log(rotations @ R.T)
        weight = 1.0 / np.maximum(np.linalg.norm(logs, axis=1), 1e-3)
        R = so3_exp((weight[:, None] * logs).sum(axis=0) / weight.sum()) @ R
    return R


def average_rotations(photos: I64, pairs: Sequence[Pair]) -> F64:
    """Return (k, 3, 3) `frame_from_cam` of the k photos of one component; the frame is the first photo's camera.

    The spanning tree of the pairs with most matches gives initial rotations. Then each photo takes the median of the
    rotations that its neighbours predict (L1 rotation averaging, Hartley et al. 2011 and 2013).
    """
    slot = {int(p): s for s, p in enumerate(photos)}
    edges = [(slot[p.i], slot[p.j], p.j_from_i, len(p.matches)) for p in pairs if p.i in slot]
    neighbours: list[list[tuple[int, F64]]] = [[] for _ in photos]  # (other, other_from_s) of s
    for i, j, j_from_i, _ in edges:
        neighbours[i].append((j, j_from_i))
        neighbours[j].append((i, j_from_i.T))
    e = np.array([(i, j, 1.0 / m) for i, j, _, m in edges])
    graph = sparse.coo_array((e[:, 2], (e[:, 0].astype(int), e[:, 1].astype(int))), shape=(len(photos),) * 2).tocsr()
    order, parent = breadth_first_order(minimum_spanning_tree(graph), 0, directed=False)
    R = np.tile(np.eye(3), (len(photos), 1, 1))
    for s in order[1:]:
        R[s] = next(R[o] @ Q for o, Q in neighbours[s] if o == parent[s])
    for _ in range(30):
        for s in order[1:]:
            R[s] = _median_rotation(np.array([R[o] @ Q for o, Q in neighbours[s]]), R[s])
    return R


@dataclass(frozen=True, eq=False)
class _Baselines:
    """Unit directions between photos, by GPS in the world and by the images in the frame of the averaged rotations."""

    ends: I64  # (q, 2) photo indices
    world: F64  # (q, 3)
    frame: F64  # (q, 3)
    noise: F64  # (q,) rad, 1-sigma

    def misfit(self, R: F64) -> F64:
        """Return the (q,) squared misfits under `world_from_frame` R, in sigmas."""
        return np.asarray(((self.world - self.frame @ R.T) ** 2).sum(axis=1) / self.noise**2)

    @property
    def in_line(self) -> bool:
        """Whether all directions are those of one line."""
        spread = np.linalg.svd(self.world, compute_uv=False)
        return len(spread) < 2 or bool(spread[1] < 0.1 * spread[0])

    def aligned(self) -> F64:
        """Return the best-fitting `world_from_frame`, with Cauchy weights (Wahba's problem)."""
        weight = 1.0 / self.noise**2
        for _ in range(21):
            R = np.asarray(Rotation.align_vectors(self.world, self.frame, weights=weight)[0].as_matrix())
            weight = 1.0 / (self.noise**2 * (1.0 + self.misfit(R)))
        return R


def _baselines(photos: I64, frame_from_cam: F64, pairs: Sequence[Pair], centres: F64, sigma: F64) -> _Baselines:
    slot = {int(p): s for s, p in enumerate(photos)}
    own = [p for p in pairs if p.i in slot and p.direction.any()]
    ends = np.array([(p.i, p.j) for p in own], dtype=np.int64).reshape(-1, 2)
    frame = np.array([frame_from_cam[slot[p.i]] @ p.direction for p in own]).reshape(-1, 3)
    way = centres[ends[:, 1]] - centres[ends[:, 0]]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    used = length[:, 0] > 1e-6  # False for NaN
    ends, frame, way, length = ends[used], frame[used], way[used], length[used]
    noise = np.hypot(_DIRECTION_SIGMA, 1.5 * np.linalg.norm(sigma[ends], axis=(1, 2)) / length[:, 0])
    return _Baselines(ends, way / length, frame, noise)


def _jumped(base: _Baselines, R: F64) -> I64:
    """Return the photos whose GPS position is wrong: more than 60 % of their baselines misfit `world_from_frame` R."""
    is_wrong = base.misfit(R) > _MAX_BASELINE_ERROR**2
    left = np.ones(len(is_wrong), dtype=bool)
    out: list[int] = []
    while left.any():
        numbers = np.unique(base.ends[left])
        share = [is_wrong[left & (base.ends == k).any(axis=1)].mean() for k in numbers]
        worst = int(np.argmax(share))
        if share[worst] <= 0.6:
            break
        out.append(int(numbers[worst]))
        left &= ~(base.ends == out[-1]).any(axis=1)
    return np.array(sorted(out), dtype=np.int64)


def _orient(photos: I64, pairs: Sequence[Pair], centres: F64, sigma: F64, gimbal: F64) -> _Oriented:
    """Align the averaged rotations of one component with the world.

    `centres` (n, 3) metres, `sigma` (n, 3) and `gimbal` (n, 3, 3) world_from_cam cover all photos, NaN = unknown.
    Directions between photos are compared with GPS baselines, and camera axes with the gimbal, with robust weights. The
    best of three alignments is used: by gimbal, by gimbal without heading, by cameras that look down. The heading error
    that all tags share enters the cost once, not once per photo. If most tags are wrong, no tags are used.
    """
    frame_from_cam = average_rotations(photos, pairs)
    base = _baselines(photos, frame_from_cam, pairs, centres, sigma)
    tags = gimbal[photos]
    tagged = np.asarray(np.isfinite(tags).all(axis=(1, 2)))
    down = np.tile(np.diag([1.0, -1.0, -1.0]), (len(photos), 1, 1))
    starts = [_world_from_frame(base, down, frame_from_cam, (2,), _NADIR_SIGMA)]
    if tagged.any():
        axes = ((2,), (0, 1, 2))
        starts += [_world_from_frame(base, tags[tagged], frame_from_cam[tagged], c, _AXIS_SIGMA) for c in axes]
    cost, R = min(((_cost(base, tags[tagged], frame_from_cam[tagged], R), R) for R in starts), key=lambda c: c[0])
    world_from_cam = R @ frame_from_cam
    heading = _common_heading(world_from_cam[tagged], tags[tagged])
    tags = so3_exp([0.0, 0.0, heading]) @ tags
    agrees = tagged & _agree(world_from_cam, tags)
    turned = tagged & ~agrees & _agree(world_from_cam, tags @ HALF_TURN)
    wrong = tagged & ~agrees & ~turned
    if 2 * wrong.sum() > tagged.sum():
        without = _orient(photos, pairs, centres, sigma, np.full_like(gimbal, np.nan))
        return replace(without, contradicted=photos[tagged])
    world_from_cam[agrees] = tags[agrees]
    world_from_cam[turned] = tags[turned] @ HALF_TURN
    return _Oriented(
        photos, world_from_cam, photos[turned], photos[wrong], _jumped(base, R), not tagged.any() and base.in_line,
        cost, len(base.noise), heading,
    )  # fmt: skip


def _world_from_frame(base: _Baselines, tags: F64, frame_from_cam: F64, axes: tuple[int, ...], sigma: float) -> F64:
    """Return the `world_from_frame` that fits best, by the baselines and by camera axes of k photos.

    `tags` are `world_from_cam` (k, 3, 3) by the tags, and `frame_from_cam` is (k, 3, 3). `axes`: indices of the camera
    axes to use, 2 is the optical axis; `sigma`: 1-sigma of an axis in rad.
    """
    world = np.concatenate([base.world, *(tags[:, :, c] for c in axes)])
    frame = np.concatenate([base.frame, *(frame_from_cam[:, :, c] for c in axes)])
    noise = np.concatenate([base.noise, np.full(len(axes) * len(tags), sigma)])
    return replace(base, world=world, frame=frame, noise=noise).aligned()


def _cost(base: _Baselines, tags: F64, frame_from_cam: F64, R: F64) -> float:
    """Return the Cauchy cost of `world_from_frame` R, over the baselines and all camera axes of k photos.

    `tags` are `world_from_cam` (k, 3, 3) by the tags, and `frame_from_cam` is (k, 3, 3).
    """
    heading = _common_heading(R @ frame_from_cam, tags)
    axes = ((so3_exp([0.0, 0.0, heading]) @ tags - R @ frame_from_cam) ** 2).sum(axis=1) / _AXIS_SIGMA**2
    common = (heading / COMMON_HEADING) ** 2
    return float(np.log1p(base.misfit(R)).sum() + np.log1p(axes).sum() + common)


def _common_heading(world_from_cam: F64, tags: F64) -> float:
    """Return the heading error (rad) common to the tags (k, 3, 3), against `world_from_cam`; 0 if none or too large."""
    if not len(tags):
        return 0.0
    off = world_from_cam @ np.swapaxes(tags, 1, 2)
    angles = np.arctan2(off[:, 1, 0] - off[:, 0, 1], off[:, 0, 0] + off[:, 1, 1])
    middle = float(np.angle(np.exp(1j * angles).sum()))
    middle += float(np.median(np.angle(np.exp(1j * (angles - middle)))))
    return middle if abs(middle) < _MOST_COMMON_HEADING else 0.0


def _agree(a: F64, b: F64) -> Mask:
    """Return the mask (k,) of rotations a and b (k, 3, 3) that agree to `_MAX_DISAGREEMENT`; False for NaN."""
    cosine = 0.5 * (np.einsum("kij,kij->k", a, b) - 1.0)
    return np.asarray(cosine > np.cos(_MAX_DISAGREEMENT))
