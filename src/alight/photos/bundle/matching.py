"""From photos to tracks: pairs of neighbours, matches verified by two-view geometry, tracks.

Two-view geometry is by pycolmap. Random seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from alight.arrays import F32, F64, I64, Mask
from alight.geometry import Camera
from alight.jobs import Jobs, Sent, Task
from alight.photos.bundle.features import PhotoFeatures, colmap, colmap_camera
from alight.photos.bundle.lenses import PhotoLenses
from alight.records import Frame

LEAST_MATCHED = 20  # least matches of a pair of photos after two-view geometry, and least observations of a photo
_RATIO = 0.8  # most allowed ratio of the best to the second-best descriptor distance
_TWO_VIEW_PX = 4.0  # px, inlier threshold; allows for the error of the nominal distortion in the corners


@dataclass(frozen=True, eq=False)
class Pair:
    """Two matched photos of the same ground."""

    i: int  # photo indices
    j: int
    matches: I64  # (M, 2) feature indices in i and j
    j_from_i: F64  # (3, 3) rotation between the two optical frames
    direction: F64  # (3,) unit vector from the centre of i to the centre of j, in the optical frame of i; zero: unknown


@dataclass(frozen=True, eq=False)
class BundleObservations:
    """Observations of all photos, sorted by point, then photo; no photo observes a point twice."""

    photo: I64  # (N,) photo indices
    point: I64  # (N,) point indices; each from 0 to points - 1 occurs
    pixels: F64  # (N, 2)
    by_patch: Mask  # (N,) True: located by patch matching; False: by the feature detector

    @property
    def starts(self) -> I64:
        """(m,) index of the first row of each point, as `np.add.reduceat` needs it."""
        return np.flatnonzero(np.diff(self.point, prepend=-1))

    def without(self, photos: I64) -> BundleObservations:
        """Return the observations of all photos except those with the indices `photos`."""
        return self.keep(~np.isin(self.photo, photos))[0]

    @property
    def points(self) -> int:
        """Number of points."""
        return int(self.point[-1]) + 1 if len(self.point) else 0

    def keep(self, rows: Mask) -> tuple[BundleObservations, I64]:
        """Return the rows where `rows` is True, except points left with one photo, and the kept points' old indices."""
        count = np.bincount(self.point[rows], minlength=self.points)
        rows = rows & (count[self.point] >= 2)
        old, point = np.unique(self.point[rows], return_inverse=True)
        return BundleObservations(self.photo[rows], point.astype(np.int64), self.pixels[rows], self.by_patch[rows]), old


def neighbours(positions: F64, count: int) -> list[tuple[int, int]]:
    """Choose pairs (i, j) of photos to match, i < j.

    A photo is paired with its `count` nearest photos, with the nearest in each of eight directions, which links
    neighbouring strips, and with the next in time. A photo without a position is paired with the `count` photos before
    and after it in time. `positions` is (n, 3) metres in order of time, NaN where unknown.
    """
    n = len(positions)
    pairs: set[tuple[int, int]] = set()
    for i in range(n):
        offset = positions[:, :2] - positions[i, :2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        distance[i] = np.nan
        order = np.argsort(distance)[: np.isfinite(distance).sum()]
        near = [int(j) for j in order[:count]]
        octant = np.floor(np.arctan2(offset[:, 1], offset[:, 0]) / (np.pi / 4))
        near += [int(order[octant[order] == k][0]) for k in np.unique(octant[order])]
        unknown = not np.isfinite(distance).any()
        reach = count if unknown else 1
        near += [j for j in range(i - reach, i + reach + 1) if 0 <= j < n and j != i]
        pairs |= {(min(i, j), max(i, j)) for j in near}
    return sorted(pairs)


def match_descriptors(a: F32, b: F32) -> I64:
    """Match unit descriptors (K, 128) and (L, 128) by mutual best match and ratio test; return indices (M, 2)."""
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), dtype=np.int64)
    score = a @ b.T
    rows, best = np.arange(len(a)), score.argmax(axis=1)
    first, mutual = score[rows, best], score.argmax(axis=0)[best] == rows
    score[rows, best] = -2.0
    clear = 1.0 - first < _RATIO**2 * (1.0 - score.max(axis=1))
    return np.asarray(np.stack([rows, best], axis=1)[mutual & clear])


def verify(
    cameras: tuple[Camera, Camera], a: PhotoFeatures, b: PhotoFeatures, matches: I64
) -> tuple[I64, F64, F64] | None:
    """Return inliers of `matches` (M, 2), rotation and direction (see `Pair`) by two-view geometry of photos `a`, `b`.

    None if there are fewer than `LEAST_MATCHED` inliers.
    """
    if len(matches) < LEAST_MATCHED:
        return None
    pc, one, other = colmap(), *(colmap_camera(c) for c in cameras)
    options = pc.TwoViewGeometryOptions()
    options.compute_relative_pose = True
    options.min_num_inliers = LEAST_MATCHED
    options.ransac.random_seed = 1
    options.ransac.max_error = _TWO_VIEW_PX * max(1.0, cameras[0].width / 1600)
    g = pc.estimate_two_view_geometry(one, a.pixels + 0.5, other, b.pixels + 0.5, matches.astype(np.uint32), options)
    if g.cam2_from_cam1 is None or len(g.inlier_matches) < LEAST_MATCHED:
        return None
    R = np.asarray(g.cam2_from_cam1.rotation.matrix())
    t = np.asarray(g.cam2_from_cam1.translation)
    length = float(np.linalg.norm(t))
    direction = -R.T @ t / length if length > 1e-12 else np.zeros(3)
    return np.asarray(g.inlier_matches, dtype=np.int64), R, direction


def match_photo(
    cameras: Sequence[Camera], first: PhotoFeatures, others: Sequence[PhotoFeatures], ij: I64
) -> list[Pair | None]:
    """Match photo `first` with each of `others`; return one verified pair for each, None where the photos do not match.

    `ij` (N, 2) are the photo indices of each pair. `cameras` are the first photo's camera, then the other photos'
    cameras.
    """
    out = list[Pair | None]()
    for (i, j), other, camera in zip(ij.tolist(), others, cameras[1:], strict=True):
        matches = match_descriptors(first.unit, other.unit)
        found = verify((cameras[0], camera), first, other, matches)
        out.append(None if found is None else Pair(i, j, *found))
    return out


def match_pairs(
    lenses: PhotoLenses,
    frames: Sequence[Frame],
    features: Sequence[PhotoFeatures],
    wanted: Sequence[tuple[int, int]],
    jobs: Jobs,
) -> Iterator[list[Pair]]:
    """Match and verify the pairs (i, j) in `wanted`; yield one list for each photo i with the pairs that match."""

    def sent(k: int) -> Sent:
        return Sent(f"features-{frames[k].t_ns}", features[k])

    def task(i: int, others: Sequence[int]) -> Task:
        about = " ".join(f"{k} {frames[k].t_ns}" for k in (i, *others))
        ij = np.array([(i, j) for j in others])
        cameras = tuple(lenses.of_photo(k) for k in (i, *others))
        arguments = cameras, sent(i), tuple(sent(j) for j in others), ij
        return Task(f"pairs-{frames[i].t_ns}", match_photo, arguments, about)

    of: dict[int, list[int]] = {}
    for i, j in wanted:
        of.setdefault(i, []).append(j)
    for found in jobs.run((task(i, others) for i, others in of.items()), at_once=True):
        yield [p for p in found if p is not None]


def tracks(features: Sequence[PhotoFeatures], pairs: Sequence[Pair]) -> BundleObservations:
    """Join matches that share a feature into tracks; tracks with two features in one photo are wrong and removed."""
    offset = np.concatenate([[0], np.cumsum([len(f.pixels) for f in features])])
    total = int(offset[-1])
    if not pairs:
        return BundleObservations(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0, bool))
    edges = np.concatenate([p.matches + np.array([offset[p.i], offset[p.j]]) for p in pairs])
    graph = sparse.coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(total, total))
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    node = np.unique(edges)
    photo = np.searchsorted(offset, node, side="right") - 1
    pixels = np.concatenate([f.pixels for f in features])[node]
    order = np.lexsort((photo, label[node]))
    point = np.unique(label[node][order], return_inverse=True)[1]
    sorted_photo = photo[order]
    twice = (np.diff(point, prepend=-1) == 0) & (np.diff(sorted_photo, prepend=-1) == 0)
    clean = ~np.isin(point, point[twice])
    by_patch = np.zeros(len(order), dtype=bool)
    found = BundleObservations(sorted_photo.astype(np.int64), point.astype(np.int64), pixels[order], by_patch)
    return found.keep(clean)[0]
