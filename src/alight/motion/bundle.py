"""Motion of photos far apart: features, first poses, and a bundle adjustment held by GPS, gimbal and the maker's lens.

Method and equation numbers: docs/method-bundle.md. Needs pycolmap (extra `photos`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from alight.geometry import Pose
from alight.motion.bundle_match import (
    Features,
    Index,
    Observations,
    Pair,
    colmap,
    extract_all,
    match_pairs,
    neighbours,
    tracks,
)
from alight.motion.bundle_orient import components, orient
from alight.motion.bundle_solve import (
    Adjustment,
    Priors,
    State,
    intersection_angle,
    lens_camera,
    project,
    residuals,
    triangulate,
)
from alight.records import F64, Frame, InputError, Motion, NavSample, Rig
from alight.settings import Bundle

log = logging.getLogger(__name__)

_ROUNDS = ((100.0, np.inf), (20.0, 100.0), (5.0, 25.0), (2.0, 8.0), (2.0, 4.0))  # px: Cauchy scale, cut; of 1 px sigma
_LENS_ROUND = 2  # from here on the lens is free: before, it would soak up the errors of the first poses
_COARSE = 300  # observations a photo in all rounds but the last
_ANGLE = np.radians(1.0)  # least angle between the rays of a point
_LEAST_SEEN = 20  # observations that a registered photo keeps
_GPS_FAR = 6.0  # sigmas of GPS residual worth a warning
_SIGMA_LENS = (0.0, 0.0, 10.0, 10.0, 0.05, 0.1, 0.002, 0.002, 0.2)  # of scale aspect cu cv k1 k2 p1 p2 k3, see docs


@dataclass(frozen=True, eq=False)
class BundleResult:
    """What the adjustment of a set of photos found."""

    motions: list[Motion | None]  # one a frame; None: the photo could not be registered, a warning says why
    rig: Rig  # the lens as refined; mounting as given
    points_world: F64  # (N, 3) metres
    warnings: list[str]
    notes: dict[str, object]


def adjust(
    frames: Sequence[Frame],
    nav: Sequence[NavSample | None],
    rig: Rig,
    settings: Bundle,
    progress: Callable[[float], None] | None = None,
) -> BundleResult:
    """Find the pose of every photo from the pictures, with GPS, gimbal attitude and the maker's lens as priors.

    `nav[i]` belongs to `frames[i]`: position in metres, attitude body to world, their sigmas; None is 'not
    measured'. Camera 0 of the rig is used. Photos that cannot be registered have None and a warning.

    Raises:
        MissingExtraError: pycolmap is not installed.
        InputError: frames and nav differ in number.
    """
    colmap()
    if len(frames) != len(nav):
        raise InputError(f"{len(frames)} frames and {len(nav)} navigation samples: give one, or None, for each frame")
    tell = progress or (lambda _: None)
    priors = make_priors(nav, rig, settings)
    features = _extract(frames, settings, lambda f: tell(0.35 * f))
    wanted = neighbours(priors.centres, settings.neighbours)
    done = iter(range(1, len(wanted) + 1))
    pairs = match_pairs(priors.camera, features, wanted, settings, lambda: tell(0.35 + 0.35 * next(done) / len(wanted)))
    solved = solve(tracks(features, pairs), pairs, priors, settings, lambda f: tell(0.7 + 0.3 * f))
    return _result(frames, features, rig, priors, solved, settings)


@dataclass(frozen=True, eq=False)
class Solved:
    """The adjusted state of all photos; only those in `registered` mean anything."""

    state: State
    registered: Index
    observations: Observations  # of `state.points`, outliers removed
    covariance: F64  # (n, 6, 6)
    pixel_sigma: float
    warnings: list[str]
    contradicted: Index


def make_priors(nav: Sequence[NavSample | None], rig: Rig, settings: Bundle) -> Priors:
    """Collect what GPS, gimbal and maker say; sigmas of the settings where the photo does not say."""
    n = len(nav)
    centres, sigma = np.full((n, 3), np.nan), np.full((n, 3), settings.position_sigma)
    rotation, sigma_rotation = np.full((n, 3, 3), np.nan), np.full((n, 3), settings.attitude_sigma)
    sigma_rotation[:, 2] = settings.heading_sigma
    body_from_cam = rig.cameras[0].body_from_cam
    for i, sample in enumerate(nav):
        if sample is None:
            continue
        if sample.world_from_body is not None:
            rotation[i] = sample.world_from_body
            if sample.sigma_attitude is not None and np.isfinite(sample.sigma_attitude).all():
                roll, pitch, yaw = sample.sigma_attitude
                sigma_rotation[i] = max(roll, pitch, 1e-3), max(roll, pitch, 1e-3), max(yaw, 1e-3)
        if sample.position_world is not None:
            arm = body_from_cam.translation
            centres[i] = sample.position_world + (
                rotation[i] @ arm if arm.any() and np.isfinite(rotation[i]).all() else 0.0
            )
            if sample.sigma_position is not None and np.isfinite(sample.sigma_position).all():
                sigma[i] = np.maximum(sample.sigma_position, 0.01)
    camera = rig.cameras[0].camera
    sigma_lens = (
        np.array(_SIGMA_LENS[: 4 + len(camera.distortion)])
        if settings.lens == "free"
        else np.zeros(4 + len(camera.distortion))
    )
    sigma_lens[0] = 0.02 if settings.focal == "free" else 0.0
    return Priors(
        centres, sigma, rotation, sigma_rotation, body_from_cam.rotation, settings.mounting_sigma, camera, sigma_lens
    )


def _extract(frames: Sequence[Frame], settings: Bundle, tell: Callable[[float], None]) -> list[Features | None]:
    out = []
    for f in extract_all([frame.images[0] if frame.images else None for frame in frames], settings):
        out.append(f)
        tell(len(out) / len(frames))
    return out


def solve(
    obs: Observations,
    pairs: Sequence[Pair],
    priors: Priors,
    settings: Bundle,
    tell: Callable[[float], None] = lambda _: None,
) -> Solved | None:
    """First poses, then rounds of triangulation, selection and adjustment; None when no two photos hang together."""
    first = first_poses(pairs, priors)
    if first is None:
        return None
    centres, rotations, photos, contradicted, warnings = first
    attitude = priors.world_from_body.copy()
    attitude[contradicted] = np.nan
    priors = replace(priors, world_from_body=attitude)
    obs, _ = obs.keep(np.isin(obs.photo, photos))
    held = replace(priors, sigma_lens=np.zeros_like(priors.sigma_lens))
    state = State(centres, rotations, np.empty((0, 3)), np.zeros_like(priors.sigma_lens), np.zeros(3))
    few, most = select(obs, min(_COARSE, settings.observations)), select(obs, settings.observations)
    for k, (loss, cut) in enumerate(_ROUNDS):
        state, used = refresh(state, few if k < len(_ROUNDS) - 1 else most, priors, cut, loss)
        if not len(used.photo):
            return None
        state = Adjustment(used, priors if k >= _LENS_ROUND else held, 1.0, loss).solve(state, 15)
        log.info(
            "round %d: %d observations, %.2f px", k, len(used.photo), np.median(np.abs(residuals(state, used, priors)))
        )
        tell((k + 1) / (len(_ROUNDS) + 1))
    sigma = max(0.3, 1.4826 * float(np.median(np.abs(residuals(state, used, priors)))))
    last = Adjustment(used, priors, sigma, 2.0)
    state = last.solve(state, 15)
    covariance = last.covariance(state)
    state, every = refresh(state, obs, priors, 4.0, 2.0)
    seen = np.bincount(every.photo, minlength=len(centres))
    registered = np.intersect1d(photos, np.flatnonzero(seen >= _LEAST_SEEN))
    return Solved(state, registered, every, covariance, sigma, warnings, contradicted)


def first_poses(pairs: Sequence[Pair], priors: Priors) -> tuple[F64, F64, Index, Index, list[str]] | None:
    """Return centres (n, 3), rotations (n, 3, 3), photos that have them, those with a wrong tag, warnings."""
    n = len(priors.centres)
    gimbal = priors.world_from_body @ priors.body_from_cam
    rotations, centres = np.tile(np.eye(3), (n, 1, 1)), _fill(priors.centres, pairs)
    photos, contradicted, warnings = [], [], []
    for group in components(n, pairs):
        if np.isfinite(priors.centres[group]).all(axis=1).sum() < 2:
            continue
        found = orient(group, pairs, priors.centres, priors.sigma_centres, gimbal)
        rotations[group] = found.world_from_cam
        photos.append(group)
        contradicted.append(found.contradicted)
        if found.guessed:
            warnings.append(
                f"{len(group)} photos in one line without attitude: the camera is taken to look straight down"
            )
    if not photos:
        return None
    return centres, rotations, np.sort(np.concatenate(photos)), np.concatenate(contradicted), warnings


def _fill(centres: F64, pairs: Sequence[Pair]) -> F64:
    """Give photos without GPS the mean position of the photos they match, weighted by matches."""
    out = centres.copy()
    for _ in range(len(centres)):
        missing = np.flatnonzero(~np.isfinite(out).all(axis=1))
        said: dict[int, list[tuple[int, int]]] = {int(i): [] for i in missing}
        for p in pairs:
            for a, b in ((p.i, p.j), (p.j, p.i)):
                if a in said and np.isfinite(out[b]).all():
                    said[a].append((b, len(p.matches)))
        known = {a: s for a, s in said.items() if s}
        for a, s in known.items():
            out[a] = np.average(out[[b for b, _ in s]], axis=0, weights=[m for _, m in s])
        if not known:
            break
    return np.nan_to_num(out)


def select(obs: Observations, cap: int) -> Observations:
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


def refresh(state: State, obs: Observations, priors: Priors, cut: float, scale: float) -> tuple[State, Observations]:
    """Triangulate all tracks again; leave out what misses by more than `cut` px or meets at a small angle."""
    camera = lens_camera(priors.camera, state.lens)
    for _ in range(2):
        points = triangulate(state.centres, state.rotations, camera, obs, scale_px=scale)
        state = replace(state, points=points)
        pixels, in_cam = project(state, obs, camera)
        miss = np.linalg.norm(pixels - obs.pixels, axis=1)
        wide = intersection_angle(points, state.centres, obs) > _ANGLE
        good = (
            (in_cam[:, 2] > 0) & wide[obs.point] & (np.nan_to_num(miss, nan=np.inf) < cut if np.isfinite(cut) else True)
        )
        obs, old = obs.keep(good)
        state = replace(state, points=points[old])
    return state, obs


def _result(
    frames: Sequence[Frame],
    features: Sequence[Features | None],
    rig: Rig,
    priors: Priors,
    solved: Solved | None,
    settings: Bundle,
) -> BundleResult:
    if solved is None or not len(solved.registered):
        return BundleResult(
            [None] * len(frames), rig, np.empty((0, 3)), [_why_none(features, priors)], {"registered": 0}
        )
    state, obs = solved.state, solved.observations
    camera = lens_camera(priors.camera, state.lens)
    seen = np.bincount(obs.photo, minlength=len(frames))
    motions: list[Motion | None] = [None] * len(frames)
    for i in solved.registered:
        world_from_cam = Pose(state.rotations[i], state.centres[i])
        body = world_from_cam @ rig.cameras[0].body_from_cam.inverse
        motions[i] = Motion(frames[i].t_ns, body, (world_from_cam,), solved.covariance[i], tracks=int(seen[i]))
    refined = Rig((replace(rig.cameras[0], camera=camera), *rig.cameras[1:]))
    use = np.isin(obs.photo, solved.registered)
    kept, old = obs.keep(use)
    warnings = solved.warnings + _warn(frames, features, motions, priors, solved)
    notes = _notes(replace(state, points=state.points[old]), kept, priors, solved, settings)
    return BundleResult(motions, refined, state.points[old], warnings, notes)


def _why_none(features: Sequence[Features | None], priors: Priors) -> str:
    if np.isfinite(priors.centres).all(axis=1).sum() < 2:
        return "no photo could be registered: fewer than two photos have a GPS position"
    most = max((len(f.pixels) for f in features if f is not None), default=0)
    why = (
        "the photos have no texture"
        if most < _LEAST_SEEN
        else "the photos do not overlap, or show nothing that stands still"
    )
    return f"no photo could be registered: {why}"


def _warn(
    frames: Sequence[Frame],
    features: Sequence[Features | None],
    motions: Sequence[Motion | None],
    priors: Priors,
    solved: Solved,
) -> list[str]:
    """Say which photos were left out and why, and whose tags the pictures contradict."""
    out = []
    for frame, f, motion in zip(frames, features, motions, strict=True):
        if motion is None:
            why = (
                "no image"
                if f is None
                else "no texture"
                if len(f.pixels) < _LEAST_SEEN
                else "too few matches with other photos"
            )
            out.append(f"{frame.name or frame.t_ns}: photo left out, {why}")
    wrong = np.intersect1d(solved.contradicted, solved.registered)
    if len(wrong):
        out.append(f"{_names(frames, wrong)}: attitude tag contradicts the pictures and was ignored")
    off = np.abs(solved.state.centres - priors.centres) / priors.sigma_centres
    far = [i for i in solved.registered if np.nan_to_num(off[i]).max() > _GPS_FAR]
    if far:
        out.append(
            f"{_names(frames, far)}: GPS position is off by more than {_GPS_FAR:g} of its sigmas and was weighted down"
        )
    return out


def _names(frames: Sequence[Frame], which: Sequence[int] | Index) -> str:
    shown = [frames[i].name or str(frames[i].t_ns) for i in which[:3]]
    return ", ".join(shown) + (f" and {len(which) - 3} more" if len(which) > 3 else "")


def _notes(state: State, obs: Observations, priors: Priors, solved: Solved, settings: Bundle) -> dict[str, object]:
    """Return the numbers of the report; lengths in metres, angles in rad, `_px` in pixels."""
    camera = lens_camera(priors.camera, state.lens)
    r = residuals(state, obs, priors)
    gps = (state.centres - priors.centres)[solved.registered]
    gps = gps[np.isfinite(gps).all(axis=1)]
    sigma = np.sqrt([np.diag(solved.covariance[i]) for i in solved.registered])
    return {
        "registered": len(solved.registered),
        "points": obs.points,
        "observations": len(obs.photo),
        "reprojection_rms_px": float(np.sqrt((r**2).sum(axis=1).mean())),
        "reprojection_median_px": float(np.median(np.linalg.norm(r, axis=1))),
        "focal": settings.focal,
        "focal_px": [float(camera.fu), float(camera.fv)],
        "lens": settings.lens,
        "principal_point_px": [float(camera.cu), float(camera.cv)],
        "distortion": [float(d) for d in camera.distortion],
        "mounting": [float(m) for m in state.mounting],
        "gps_rms": [float(g) for g in np.sqrt((gps**2).mean(axis=0))],
        "sigma_position": [float(s) for s in np.median(sigma[:, :3], axis=0)],
        "sigma_rotation": [float(s) for s in np.median(sigma[:, 3:], axis=0)],
        "attitude_ignored": len(solved.contradicted),
    }
