"""Motion of photos far apart: features, first poses, and a bundle adjustment with GPS, gimbal and lens priors.

Method and equation numbers: docs/method/bundle.md. Needs pycolmap (extra `photos`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.geometry import Pose, skew
from alight.jobs import InTurn, Jobs
from alight.photos.bundle.exposure import exposure_gains
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import (
    BundleObservations,
    Pair,
    PhotoFeatures,
    colmap,
    extract_all,
    match_pairs,
    neighbours,
    taken_by,
    tracks,
)
from alight.photos.bundle.orientation import Oriented, components, orient
from alight.photos.bundle.patch_matching import refine_observations
from alight.photos.bundle.points import confirmed
from alight.photos.bundle.priors import (
    corrected_priors,
    gps_heading_sigma,
    levelled,
    make_priors,
    observable_lens,
    one_compass,
)
from alight.photos.bundle.resection import resect, without_photos
from alight.photos.bundle.rounds import ROUNDS, coarse_rounds, one_round, retriangulate
from alight.photos.bundle.solver import (
    Adjustment,
    BundleState,
    Priors,
    residuals,
)
from alight.photos.bundle.summary import (
    LEAST_SEEN,
    FirstPoses,
    Solved,
    bundle_warnings,
    fixed_attitudes,
    notes_of,
    outcomes_of,
    why_no_motion,
)
from alight.records import Frame, InputError, KeyframePosterior, Motion, NavSample, PhotoOutcome, Rig
from alight.settings import BundleSettings
from alight.spread import robust_sigma

log = logging.getLogger(__name__)

_LEAST_SIGMA, _LEAST_BY_PATCH = 0.3, 0.1  # px, of features and of patches; below it their errors are correlated
_FINAL_LOSS = 2.0  # Cauchy scale of the last adjustment, in sigmas
_TIGHT = 4.0, 2.0  # px: cut, and Cauchy scale of the triangulation, about the last adjustment
_LEVEL_GAIN = 0.1  # gain of cost, a baseline, by which a level flight has to fit better than the altitude tags
_LEVEL_SIGMAS = 2.0  # sigmas of the altitude tags, by which half of them have to be off one height
_HEADING_OFF, _HEADING_SIGMAS = 0.2, 3.0  # rad, sigmas of the heading by GPS: common error of all tags worth a warning
_COARSE = 300  # observations a photo in all rounds but the last


@dataclass(frozen=True, eq=False)
class BundleResult:
    """Result of the adjustment of a set of photos."""

    motions: list[Motion | None]  # one a frame; None: the photo could not be registered, a warning says why
    rig: Rig  # the lens as refined; mounting as given
    points_world: F64  # (N, 3) metres, those that count for the ground height
    warnings: list[str]
    notes: dict[str, object]
    photos: tuple[PhotoOutcome, ...] = ()  # outcome of the tags of each
    joint: KeyframePosterior | None = None  # covariance of the poses registered, and of the lens where it is free


def adjust(
    frames: Sequence[Frame],
    nav: Sequence[NavSample | None],
    rig: Rig,
    settings: BundleSettings,
    progress: Callable[[float], None] | None = None,
    jobs: Jobs | None = None,
) -> BundleResult:
    """Find the pose of every photo from the images, with GPS, gimbal attitude and calibration as priors.

    `nav[i]` belongs to `frames[i]`: position in metres, attitude body to world, their sigmas; None is 'not
    measured'. Of each frame the first camera with a picture is used. Photos that cannot be registered have None and a
    warning. `jobs` finds features and matches pairs; None: this process.

    Raises:
        MissingExtraError: pycolmap is not installed.
        InputError: frames and nav differ in number.
    """
    colmap()
    if len(frames) != len(nav):
        raise InputError(f"{len(frames)} frames and {len(nav)} navigation samples: give one, or None, for each frame")
    tell = progress or (lambda _: None)
    priors = make_priors(nav, rig, settings, np.array([taken_by(f) for f in frames], dtype=np.int64))
    jobs, features, pairs = jobs or InTurn(), list[PhotoFeatures | None](), list[Pair]()
    for found in extract_all(frames, settings, jobs):
        features.append(found)
        tell(0.35 * len(features) / len(frames))
    wanted = neighbours(priors.centres, settings.neighbours)
    for n, matched in enumerate(match_pairs(priors.lenses, frames, features, wanted, settings, jobs), 1):
        pairs += matched
        tell(0.35 + 0.35 * n / len(frames))
    seconds = np.array([f.t_ns * 1e-9 for f in frames])

    def sharper(state: BundleState, obs: BundleObservations, with_lens: Priors) -> BundleObservations:
        return refine_observations(state, obs, with_lens, frames)

    solved = solve_bundle(
        tracks(features, pairs), pairs, priors, settings, lambda f: tell(0.7 + 0.3 * f), seconds, sharper
    )
    tell(1.0)
    return _result(frames, features, rig, priors, solved, settings)


def solve_bundle(
    obs: BundleObservations,
    pairs: Sequence[Pair],
    priors: Priors,
    settings: BundleSettings,
    tell: Callable[[float], None] = lambda _: None,
    seconds: F64 | None = None,
    sharper: Callable[[BundleState, BundleObservations, Priors], BundleObservations] = lambda state, obs, priors: obs,
) -> Solved | None:
    """Find first poses, then triangulate, select and adjust in rounds; None when no two photos are connected.

    `seconds` (n,): times of the photos; None: rows count as exposed at once. `sharper` refines the observations
    before the last adjustment.
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
    few, most = select(obs, min(_COARSE, settings.observations)), select(obs, settings.observations)
    state, priors, aside = coarse_rounds(state, few, priors, first.jumped, tell, seconds)
    placed = np.empty(0, dtype=np.int64)
    if len(aside):
        state, priors, placed = resect(state, most, aside, priors)
        lost = np.setdiff1d(aside, placed)
        few, most = (without_photos(o, lost)[0] for o in (few, most))
        photos = np.setdiff1d(photos, lost)
        state, _ = one_round(state, few, priors, *ROUNDS[-2])
    state, _ = one_round(state, most, priors, *ROUNDS[-1])
    tell(0.75)
    finer = sharper(*retriangulate(state, most, priors, *_TIGHT), priors)
    state, used = retriangulate(state, finer, priors, *_TIGHT)
    tell(0.85)
    sigma = _pixel_sigmas(residuals(state, used, priors), used.by_patch)
    last = Adjustment(used, priors, sigma, _FINAL_LOSS)
    state = last.solve(state, 30)
    joint = last.covariance(state)
    if first.climbs:
        joint = _of_no_height(joint, tagged.centres[:, 2])
    state, every = retriangulate(state, finer, priors, *_TIGHT)
    seen = np.bincount(every.photo, minlength=len(priors.centres))
    fixed = fixed_attitudes(joint, len(priors.centres))
    registered = np.intersect1d(photos, np.flatnonzero((seen >= LEAST_SEEN) & fixed))
    free = priors.sigma_lens > 0
    free[priors.lenses.readout_numbers] = False
    return Solved(state, registered, every, joint, first, placed, free, priors)


def _pixel_sigmas(residual: F64, by_patch: Mask) -> F64:
    """(N,) px, the 1-sigma of observations with residuals (N, 2): one of features, one of patches."""
    out = np.empty(len(residual))
    for which, least in ((~by_patch, _LEAST_SIGMA), (by_patch, _LEAST_BY_PATCH)):
        out[which] = max(least, robust_sigma(residual[which])) if which.any() else least
    return out


def _of_no_height(joint: F64, tags: F64) -> F64:
    """Covariance of the poses with the scatter of the altitude tags (n,), m, added to their common height."""
    joint, up = joint.copy(), 6 * np.arange(len(tags)) + 2
    joint[np.ix_(up, up)] += float(np.nanmean((tags - np.nanmedian(tags)) ** 2))
    return joint


def first_poses(pairs: Sequence[Pair], priors: Priors) -> FirstPoses | None:
    """Orient every connected component; None when no two photos with GPS are connected."""
    n = len(priors.centres)
    gimbal = priors.world_from_body @ priors.body_from_cam
    rotations, centres = np.tile(np.eye(3), (n, 1, 1)), _fill_missing(priors.centres, pairs)
    located = np.asarray(np.isfinite(priors.centres).all(axis=1))
    groups = [g for g in components(n, pairs) if located[g].sum() >= 2]
    if not groups:
        return None
    found = [orient(g, pairs, priors.centres, priors.sigma_centres, gimbal) for g in groups]
    level, climbs = levelled(priors), False
    off = np.abs(priors.centres - level.centres)[:, 2] / priors.sigma_centres[:, 2]
    if float(np.nanmedian(off)) > _LEVEL_SIGMAS:
        flat = [orient(g, pairs, level.centres, priors.sigma_centres, gimbal) for g in groups]
        gain = sum(f.cost for f in found) - sum(f.cost for f in flat)
        climbs = gain > _LEVEL_GAIN * sum(f.baselines for f in found)
        if climbs:
            found, centres = flat, _fill_missing(level.centres, pairs)
    for f in found:
        rotations[f.photos] = f.world_from_cam
    warnings = [
        f"{len(f.photos)} photos in one line without attitude: the camera is taken to look straight down"
        for f in found
        if f.guessed
    ]
    misled = [
        f for f in found if abs(f.heading) > max(_HEADING_OFF, _HEADING_SIGMAS * gps_heading_sigma(f.photos, priors))
    ]
    warnings += [
        f"the headings in the attitude tags of {len(f.photos)} photos are off by {np.degrees(f.heading):+.0f} degrees "
        "alike: GPS and the pictures decide"
        for f in misled
    ]
    overruled = np.concatenate([*(f.photos for f in misled), np.empty(0, np.int64)])
    photos, turned, wrong, jumped = (np.sort(np.concatenate(c)) for c in zip(*_who(found), strict=True))
    return FirstPoses(centres, rotations, tuple(groups), photos, turned, wrong, overruled, jumped, warnings, climbs)


def _who(found: Sequence[Oriented]) -> list[tuple[I64, ...]]:
    return [(f.photos, f.turned, f.contradicted, f.jumped) for f in found]


def _fill_missing(centres: F64, pairs: Sequence[Pair]) -> F64:
    """Give photos without GPS the mean position of the photos they match, weighted by matches."""
    out = centres.copy()
    for _ in range(len(centres)):
        missing = np.flatnonzero(~np.isfinite(out).all(axis=1))
        matched: dict[int, list[tuple[int, int]]] = {int(i): [] for i in missing}
        for p in pairs:
            for a, b in ((p.i, p.j), (p.j, p.i)):
                if a in matched and np.isfinite(out[b]).all():
                    matched[a].append((b, len(p.matches)))
        located = {a: s for a, s in matched.items() if s}
        for a, s in located.items():
            out[a] = np.average(out[[b for b, _ in s]], axis=0, weights=[m for _, m in s])
        if not located:
            break
    return np.nan_to_num(out)


def select(obs: BundleObservations, cap: int) -> BundleObservations:
    """Keep the longest tracks until every photo has `cap` observations: a bound on time and memory."""
    length = np.bincount(obs.point)
    photos_of = np.split(obs.photo, obs.starts[1:])
    have = np.zeros(int(obs.photo.max(initial=0)) + 1, dtype=np.int64)
    take = np.zeros(len(length), dtype=bool)
    for k in np.argsort(-length, kind="stable"):
        if (have[photos_of[k]] < cap).any():
            take[k] = True
            have[photos_of[k]] += 1
    return obs.keep(take[obs.point])[0]


def _result(
    frames: Sequence[Frame],
    features: Sequence[PhotoFeatures | None],
    rig: Rig,
    priors: Priors,
    solved: Solved | None,
    settings: BundleSettings,
) -> BundleResult:
    if solved is None or not len(solved.registered):
        return BundleResult(
            [None] * len(frames), rig, np.empty((0, 3)), [why_no_motion(features, priors)], {"registered": 0}
        )
    state, obs = solved.state, solved.observations
    tagged = priors
    priors = replace(levelled(priors) if solved.first.climbs else priors, velocity=solved.priors.velocity)
    lenses = priors.lenses.moved(state.lens)
    seen = np.bincount(obs.photo, minlength=len(frames))
    motions: list[Motion | None] = [None] * len(frames)
    gains = exposure_gains(features, obs)
    for i in solved.registered:
        world_from_cam = Pose(state.rotations[i], state.centres[i])
        body = world_from_cam @ rig.cameras[lenses.of[i]].body_from_cam.inverse
        cams = tuple(world_from_cam if k == lenses.of[i] else body @ c.body_from_cam for k, c in enumerate(rig.cameras))
        motions[i] = Motion(
            frames[i].t_ns,
            body,
            cams,
            solved.covariance[i],
            tracks=int(seen[i]),
            rolling=_rolling(i, state, lenses, priors),
            gain=gains[i],
        )
    refined = Rig(tuple(replace(c, camera=lens) for c, lens in zip(rig.cameras, lenses.cameras, strict=True)))
    use = np.isin(obs.photo, solved.registered)
    kept, old = obs.keep(use)
    warnings = [*solved.first.warnings, *_climbing(tagged, solved)]
    warnings += bundle_warnings(frames, features, motions, priors, solved)
    notes = notes_of(replace(state, points=state.points[old]), kept, priors, solved, settings)
    joint = joint_of([m for m in motions if m is not None], priors, solved)
    photos = outcomes_of(frames, features, motions, tagged, solved)
    points = state.points[old]
    above = float(np.median(state.centres[solved.registered, 2]) - np.median(points[:, 2])) if len(points) else 0.0
    points = points[confirmed(points, np.bincount(kept.point), above)]
    return BundleResult(motions, refined, points, warnings, notes, photos, joint)


def _rolling(photo: int, state: BundleState, lenses: PhotoLenses, priors: Priors) -> F64 | None:
    """(9,) translation (m) and turns (rad) of a photo's camera during readout, in its own axes; None: at once."""
    readout = float(lenses.readout(np.array([photo]))[0])
    way = state.rotations[photo].T @ priors.velocity[photo] * readout
    return np.concatenate([way, *state.turns[photo]]) if way.any() or state.turns[photo].any() else None


def _climbing(priors: Priors, solved: Solved) -> list[str]:
    """Warning that the altitude tags were ignored in favour of a level flight."""
    if not solved.first.climbs:
        return []
    low, high = (float(v(priors.centres[solved.registered, 2])) for v in (np.nanmin, np.nanmax))
    rise = float(np.ptp(solved.state.centres[solved.registered, 2]))
    return [
        f"altitude tags spread over {high - low:.0f} m, the pictures were taken within {rise:.0f} m of one height: the "
        "altitude tags were ignored, and the flight is taken to be level; heights in the world are uncertain by as much"
    ]


def joint_of(motions: list[Motion], priors: Priors, solved: Solved) -> KeyframePosterior:
    """Joint covariance of the registered poses and the free lens numbers, these in units of their own sigma."""
    rows = (6 * solved.registered[:, None] + np.arange(6)).ravel()
    free = np.flatnonzero(solved.free)
    start = 6 * len(priors.centres)
    sigma = np.sqrt(np.diag(solved.joint)[start:])
    move = np.array([_about_body(m) for m in motions])
    rows = np.concatenate([rows, start + np.arange(len(free))])
    off = [solved.state.lens + s * np.eye(len(solved.state.lens))[k] for k, s in zip(free, sigma, strict=True)]
    once = _moved(solved.joint[np.ix_(rows, rows)], move, sigma)
    covariance = _moved(np.ascontiguousarray(once.T), move, sigma)
    order = np.argsort([m.t_ns for m in motions], kind="stable")
    rows = np.concatenate([(6 * order[:, None] + np.arange(6)).ravel(), np.arange(6 * len(order), len(covariance))])
    lenses = tuple(priors.lenses.moved(lens).cameras for lens in off)
    return KeyframePosterior(tuple(motions[i] for i in order), covariance[np.ix_(rows, rows)], lenses)


def _moved(rows: F64, move: F64, sigma: F64) -> F64:
    """Rows of a joint covariance, those of each pose moved by a (6, 6), those of the lens in units of their sigma."""
    n = 6 * len(move)
    poses = np.matmul(move, rows[:n].reshape(len(move), 6, -1)).reshape(n, -1)
    return np.concatenate([poses, rows[n:] / sigma[:, None]])


def _about_body(motion: Motion) -> F64:
    """(6, 6): error of the body's pose from that of the camera's pose, which the adjustment estimates."""
    out = np.eye(6)
    out[:3, 3:] = -skew(motion.world_from_body.translation - motion.world_from_cams[0].translation)
    return out
