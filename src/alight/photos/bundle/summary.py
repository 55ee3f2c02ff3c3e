"""Result of a bundle adjustment, with its warnings and numbers for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.photos.bundle.features import PhotoFeatures
from alight.photos.bundle.height_check import FocalScore
from alight.photos.bundle.matching import LEAST_MATCHED, BundleObservations
from alight.photos.bundle.orientation import FirstPoses
from alight.photos.bundle.solver import BundleState, Priors, residuals
from alight.records import Frame, PhotoOutcome
from alight.settings import BundleSettings

_GPS_FAR = 6.0  # sigmas; a larger GPS residual is worth a warning


@dataclass(frozen=True, eq=False)
class Solved:
    """Adjusted state of all photos; valid only for the photos in `registered`."""

    state: BundleState
    registered: I64  # photo indices
    observations: BundleObservations  # observations of `state.points`, without outliers
    joint: F64  # (6 n + k, 6 n + k) covariance of all n poses and the k free lens parameters
    first: FirstPoses
    placed: I64  # indices of photos located by resection, whose GPS was ignored
    free: Mask  # mask of estimated lens parameters (scale, aspect, cu, cv, distortion...); False for readouts
    priors: Priors  # as corrected by the images
    score: FocalScore

    @property
    def covariance(self) -> F64:
        """(n, 6, 6) covariance of each photo's position (m) and rotation (rad)."""
        n = (len(self.joint) - int(self.free.sum())) // 6
        at = 6 * np.arange(n)[:, None] + np.arange(6)
        return np.asarray(self.joint[at[:, :, None], at[:, None, :]])


@dataclass(frozen=True, eq=False)
class Survey:
    """Photos of a bundle adjustment, their tags, and the result."""

    frames: Sequence[Frame]
    features: Sequence[PhotoFeatures]
    tagged: Priors  # from the tags as written
    priors: Priors  # `tagged`, but at one height if the altitude tags are ignored
    solved: Solved
    above: F64  # (n,) metres above take-off by the tags; NaN: unknown or not to be compared

    def names(self, which: Sequence[int] | I64) -> str:
        """Return the names of the first three photos with the indices `which`, and the number of the others."""
        shown = [self.frames[i].name or str(self.frames[i].t_ns) for i in which[:3]]
        return ", ".join(shown) + (f" and {len(which) - 3} more" if len(which) > 3 else "")

    def why_out(self, photo: int) -> str:
        """Return why a photo was not registered; empty if it was registered."""
        if photo in self.solved.registered:
            return ""
        few = len(self.features[photo].pixels) < LEAST_MATCHED
        return "no texture" if few else "too few matches with other photos"


def why_no_motion(features: Sequence[PhotoFeatures], priors: Priors, solved: Solved | None) -> str:
    """Return the reason why no photo was registered; `solved` is None if no two photos are connected."""
    if np.isfinite(priors.centres).all(axis=1).sum() < 2:
        why = "fewer than two photos have a GPS position"
    elif max((len(f.pixels) for f in features), default=0) < LEAST_MATCHED:
        why = "the photos have no texture"
    elif solved is None or (np.bincount(solved.observations.photo, minlength=1) < LEAST_MATCHED).all():
        why = "the photos do not overlap, or show nothing that stands still"
    else:
        why = (
            "they lie in one line and have no attitude, so their roll about that line is unknown; give photos of a "
            "second line, or attitudes"
        )
    return f"no photo could be registered: {why}"


def bundle_warnings(survey: Survey) -> list[str]:
    """Return warnings about photos left out, with the reason, and about photos whose tags contradict the images."""
    solved, tagged, priors = survey.solved, survey.tagged, survey.priors
    out = list(solved.first.warnings)
    if solved.first.climbs:
        low, high = (float(v(tagged.centres[solved.registered, 2])) for v in (np.nanmin, np.nanmax))
        rise = float(np.ptp(solved.state.centres[solved.registered, 2]))
        out.append(
            f"altitude tags spread over {high - low:.0f} m, the pictures were taken within {rise:.0f} m of one height: "
            "the altitude tags were ignored, and the flight is taken to be level; heights in the world are uncertain "
            "by as much"
        )
    for k in range(len(survey.frames)):
        if why := survey.why_out(k):
            out.append(f"{survey.names([k])}: photo left out, {why}")
    jumped = solved.placed[np.isfinite(priors.centres[solved.placed]).all(axis=1)]
    off = np.nan_to_num(np.abs(solved.state.centres - priors.centres) / priors.sigma_centres).max(axis=1)
    for which, what in (
        (solved.first.turned, "attitude tag is half a turn off and was turned back"),
        (solved.first.contradicted, "attitude tag contradicts the pictures and was ignored"),
        (jumped, "GPS position contradicts the pictures and was ignored"),
        (np.setdiff1d(np.flatnonzero(off > _GPS_FAR), jumped),
         f"GPS position is off by more than {_GPS_FAR:g} of its sigmas and was weighted down"),
    ):  # fmt: skip
        if len(registered := np.intersect1d(which, solved.registered)):
            out.append(f"{survey.names(registered)}: {what}")
    return out


def fixed_attitudes(joint: F64, photos: int) -> Mask:
    """Return the mask (n,) of photos whose attitude has a 1-sigma of at most 3 rad about every axis.

    `joint` (6 n + k, 6 n + k) is the covariance of positions and attitudes of n = `photos` photos. Undetermined
    unknowns have huge or, by rounding, negative variances.
    """
    at = 6 * np.arange(photos)[:, None] + np.arange(3, 6)
    turns = joint[at[:, :, None], at[:, None, :]]
    known = np.isfinite(turns).all(axis=(1, 2))
    least, _, most = np.linalg.eigvalsh(np.where(known[:, None, None], turns, 0.0)).T
    return np.asarray(known & (least >= 0.0) & (most <= 3.0**2))


def outcomes_of(survey: Survey) -> tuple[PhotoOutcome, ...]:
    """Return the outcome of each photo: whether its tags were used, or why it was left out."""
    out, first = [], survey.solved.first
    for k, frame in enumerate(survey.frames):
        if why := survey.why_out(k):
            out.append(PhotoOutcome(frame.t_ns, left_out=why))
            continue
        tagged, located = (
            bool(np.isfinite(v[k]).all()) for v in (survey.tagged.world_from_body, survey.tagged.centres)
        )
        attitude = "believed" if tagged else ""
        attitude = "believed but for its heading" if k in first.overruled else attitude
        attitude = "turned back" if k in first.turned else attitude
        attitude = "contradicts the pictures, ignored" if k in first.contradicted else attitude
        position = "believed but for its altitude" if first.climbs else "believed"
        position = "contradicts the pictures, ignored" if k in survey.solved.placed else position
        out.append(PhotoOutcome(frame.t_ns, attitude, position if located else ""))
    return tuple(out)


def notes_of(
    survey: Survey, state: BundleState, obs: BundleObservations, settings: BundleSettings
) -> dict[str, object]:
    """Return numbers for the report on `state` and its observations `obs`; metres and radians, `_px` in pixels."""
    solved, priors = survey.solved, survey.priors
    lenses = priors.lenses.moved(state.lens)
    camera = lenses.cameras[0]
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
        "focal_px_of_each": [float(c.fv) for c in lenses.cameras],
        "lens": settings.lens,
        "lens_free": _free_names(solved.free, priors),
        "principal_point_px": [float(camera.cu), float(camera.cv)],
        "distortion": [float(d) for d in camera.distortion],
        "readout_ms": [1000 * r for r in lenses.readouts],
        "turn_while_read_mrad": float(1000 * np.median(np.linalg.norm(state.turns[solved.registered, 0], axis=1))),
        "mounting": state.mounting.tolist(),
        "gps_rms": np.sqrt((gps**2).mean(axis=0)).tolist(),
        "sigma_position": np.median(sigma[:, :3], axis=0).tolist(),
        "sigma_rotation": np.median(sigma[:, 3:], axis=0).tolist(),
        "attitude_turned": len(solved.first.turned),
        "gps_ignored": len(solved.placed),
        "attitude_ignored": len(solved.first.contradicted),
    }


def _free_names(free: Mask, priors: Priors) -> list[str]:
    out = []
    for c, part in enumerate(priors.lenses.parts):
        of = f"camera {c + 1}: " if len(priors.lenses.cameras) > 1 else ""
        names = ("focal", "aspect", "cu", "cv", *(f"distortion {k + 1}" for k in range(part.stop - part.start - 5)))
        out += [of + name for name, is_free in zip(names, free[part][:-1], strict=True) if is_free]
    return out
