"""Result of a bundle adjustment, and its warnings and numbers for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, I64
from alight.photos.bundle.matching import BundleObservations, PhotoFeatures
from alight.photos.bundle.solver import BundleState, Priors, residuals
from alight.records import Frame, Motion, PhotoOutcome
from alight.settings import BundleSettings

LEAST_SEEN = 20  # observations that a registered photo keeps
WORST_ATTITUDE = 3.0  # rad, 1 sigma of a registered photo's attitude: beyond it, it may look anywhere
_GPS_FAR = 6.0  # sigmas of GPS residual worth a warning


@dataclass(frozen=True, eq=False)
class FirstPoses:
    """First poses of all photos, and the tags that the images contradict."""

    centres: F64  # (n, 3) metres
    rotations: F64  # (n, 3, 3) world_from_cam
    groups: tuple[I64, ...]  # photos that are connected by matches
    photos: I64  # photos with a pose
    turned: I64  # photos whose attitude tag is half a turn off
    contradicted: I64  # photos whose attitude tag is wrong
    overruled: I64  # photos whose heading has the common error of all headings
    jumped: I64  # photos whose GPS position is wrong
    warnings: list[str]
    climbs: bool  # a level flight fits better than the altitude tags, which are ignored


@dataclass(frozen=True, eq=False)
class Solved:
    """The adjusted state of all photos; only those in `registered` are valid."""

    state: BundleState
    registered: I64
    observations: BundleObservations  # of `state.points`, outliers removed
    joint: F64  # (6 n + k, 6 n + k) of the poses of all photos and the k lens numbers that are free
    first: FirstPoses
    placed: I64  # photos whose GPS was ignored and which were placed by resection
    free: NDArray[np.bool_]  # lens numbers that were estimated: scale aspect cu cv distortion...; readouts are left out
    priors: Priors  # as the images corrected them

    @property
    def covariance(self) -> F64:
        """(n, 6, 6) of each photo's position and rotation."""
        n = (len(self.joint) - int(self.free.sum())) // 6
        at = 6 * np.arange(n)[:, None] + np.arange(6)
        return np.asarray(self.joint[at[:, :, None], at[:, None, :]])


def why_no_motion(features: Sequence[PhotoFeatures | None], priors: Priors) -> str:
    """Return the reason why no photo was registered."""
    if np.isfinite(priors.centres).all(axis=1).sum() < 2:
        return "no photo could be registered: fewer than two photos have a GPS position"
    most = max((len(f.pixels) for f in features if f is not None), default=0)
    why = (
        "the photos have no texture"
        if most < LEAST_SEEN
        else "the photos do not overlap, or show nothing that stands still"
    )
    return f"no photo could be registered: {why}"


def bundle_warnings(
    frames: Sequence[Frame],
    features: Sequence[PhotoFeatures | None],
    motions: Sequence[Motion | None],
    priors: Priors,
    solved: Solved,
) -> list[str]:
    """Return the warnings: photos left out with the reason, and photos whose tags contradict the images."""
    out = []
    for frame, f, motion in zip(frames, features, motions, strict=True):
        if motion is None:
            out.append(f"{frame.name or frame.t_ns}: photo left out, {_why_out(f)}")
    turned = np.intersect1d(solved.first.turned, solved.registered)
    if len(turned):
        out.append(f"{_names(frames, turned)}: attitude tag is half a turn off and was turned back")
    wrong = np.intersect1d(solved.first.contradicted, solved.registered)
    if len(wrong):
        out.append(f"{_names(frames, wrong)}: attitude tag contradicts the pictures and was ignored")
    jumped = np.intersect1d(solved.placed, solved.registered)
    jumped = jumped[np.isfinite(priors.centres[jumped]).all(axis=1)]
    if len(jumped):
        out.append(f"{_names(frames, jumped)}: GPS position contradicts the pictures and was ignored")
    off = np.abs(solved.state.centres - priors.centres) / priors.sigma_centres
    far = [i for i in np.setdiff1d(solved.registered, jumped) if np.nan_to_num(off[i]).max() > _GPS_FAR]
    if far:
        out.append(
            f"{_names(frames, far)}: GPS position is off by more than {_GPS_FAR:g} of its sigmas and was weighted down"
        )
    return out


def fixed_attitudes(joint: F64, photos: int) -> NDArray[np.bool_]:
    """True for photos (n,) whose attitude the pictures fix: false matches of noise leave any attitude possible.

    Args:
        joint: (6 n + k, 6 n + k) covariance of positions and attitudes; of unknowns that nothing fixes,
            the inverse of a nearly singular matrix: huge, or by rounding even negative.
        photos: n.
    """
    at = 6 * np.arange(photos)[:, None] + np.arange(3, 6)
    turns = joint[at[:, :, None], at[:, None, :]]
    known = np.isfinite(turns).all(axis=(1, 2))
    least, _, most = np.linalg.eigvalsh(np.where(known[:, None, None], turns, 0.0)).T
    return np.asarray(known & (least >= 0.0) & (most <= WORST_ATTITUDE**2))


def outcomes_of(
    frames: Sequence[Frame],
    features: Sequence[PhotoFeatures | None],
    motions: Sequence[Motion | None],
    priors: Priors,
    solved: Solved,
) -> tuple[PhotoOutcome, ...]:
    """Return the outcome of the tags of each photo."""
    out, overruled = [], set(solved.first.overruled.tolist())
    for k, (frame, f, motion) in enumerate(zip(frames, features, motions, strict=True)):
        if motion is None:
            out.append(PhotoOutcome(frame.t_ns, left_out=_why_out(f)))
            continue
        tagged, located = (bool(np.isfinite(v[k]).all()) for v in (priors.world_from_body, priors.centres))
        attitude = "believed" if tagged else ""
        attitude = "believed but for its heading" if k in overruled else attitude
        attitude = "turned back" if k in solved.first.turned else attitude
        attitude = "contradicts the pictures, ignored" if k in solved.first.contradicted else attitude
        position = "believed" if located else ""
        if located and k in solved.placed:
            position = "contradicts the pictures, ignored"
        elif located and solved.first.climbs:
            position = "believed but for its altitude"
        out.append(PhotoOutcome(frame.t_ns, attitude, position))
    return tuple(out)


def _why_out(features: PhotoFeatures | None) -> str:
    if features is None:
        return "no image"
    return "no texture" if len(features.pixels) < LEAST_SEEN else "too few matches with other photos"


def _names(frames: Sequence[Frame], which: Sequence[int] | I64) -> str:
    shown = [frames[i].name or str(frames[i].t_ns) for i in which[:3]]
    return ", ".join(shown) + (f" and {len(which) - 3} more" if len(which) > 3 else "")


def notes_of(
    state: BundleState, obs: BundleObservations, priors: Priors, solved: Solved, settings: BundleSettings
) -> dict[str, object]:
    """Return the numbers of the report; lengths in metres, angles in rad, `_px` in pixels."""
    cameras = priors.lenses.moved(state.lens).cameras
    camera = cameras[0]
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
        "focal_px_of_each": [float(c.fv) for c in cameras],
        "lens": settings.lens,
        "lens_free": _free_names(solved.free, priors),
        "principal_point_px": [float(camera.cu), float(camera.cv)],
        "distortion": [float(d) for d in camera.distortion],
        "readout_ms": [1000 * r for r in priors.lenses.moved(state.lens).readouts],
        "turn_while_read_mrad": float(1000 * np.median(np.linalg.norm(state.turns[solved.registered, 0], axis=1))),
        "mounting": [float(m) for m in state.mounting],
        "gps_rms": [float(g) for g in np.sqrt((gps**2).mean(axis=0))],
        "sigma_position": [float(s) for s in np.median(sigma[:, :3], axis=0)],
        "sigma_rotation": [float(s) for s in np.median(sigma[:, 3:], axis=0)],
        "attitude_turned": len(solved.first.turned),
        "gps_ignored": len(solved.placed),
        "attitude_ignored": len(solved.first.contradicted),
    }


def _free_names(free: NDArray[np.bool_], priors: Priors) -> list[str]:
    out = []
    for c, part in enumerate(priors.lenses.parts):
        of = f"camera {c + 1}: " if len(priors.lenses.cameras) > 1 else ""
        names = ("focal", "aspect", "cu", "cv", *(f"distortion {k + 1}" for k in range(part.stop - part.start - 5)))
        out += [of + name for name, is_free in zip(names, free[part][:-1], strict=True) if is_free]
    return out
