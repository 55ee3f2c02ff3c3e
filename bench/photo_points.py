"""Points of drawn photos like those of structure from motion: features that three photos share, at the true poses.

Coverage is measured on these beside the cells: swaying leaves, plain shade and ground in one photo have no such point.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.geometry import Camera, Pose
from alight.jobs import InTurn
from alight.motion.triangulation import triangulate_rays
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import BundleObservations, extract_all, match_pairs, neighbours, tracks
from alight.records import Frame
from alight.runner.opening import open_source
from alight.settings import BundleSettings, Settings

TRACK, MOST_PX = 3, 1.0  # photos of a point, and its largest error: as of a real reference
NAME = "points.npy"


class Seen(NamedTuple):
    """Observations that the photos share, with their true poses and the camera."""

    observed: BundleObservations
    poses: list[Pose]  # world_from_cam, the true ones
    camera: Camera


def shared_points(photos: Path) -> F64:
    """The points (N, 3), metres in the simulator's world; kept beside the photos."""
    path = photos.parent / NAME
    if not path.exists():
        np.save(path, triangulated(features_of(photos)))
    return np.asarray(np.load(path))


def features_of(photos: Path) -> Seen:
    """Features of all photos, matched."""
    z = np.load(photos.parent / "flown.npz")
    true = {int(s): Pose(r, c) for s, r, c in zip(z["seconds"], z["turns"], z["centres"], strict=True)}
    source, settings, jobs = open_source(photos, Settings()), BundleSettings(), InTurn()
    frames = [e for e in source.events() if isinstance(e, Frame) and e.t_ns // 10**9 in true]
    poses = [true[f.t_ns // 10**9] for f in frames]
    camera = source.rig.cameras[0].camera
    found = list(extract_all(frames, settings, jobs))
    wanted = neighbours(np.array([p.translation for p in poses]), settings.neighbours)
    lenses = PhotoLenses.one(camera, len(frames))
    pairs = [p for some in match_pairs(lenses, frames, found, wanted, settings, jobs) for p in some]
    return Seen(tracks(found, pairs), poses, camera)


def triangulated(seen: Seen) -> F64:
    """The points of at least `TRACK` photos that lie within `MOST_PX` of all of them."""
    o, centres = seen.observed, np.array([p.translation for p in seen.poses])
    turns = np.array([p.rotation for p in seen.poses])[o.photo]
    rays = np.einsum("nij,nj->ni", turns, seen.camera.rays(o.pixels))
    starts = np.append(o.starts, len(o.point))
    points = triangulate_rays(starts, rays, centres[o.photo], np.ones(len(rays)))
    inside = np.einsum("nji,nj->ni", turns, points[o.point] - centres[o.photo])
    miss = np.linalg.norm(seen.camera.project(inside) - o.pixels, axis=1)
    worst = np.maximum.reduceat(np.nan_to_num(miss, nan=np.inf), o.starts)
    return np.asarray(points[(np.diff(starts) >= TRACK) & (worst < MOST_PX)])
