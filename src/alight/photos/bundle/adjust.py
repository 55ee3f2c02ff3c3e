"""Motion of photos taken far apart: features, initial poses, and bundle adjustment with GPS, gimbal and lens priors.

Method and equation numbers: docs/method/bundle.md. Needs pycolmap (extra `photos`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from alight.arrays import F64, I64, Mask
from alight.geometry import Pose, skew
from alight.jobs import InTurn, Jobs, Task
from alight.photos.bundle.exposure import exposure_gains
from alight.photos.bundle.features import PhotoFeatures, colmap, extract_all, taken_by
from alight.photos.bundle.height_check import check_heights, score_focal
from alight.photos.bundle.matching import LEAST_MATCHED, BundleObservations, Pair, match_pairs, neighbours, tracks
from alight.photos.bundle.orientation import first_poses
from alight.photos.bundle.patch_matching import refine_observations
from alight.photos.bundle.priors import corrected_priors, levelled, make_priors, observable_lens, one_compass
from alight.photos.bundle.rounds import ROUNDS, coarse_rounds, do_rounds, resect, retriangulate
from alight.photos.bundle.solver import Adjustment, BundleState, Priors, residuals
from alight.photos.bundle.summary import (
    Solved,
    Survey,
    bundle_warnings,
    fixed_attitudes,
    notes_of,
    outcomes_of,
    why_no_motion,
)
from alight.pipeline.navigation import Navigation, Trajectory
from alight.pipeline.timing import Progress
from alight.records import Event, Frame, InputError, KeyframePosterior, Motion, NavSample, Rig
from alight.settings import BundleSettings
from alight.spread import robust_sigma


def adjust(
    frames: Sequence[Frame],
    nav: Sequence[NavSample | None],
    rig: Rig,
    settings: BundleSettings,
    progress: Callable[[float], None] = lambda _: None,
    jobs: Jobs | None = None,
    above: F64 | None = None,
) -> Trajectory:
    """Estimate the pose of every photo from the images, with GPS, gimbal attitude and calibration as priors.

    `nav[i]` belongs to `frames[i]`: position in metres, attitude world_from_body, and their sigmas; None: not measured.
    Of each frame, the first camera with a picture is used. A photo that cannot be registered gets a warning, but no
    motion. `jobs` extracts features and matches pairs; None: this process does. `above[i]` is the photo's height above
    take-off in metres (NaN: unknown), which is used to check the heights above ground.

    Raises:
        MissingExtraError: pycolmap is not installed.
        InputError: frames and nav differ in length.
    """
    colmap()
    if len(frames) != len(nav):
        raise InputError(f"{len(frames)} frames and {len(nav)} navigation samples: give one, or None, for each frame")
    tagged = make_priors(nav, rig, settings, np.array([taken_by(f) for f in frames], dtype=np.int64))
    jobs, features, pairs = jobs or InTurn(), list[PhotoFeatures](), list[Pair]()
    for found in extract_all(frames, settings, jobs):
        features.append(found)
        progress(0.35 * len(features) / len(frames))
    wanted = neighbours(tagged.centres, settings.neighbours)
    for n, matched in enumerate(match_pairs(tagged.lenses, frames, features, wanted, jobs), 1):
        pairs += matched
        progress(0.35 + 0.35 * n / len(frames))
    solved = solve_bundle(
        tracks(features, pairs), pairs, tagged, settings, lambda f: progress(0.7 + 0.3 * f),
        np.array([f.t_ns * 1e-9 for f in frames]), frames,
    )  # fmt: skip
    progress(1.0)
    wrong = () if solved is None else solved.first.contradicted
    attitude = any(n is not None and n.world_from_body is not None for k, n in enumerate(nav) if k not in wrong)
    if solved is None or not len(solved.registered):
        return Trajectory((), rig, (why_no_motion(features, tagged, solved),), {"registered": 0}, attitude=attitude)
    priors = replace(levelled(tagged) if solved.first.climbs else tagged, velocity=solved.priors.velocity)
    if above is None or solved.first.climbs:
        above = np.full(len(frames), np.nan)
    survey = Survey(frames, features, tagged, priors, solved, above)
    return replace(_trajectory(survey, rig, settings), attitude=attitude)


def solve_bundle(
    obs: BundleObservations,
    pairs: Sequence[Pair],
    priors: Priors,
    settings: BundleSettings,
    progress: Callable[[float], None] = lambda _: None,
    seconds: F64 | None = None,
    frames: Sequence[Frame] = (),
) -> Solved | None:
    """Find initial poses and refine them in rounds of bundle adjustment; None if no two photos are connected.

    Args:
        seconds: (n,) times of the photos in s; None: no rolling shutter is estimated.
        frames: the photos, in which observations are refined before the last adjustment; empty: not refined.
    """
    first = first_poses(pairs, priors)
    if first is None:
        return None
    photos, tagged = first.photos, priors
    priors = levelled(priors) if first.climbs else priors
    priors = one_compass(corrected_priors(priors, first.turned, first.contradicted), first.groups)
    priors = observable_lens(priors, photos)
    obs, _ = obs.keep(np.isin(obs.photo, photos))
    state = BundleState(
        first.centres, first.rotations, np.empty((0, 3)), np.zeros_like(priors.sigma_lens), np.zeros(3),
        np.zeros((len(first.centres), 2, 3)),
    )  # fmt: skip
    few, most = select(obs, min(300, settings.features)), obs
    state, priors, aside = coarse_rounds(state, few, priors, first.jumped, progress, seconds)
    placed = np.empty(0, dtype=np.int64)
    if len(aside):
        state, priors, placed = resect(state, most, aside, priors)
        lost = np.setdiff1d(aside, placed)
        few, most = (o.without(lost) for o in (few, most))
        photos = np.setdiff1d(photos, lost)
        state = do_rounds(state, few, priors, ROUNDS[-2])
    loss, cut = ROUNDS[-1]
    state = do_rounds(state, most, priors, ROUNDS[-1])
    progress(0.75)
    at, finer = retriangulate(state, most, priors, cut, loss)
    finer = refine_observations(at, finer, priors, frames) if frames else finer
    state, used = retriangulate(state, finer, priors, cut, loss)
    progress(0.85)
    sigmas = _pixel_sigmas(residuals(state, used, priors), used.by_patch)
    last = Adjustment(used, priors, sigmas, loss)
    state = last.solve(state, 30)
    joint, score = last.covariance(state), score_focal(used, priors, sigmas, loss, state)
    if first.climbs:  # all photos share a height error: the scatter of the altitude tags
        up = 6 * np.arange(len(priors.centres)) + 2
        joint[np.ix_(up, up)] += float(np.nanmean((tagged.centres[:, 2] - np.nanmedian(tagged.centres[:, 2])) ** 2))
    state, every = retriangulate(state, finer, priors, cut, loss)
    enough = np.bincount(every.photo, minlength=len(priors.centres)) >= LEAST_MATCHED
    registered = np.intersect1d(photos, np.flatnonzero(enough & fixed_attitudes(joint, len(priors.centres))))
    free = priors.sigma_lens > 0
    free[priors.lenses.readout_numbers] = False
    return Solved(state, registered, every, joint, first, placed, free, priors, score)


def _pixel_sigmas(residual: F64, by_patch: Mask) -> F64:
    """Return the 1-sigma (N,) in px of residuals (N, 2): one value where `by_patch` is True, and one elsewhere.

    A lower limit allows for errors that are correlated.
    """
    out = np.empty(len(residual))
    for which, least in ((~by_patch, 0.3), (by_patch, 0.1)):
        out[which] = max(least, robust_sigma(residual[which])) if which.any() else least
    return out


def select(obs: BundleObservations, cap: int) -> BundleObservations:
    """Return the observations of the longest tracks, added until every photo has `cap`, to bound time and memory."""
    length = np.bincount(obs.point)
    photos_of = np.split(obs.photo, obs.starts[1:])
    have = np.zeros(int(obs.photo.max(initial=0)) + 1, dtype=np.int64)
    take = np.zeros(len(length), dtype=bool)
    for k in np.argsort(-length, kind="stable"):
        if (have[photos_of[k]] < cap).any():
            take[k] = True
            have[photos_of[k]] += 1
    return obs.keep(take[obs.point])[0]


def _trajectory(survey: Survey, rig: Rig, settings: BundleSettings) -> Trajectory:
    solved, priors = survey.solved, survey.priors
    state, obs = solved.state, solved.observations
    lenses = priors.lenses.moved(state.lens)
    observed, gains = np.bincount(obs.photo, minlength=len(survey.frames)), exposure_gains(survey.features, obs)
    covariance, readouts, motions = solved.covariance.copy(), lenses.readout(np.arange(len(survey.frames))), []
    # fixes of one receiver share errors, which no mean over the photos makes smaller: the best fix bounds them
    sigmas = np.where(np.isfinite(priors.centres), priors.sigma_centres, np.inf)[solved.registered]
    shared = sigmas.min(axis=0, initial=np.inf)
    covariance[:, :3, :3] += np.diag(np.where(np.isfinite(shared), shared, 0.0) ** 2)
    for i in solved.registered:
        world_from_cam = Pose(state.rotations[i], state.centres[i])
        body = world_from_cam @ rig.cameras[lenses.of[i]].body_from_cam.inverse
        cams = tuple(world_from_cam if k == lenses.of[i] else body @ c.body_from_cam for k, c in enumerate(rig.cameras))
        way = state.rotations[i].T @ priors.velocity[i] * float(readouts[i])
        rolls = way.any() or state.turns[i].any()  # translation (m) and rotation (rad) of the camera during the readout
        rolling = np.concatenate([way, *state.turns[i]]) if rolls else None
        motions.append(
            Motion(
                survey.frames[i].t_ns, body, cams, covariance[i], tracks=int(observed[i]), rolling=rolling,
                gain=gains[i],
            )
        )  # fmt: skip
    kept, old = obs.keep(np.isin(obs.photo, solved.registered))
    points = state.points[old]
    up = state.centres[solved.registered, 2]
    depth = float(np.median(up) - np.median(points[:, 2])) if len(points) else 0.0
    sure = points[confirmed(points, np.bincount(kept.point), depth)]
    heights = check_heights(solved.score, up, survey.above[solved.registered], sure)
    distrust = "" if settings.focal == "trusted" else heights.reason(lenses.cameras[0].fv)
    return Trajectory(
        tuple(motions),
        Rig(tuple(replace(c, camera=lens) for c, lens in zip(rig.cameras, lenses.cameras, strict=True))),
        (*bundle_warnings(survey), *([distrust] if distrust else [])),
        {**notes_of(survey, replace(state, points=points), kept, settings), "heights": heights.note},
        joint_of(motions, priors, solved),
        outcomes_of(survey),
        points=sure,
        distrust=distrust,
    )


def confirmed(points: F64, photos: I64, above: float) -> Mask:
    """Return the mask of points that three or more photos see, and of points about as high as the nearest of these.

    Two photos of a wood match many different leaves, and groups of wrong matches agree by chance. Wrong heights, tens
    of metres off, would widen the search in every tile around them. The mask is True everywhere if fewer than a hundred
    points are seen by three or more photos.

    Args:
        points: (m, 3) metres.
        photos: (m,) number of photos that see each point.
        above: metres, height of the cameras above ground.
    """
    sure = photos >= 3
    if sure.sum() < 100:
        return np.ones(len(points), dtype=bool)
    _, near = cKDTree(points[sure, :2]).query(points[:, :2], 8)
    z = points[sure, 2][near]
    margin = 0.1 * above
    return np.asarray(sure | ((points[:, 2] > z.min(axis=1) - margin) & (points[:, 2] < z.max(axis=1) + margin)))


def joint_of(motions: list[Motion], priors: Priors, solved: Solved) -> KeyframePosterior:
    """Return the posterior of the registered poses and the free lens parameters, the latter in units of their sigma."""
    order = np.argsort([m.t_ns for m in motions], kind="stable")
    motions, free, start = [motions[i] for i in order], np.flatnonzero(solved.free), 6 * len(priors.centres)
    sigma = np.sqrt(np.diag(solved.joint)[start:])
    rows = np.append(6 * solved.registered[order][:, None] + np.arange(6), start + np.arange(len(free)))
    turned = sparse.block_diag([*map(_about_body, motions), *(1.0 / s for s in sigma)], format="csr")
    covariance = turned @ (turned @ solved.joint[np.ix_(rows, rows)]).T
    off = [solved.state.lens + s * np.eye(len(solved.state.lens))[k] for k, s in zip(free, sigma, strict=True)]
    return KeyframePosterior(tuple(motions), covariance, tuple(priors.lenses.moved(lens).cameras for lens in off))


def _about_body(motion: Motion) -> F64:
    """Return the (6, 6) matrix that converts an error of the camera's pose to the error of the body's pose."""
    out = np.eye(6)
    out[:3, 3:] = -skew(motion.world_from_body.translation - motion.world_from_cams[0].translation)
    return out


class BundleLane:
    """Lane that collects the photos and estimates all motions at the end.

    Args:
        jobs: runs feature extraction and matching.
        above: height above take-off in metres, by a photo's time in ns; photos without a height are absent.
    """

    def __init__(self, rig: Rig, settings: BundleSettings, jobs: Jobs, above: Mapping[int, float]) -> None:
        colmap()  # fail before the photos are read if pycolmap is missing
        self._rig, self._settings, self._jobs, self._above = rig, settings, jobs, above
        self._frames: list[Frame] = []
        self._nav: list[NavSample | None] = []
        self._last: NavSample | None = None

    def feed(self, event: Event) -> Navigation | None:
        """Store a photo with the navigation sample of its time, return it without a motion; None for other events."""
        if isinstance(event, NavSample):
            self._last = event
        elif isinstance(event, Frame):
            self._frames.append(event)
            self._nav.append(self._last if self._last is not None and self._last.t_ns == event.t_ns else None)
            return Navigation(event, None)
        return None

    def finish(self, progress: Progress) -> Trajectory:
        """Adjust all photos and return the trajectory; its warnings name the photos that could not be registered."""
        of = " ".join(str(f.t_ns) for f in self._frames)
        above = np.array([self._above.get(f.t_ns, np.nan) for f in self._frames])
        arguments = self._frames, self._nav, self._rig, self._settings, progress, self._jobs, above
        (found,) = self._jobs.run([Task("motion", adjust, arguments, of, here=True)])
        return cast(Trajectory, found)
