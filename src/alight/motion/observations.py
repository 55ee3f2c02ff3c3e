"""Observations of features over a window of rig poses: one dense array, one row per feature, one column per pose.

The window of the filter is its clones (MSCKF, Mourikis and Roumeliotis 2007). Each observation is used only once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.geometry import Camera, Pose
from alight.motion.rotation_kernels import move_poses, place_cameras
from alight.records import Tracks
from alight.settings import FilterSettings


def positions(ascending: I64, ids: I64) -> I64:
    """Return the (N,) indices of `ids` in the array `ascending`, -1 for ids that it does not contain."""
    if not len(ascending):
        return np.full(len(ids), -1)
    at = np.minimum(np.searchsorted(ascending, ids), len(ascending) - 1)
    return np.where(ascending[at] == ids, at, -1)


def observation_sigma(tracks: Tracks, camera: Camera, noise: FilterSettings) -> F64:
    """Return the (N,) 1-sigma of the tracks' normalised coordinates, proportional to 1 / sqrt(texture) (M13)."""
    texture = np.full(len(tracks.ids), noise.texture_reference) if tracks.texture is None else tracks.texture
    relative = np.sqrt(noise.texture_reference / np.maximum(texture, 1e-9))
    return np.asarray(np.clip(relative, 0.5, 4.0) * (noise.pixel_sigma / camera.fu))


@dataclass(frozen=True, eq=False)
class WindowObservations:
    """Observations of N features from K poses by C cameras."""

    ids: I64  # (N,)
    normalised: F64  # (N, K, C, 2) normalised coordinates, NaN = not observed
    sigma: F64  # (N, K) 1-sigma of a normalised coordinate

    @classmethod
    def empty(cls, cameras: int) -> WindowObservations:
        """Return a window without features and poses; `cameras`: number of cameras."""
        return cls(np.empty(0, np.int64), np.empty((0, 0, cameras, 2)), np.empty((0, 0)))

    @property
    def observed(self) -> Mask:
        """Mask (N, K): whether at least one camera observed the feature at the pose."""
        return np.asarray(np.isfinite(self.normalised[..., 0]).any(axis=2))

    def select(self, which: Mask | I64) -> WindowObservations:
        """Return the observations of the features at the indices or mask `which`."""
        return WindowObservations(self.ids[which], self.normalised[which], self.sigma[which])

    def without_poses(self, dropped: Sequence[int]) -> WindowObservations:
        """Return the observations without the poses at the indices `dropped`."""
        if not len(dropped):
            return self
        normalised, sigma = (np.delete(a, dropped, axis=1) for a in (self.normalised, self.sigma))
        return replace(self, normalised=normalised, sigma=sigma)

    def with_pose(self, ids: I64, normalised: F64, sigma: F64) -> WindowObservations:
        """Return the observations with one more pose; features that are known keep their row, new ones are appended.

        Args:
            ids: (M,) ids of the features observed at the pose, ascending.
            normalised: (M, C, 2) normalised coordinates, NaN = not observed by that camera.
            sigma: (M,) 1-sigma of a normalised coordinate.
        """
        theirs = positions(ids, self.ids)
        mine = np.flatnonzero(theirs >= 0)
        theirs = theirs[mine]
        new = np.delete(np.arange(len(ids)), theirs)
        n, k = self.sigma.shape
        all_normalised = np.full((n + len(new), k + 1, *self.normalised.shape[2:]), np.nan)
        all_sigma = np.ones((n + len(new), k + 1))
        all_normalised[:n, :k], all_sigma[:n, :k] = self.normalised, self.sigma
        all_normalised[mine, k], all_sigma[mine, k] = normalised[theirs], sigma[theirs]
        all_normalised[n:, k], all_sigma[n:, k] = normalised[new], sigma[new]
        return WindowObservations(np.concatenate([self.ids, ids[new]]), all_normalised, all_sigma)


@dataclass(frozen=True, eq=False)
class Clones:
    """Poses of the rig at K earlier exposures, oldest first, and their first estimates, where Jacobians are taken."""

    stamps: tuple[int, ...]  # ns
    R: F64  # (K, 3, 3) world_from_rig
    p: F64  # (K, 3) m
    first_R: F64  # noqa: N815
    first_p: F64  # first estimates of R and p

    @classmethod
    def none(cls) -> Clones:
        """Return an empty set of clones."""
        return cls((), *(np.zeros((0, *shape)) for shape in ((3, 3), (3,)) * 2))

    def __len__(self) -> int:
        return len(self.stamps)

    def with_pose(self, t_ns: int, R: F64, p: F64) -> Clones:
        """Return the clones with the rig pose `R` (3, 3), `p` (3,), stamped `t_ns`, appended as the newest."""
        pairs = ((self.R, R), (self.p, p), (self.first_R, R), (self.first_p, p))
        return Clones((*self.stamps, t_ns), *(np.concatenate([old, new[None]]) for old, new in pairs))

    def select(self, kept: Sequence[int]) -> Clones:
        """Return the clones at the indices `kept`."""
        at = list(kept)
        arrays = (a[at] for a in (self.R, self.p, self.first_R, self.first_p))
        return Clones(tuple(self.stamps[i] for i in at), *arrays)

    def moved(self, error: F64) -> Clones:
        """Return the clones with `error` (6K,) added: rotation [rad], position [m] per clone; first estimates stay."""
        R, p = np.empty_like(self.R), np.empty_like(self.p)
        move_poses(self.R, self.p, error, R, p)
        return replace(self, R=R, p=p)


def cameras_at(R: F64, p: F64, cams: Sequence[Pose]) -> tuple[F64, F64]:
    """Return rotation (K, C, 3, 3) and centre (K, C, 3) of world_from_cam for every camera at every rig pose.

    Args:
        R, p: (K, 3, 3), (K, 3) world_from_rig.
        cams: rig_from_cam of the C cameras.
    """
    rotations, centres = np.empty((len(R), len(cams), 3, 3)), np.empty((len(R), len(cams), 3))
    for i, cam in enumerate(cams):
        place_cameras(R, p, cam.rotation, cam.translation, rotations[:, i], centres[:, i])
    return rotations, centres
