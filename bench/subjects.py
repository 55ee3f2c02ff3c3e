"""Subjects of the realism table: a recording, its true poses, and points of the ground with known height."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import mirafiori_reference as reference
import numpy as np
from common_points import common_points
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from alight.arrays import F64
from alight.evaluation.flight import FlightTruth, read_flight_truth
from alight.evaluation.photos import LEAST_TRACK, MOST_ERROR
from alight.geometry import LocalFrame, Pose
from alight.records import Frame, Terrain, View
from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources import Source

EARTH_RADIUS = 6371008.8  # metres, mean
OPEN_RISE = 0.4  # metres between the lowest and the highest point near by, at most, for ground that counts as open
NEAR = 0.75  # metres
STEP = 0.13  # of the height between the three views that make a point


@dataclass(frozen=True, eq=False)
class Points:
    """Ground whose height is known."""

    xyz: F64  # (N, 3) metres, world
    kind: NDArray[np.uint8]  # (N,) Terrain codes, 0 where the reference has no classes
    open: NDArray[np.bool_]  # (N,) the ground about it is smooth, and no water
    feature: NDArray[np.bool_]  # (N,) descriptors match there; a reference has only such places


@dataclass(frozen=True, eq=False)
class Subject:
    """One recording with true poses."""

    name: str
    source: Source
    settings: Settings
    poses: str  # argument of `alight run --poses`
    at: dict[int, Pose]  # world_from_body by time, ns
    truth: FlightTruth | None  # a flight's rasters
    cloud: F64 | None  # (N, 3) a reference's points

    def exposures(self) -> list[list[View]]:
        """The pictures of each exposure with their true poses, in order of time."""
        cams = self.source.rig.cameras
        return [
            [
                View(e.t_ns, i, image, cam.camera, self.at[e.t_ns] @ cam.body_from_cam)
                for i, (cam, image) in enumerate(zip(cams, e.images, strict=True))
                if image is not None
            ]
            for e in self.source.events()
            if isinstance(e, Frame) and e.images[0] is not None and e.t_ns in self.at
        ]

    def views(self) -> list[View]:
        """The left pictures."""
        return [shot[0] for shot in self.exposures()]

    def surface(self) -> NDArray[np.float32]:
        """The truth's heights above the origin, (R, C) metres."""
        assert self.truth is not None
        e, n = self.truth.grid.xy()
        fall = (e[None] ** 2 + n[:, None] ** 2) / (2 * EARTH_RADIUS)
        return np.asarray(self.truth.dem - self.source.local.height - fall, np.float32)

    def above(self, views: list[View]) -> float:
        """Median height of the cameras above the ground, metres."""
        ground = np.nanmedian(self.surface()) if self.cloud is None else np.median(self.cloud[:, 2])
        return float(np.median([v.centre[2] for v in views]) - ground)

    def points(self, views: list[View], above: float, count: int = 40_000) -> Points:
        """All points of a reference; else cells of the truth drawn evenly, and points like those of a reference."""
        if self.cloud is not None:
            n = len(self.cloud)
            return Points(self.cloud, np.zeros(n, np.uint8), _smooth_points(self.cloud), np.ones(n, bool))
        assert self.truth is not None
        height, grid, kind = self.surface(), self.truth.grid, self.truth.label
        box = np.ones((2 * round(NEAR / grid.cell) + 1,) * 2, np.uint8)
        smooth = (cv2.dilate(height, box) - cv2.erode(height, box) < OPEN_RISE) & (kind != Terrain.WATER)
        drawn = np.random.default_rng(0).permutation(np.flatnonzero(np.isfinite(height)))[:count]
        r, c = np.unravel_index(drawn, height.shape)
        e, n = grid.xy()
        even = Points(np.c_[e[c], n[r], height[r, c]], kind[r, c], smooth[r, c], np.zeros(len(r), bool))
        found = common_points(views, STEP * above)
        r, c = (np.rint(i).astype(int) for i in grid.index(found[:, 0], found[:, 1]))
        inside = (r >= 0) & (r < grid.rows) & (c >= 0) & (c < grid.cols)
        found, r, c = found[inside], r[inside], c[inside]
        own = Points(found, kind[r, c], smooth[r, c], np.ones(len(r), bool))
        return Points(
            *(np.concatenate([getattr(even, k), getattr(own, k)]) for k in ("xyz", "kind", "open", "feature"))
        )


def _smooth_points(cloud: F64) -> NDArray[np.bool_]:
    tree = cKDTree(cloud[:, :2])
    near = tree.query_ball_point(cloud[:, :2], NEAR)
    return np.array([len(k) >= 3 and np.ptp(cloud[k, 2]) < OPEN_RISE for k in near])


def flight(name: str, folder: Path) -> Subject:
    """A flight log with truth, the sample's or a simulated one."""
    source = open_source(folder, Settings())
    assert source.truth_trajectory is not None
    at = {int(t): p for t, p in zip(*source.truth_trajectory, strict=True)}
    return Subject(name, source, Settings(), "truth", at, read_flight_truth(folder), None)


def photos(name: str, folder: Path, scratch: Path) -> Subject:
    """Photos with a structure-from-motion reference: its poses, its lens and its points."""
    z = np.load(folder / "sfm_reference.npz")
    plain = open_source(folder / "images", Settings())
    at = reference.body_poses(plain, folder)
    scratch.mkdir(parents=True, exist_ok=True)
    poses, lens = scratch / "reference.tum", scratch / "reference.camchain.yaml"
    poses.write_text("\n".join(reference.tum_line(t, p) for t, p in sorted(at.items())) + "\n")
    lens.write_text(reference.camchain(z["image_wh"], z["camera_params"]))
    settings = Settings.model_validate({"sources": {"calibration": str(lens)}})
    source = open_source(folder / "images", settings)
    believed = (z["points_track"] >= LEAST_TRACK) & (z["points_err"] < MOST_ERROR)
    frame = LocalFrame(*z["origin_llh"])
    cloud = source.local.to_enu(*frame.to_geodetic(z["points_enu"][believed]))
    return Subject(name, source, settings, str(poses), at, None, np.asarray(cloud))
