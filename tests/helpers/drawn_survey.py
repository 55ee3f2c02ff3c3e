"""Surveys as points and observations, without pictures: tags with noise, relief, and a focal length that is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.geometry import Camera, Pose, enu_from_flu, so3_exp
from alight.photos.bundle.adjust import solve_bundle
from alight.photos.bundle.height_check import HeightCheck, check_heights
from alight.photos.bundle.matching import BundleObservations, Pair
from alight.photos.bundle.priors import make_priors
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.records import NavSample, Rig, RigCamera
from alight.settings import BundleSettings

F64 = NDArray[np.float64]
CAMERA = Camera(800, 600, 700.0, 700.0, 399.5, 299.5)


@dataclass(frozen=True)
class Survey:
    """A survey of three strips of six photos; metres and rad."""

    seed: int
    heights: tuple[float, ...] = (60.0,)  # of the strips in turn, above the mean ground
    relief: float = 1.0  # from the lowest ground to the highest
    slope: float = 0.0
    oblique: float = 0.0  # pitch of every third photo from nadir
    gps: float = 2.0  # 1-sigma, of which nearly all is common to the photos of a flight
    tagged: bool = True  # with heights above take-off, good to 2 m

    def ground(self, xy: F64) -> F64:
        """Heights (n,) of places (n, 2): waves about as long as the survey."""
        turn = np.random.default_rng(self.seed).uniform(0, 6, 2)
        waves = np.sin(xy[:, 0] / 17 + turn[0]) + np.sin(xy[:, 1] / 13 + turn[1])
        return np.asarray(self.relief / 4 * waves + self.slope * xy[:, 0])

    def checked(self, ratio: float = 1.0) -> HeightCheck:
        """Adjust the survey with a focal length that is too short by a ratio, and check its heights."""
        rng = np.random.default_rng(self.seed)
        centres, body = self._flight(rng)
        xy = rng.uniform(centres[:, :2].min(axis=0) - 25, centres[:, :2].max(axis=0) + 25, (700, 2))
        points = np.column_stack([xy, self.ground(xy)])
        obs = _observed(centres, body, points, rng)
        sigma = self.gps * np.array([1, 1, 1.5])
        common = rng.normal(0, sigma)
        nav = [
            NavSample(
                k, C + common + rng.normal(0, 0.3 * sigma), B @ so3_exp(rng.normal(0, 0.01, 3)),
                sigma_position=sigma, sigma_attitude=np.array([0.02, 0.02, 0.1]),
            )
            for k, (C, B) in enumerate(zip(centres, body, strict=True))
        ]  # fmt: skip
        used = replace(CAMERA, fu=CAMERA.fu / ratio, fv=CAMERA.fv / ratio)
        settings = BundleSettings.model_validate({"lens": "held"})
        priors = make_priors(nav, Rig((RigCamera("cam0", used, Pose(BODY_FROM_CAM.rotation)),)), settings)
        solved = solve_bundle(obs, _pairs(centres, body, obs), priors, settings)
        assert solved is not None
        take_off = self.ground(rng.uniform(centres[:, :2].min(axis=0), centres[:, :2].max(axis=0))[None])[0]
        drift = np.clip(rng.normal(0, 0.8), -2, 2) + rng.normal(0, 0.2, len(centres))
        above = centres[:, 2] - take_off + drift if self.tagged else np.full(len(centres), np.nan)
        use = solved.registered
        return check_heights(solved.score, solved.state.centres[use, 2], above[use], solved.state.points)

    def _flight(self, rng: np.random.Generator) -> tuple[F64, F64]:
        centres, body = [], []
        for strip in range(3):
            up = self.heights[strip % len(self.heights)]
            for k in range(6):
                centres.append(np.array([0.2 * up * k, 0.35 * self.heights[0] * strip, up]) + rng.normal(0, 0.4, 3))
                pitch = -np.pi / 2 + (self.oblique if len(centres) % 3 == 0 else 0.0)
                yaw = np.pi / 2 if strip % 2 == 0 else -np.pi / 2
                body.append(so3_exp(rng.normal(0, 0.02, 3)) @ enu_from_flu(yaw, pitch, 0.0))
        return np.array(centres), np.array(body)


def _observed(centres: F64, body: F64, points: F64, rng: np.random.Generator) -> BundleObservations:
    rows: list[tuple[Any, ...]] = []
    for i, (C, B) in enumerate(zip(centres, body, strict=True)):
        pixels = CAMERA.project((points - C) @ (B @ BODY_FROM_CAM.rotation))
        inside = ((pixels > 0) & (pixels < [CAMERA.width - 1, CAMERA.height - 1])).all(axis=1)
        rows += [(k, i, *(pixels[k] + rng.normal(0, 0.3, 2))) for k in np.flatnonzero(inside)]
    table = np.array(sorted(rows))
    every = BundleObservations(
        table[:, 1].astype(np.int64), np.unique(table[:, 0], return_inverse=True)[1].astype(np.int64), table[:, 2:],
        np.zeros(len(table), bool),
    )  # fmt: skip
    return every.keep(np.ones(len(table), bool))[0]


def _pairs(centres: F64, body: F64, obs: BundleObservations) -> Sequence[Pair]:
    R, out = body @ BODY_FROM_CAM.rotation, []
    seen = [set(obs.point[obs.photo == i]) for i in range(len(centres))]
    for i, j in combinations(range(len(centres)), 2):
        count, way = len(seen[i] & seen[j]), R[i].T @ (centres[j] - centres[i])
        if count > 30:
            matches = np.zeros((count, 2), np.int64)
            out.append(Pair(i, j, matches, R[j].T @ R[i], way / np.linalg.norm(way)))
    return out
