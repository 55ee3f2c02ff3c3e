"""Priors of a bundle adjustment from GPS, gimbal and calibration, and their correction by the images.

With a rolling shutter the rows of a photo are exposed one after the other. Over the readout a camera moves by its
velocity times the readout and turns by a small angle. The readout is one number of each camera, the turn six of each
photo (eqs. 10 and 11 in docs/method/bundle.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.geometry import Camera
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.solver import Priors
from alight.records import NavSample, Rig
from alight.settings import BundleSettings

_SIGMA_LENS = {  # 1-sigma of scale aspect cu cv and distortion; for the focal length see docs/method/bundle.md
    "radial-tangential": (0.0, 0.0, 10.0, 10.0, 0.05, 0.1, 0.002, 0.002, 0.2),
    "equidistant": (0.0, 0.0, 10.0, 10.0) + (0.02,) * 4,
}
_SIGMA_FOCAL = 0.02  # relative, where it is free
_SIGMA_RATE = 0.2  # rad/s, 1-sigma of the turning of a camera without a gimbal
_SIGMA_READOUT = 0.05  # s; cheap cameras take 20 to 160 ms: 0.2 to 2 m of flight
COMMON_HEADING = 0.5  # rad, 1-sigma of the common error of all headings: some compasses are off by 0.9
HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # about the optical axis
_COMPASS = 0.05  # rad; headings with a smaller sigma are not from a compass
_LENS_PHOTOS = 12  # with fewer photos the radial distortion is held


def make_priors(
    nav: Sequence[NavSample | None], rig: Rig, settings: BundleSettings, cameras: I64 | None = None
) -> Priors:
    """Collect positions, attitudes and calibration; sigmas are those of the settings where a photo has none.

    `cameras` (n,): camera of the rig that took each photo; None: the first one. All have one pose in the body. Rows
    count as exposed at once until `rolling_priors` changes that.
    """
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
                sigma_rotation[i] = np.maximum([max(roll, pitch), max(roll, pitch), yaw], 1e-3)
        if sample.position_world is not None:
            arm = body_from_cam.translation
            known = arm.any() and np.isfinite(rotation[i]).all()
            centres[i] = sample.position_world + (rotation[i] @ arm if known else 0.0)
            if sample.sigma_position is not None and np.isfinite(sample.sigma_position).all():
                sigma[i] = np.maximum(sample.sigma_position, 0.01)
    of = np.zeros(n, np.int64) if cameras is None else cameras
    found = [_lens(c.camera, settings) for c in rig.cameras]
    lenses = PhotoLenses(tuple(c for c, _ in found), of, by_maker=tuple(c.readout for c in rig.cameras))
    sigma_lens = np.concatenate([s for _, s in found])
    return Priors(
        centres, sigma, rotation, sigma_rotation, body_from_cam.rotation, settings.mounting_sigma, lenses, sigma_lens,
        np.zeros((n, 3)),
    )  # fmt: skip


def _lens(camera: Camera, settings: BundleSettings) -> tuple[Camera, F64]:
    """Return the initial camera and the sigmas of its numbers; a free lens without distortion gets a model."""
    if settings.lens == "free" and camera.model == "none":
        camera = replace(camera, model="radial-tangential", distortion=(0.0,) * 4)
    sigma = np.zeros(5 + len(camera.distortion))
    if settings.lens == "free":
        sigma[:-1] = _SIGMA_LENS[camera.model][: len(sigma) - 1]
    sigma[0] = _SIGMA_FOCAL if settings.focal == "free" else 0.0
    return camera, sigma


def levelled(priors: Priors) -> Priors:
    """The priors of a flight at one height, the median of the altitude tags."""
    centres = priors.centres.copy()
    centres[:, 2] = np.where(np.isfinite(centres[:, 2]), np.nanmedian(centres[:, 2]), np.nan)
    return replace(priors, centres=centres)


def corrected_priors(priors: Priors, turned: I64, contradicted: I64) -> Priors:
    """Turn back the gimbal tags that are half a turn off; drop those that the images contradict."""
    attitude = priors.world_from_body.copy()
    B = priors.body_from_cam
    attitude[turned] = attitude[turned] @ (B @ HALF_TURN @ B.T)
    attitude[contradicted] = np.nan
    return replace(priors, world_from_body=attitude)


def one_compass(priors: Priors, groups: Sequence[I64]) -> Priors:
    """Let the headings of each group of connected photos count as one: a compass is off for all of them alike.

    Headings with a smaller sigma than a compass has are not changed.
    """
    sigma = priors.sigma_rotation.copy()
    tagged = np.isfinite(priors.world_from_body).all(axis=(1, 2)) & (sigma[:, 2] >= _COMPASS)
    for group in groups:
        some = group[tagged[group]]
        sigma[some, 2] = np.hypot(sigma[some, 2], COMMON_HEADING * np.sqrt(len(some)))
    return replace(priors, sigma_rotation=sigma)


def gps_heading_sigma(photos: I64, priors: Priors) -> float:
    """1-sigma in rad of the heading from the positions of two or more photos; infinite where all are one place."""
    centres, sigma = priors.centres[photos, :2], priors.sigma_centres[photos, :2]
    known = np.isfinite(centres).all(axis=1)
    arm = float(np.linalg.norm(centres[known] - centres[known].mean(axis=0)))
    return float(np.sqrt((sigma[known] ** 2).mean())) / arm if arm > 0 else float("inf")


def observable_lens(priors: Priors, photos: I64) -> Priors:
    """Hold the radial distortion where photos are few: it correlates with the height (docs/method/bundle.md)."""
    sigma = priors.sigma_lens.copy()
    for k, (camera, part) in enumerate(zip(priors.lenses.cameras, priors.lenses.parts, strict=True)):
        if (priors.lenses.of[photos] == k).sum() < _LENS_PHOTOS:
            its = sigma[part]  # a view
            decentring = its[6:8].copy()
            its[4:-1] = 0.0
            if camera.model == "radial-tangential":
                its[6:8] = decentring
    return replace(priors, sigma_lens=sigma)


def rolling_priors(priors: Priors, centres: F64, seconds: F64) -> Priors:
    """Let rows be exposed one after the other; the readout is free where velocities are known and the maker gives none.

    Where all lens numbers are held, so are the readouts.

    Args:
        priors: of all photos.
        centres: (n, 3) metres, as adjusted so far.
        seconds: (n,) when each photo was taken.
    """
    velocity = velocities(centres, seconds, priors.lenses.of)
    sigma, held = priors.sigma_lens.copy(), not priors.sigma_lens.any()
    for k, number in enumerate(priors.lenses.readout_numbers):
        known = velocity[priors.lenses.of == k].any(axis=1)
        free = not held and known.sum() >= _LENS_PHOTOS and priors.lenses.by_maker[k] is None
        sigma[number] = _SIGMA_READOUT if free else 0.0
    return replace(priors, sigma_lens=sigma, velocity=velocity)


def turning_priors(priors: Priors, readouts: tuple[float, ...]) -> Priors:
    """Let the photos turn while they are read out, and hold the readouts (s, of each camera)."""
    return replace(at_once(priors), sigma_turn=_SIGMA_RATE * max(abs(r) for r in readouts))


def at_once(priors: Priors) -> Priors:
    """Hold the readouts, and let no photo turn during the readout."""
    sigma = priors.sigma_lens.copy()
    sigma[priors.lenses.readout_numbers] = 0.0
    return replace(priors, sigma_lens=sigma, sigma_turn=0.0)


def velocities(centres: F64, seconds: F64, camera: I64) -> F64:
    """Velocity (n, 3) m/s at every photo, from places and times of the photos before and after it; 0 where not known.

    Of two ways in different directions, at the end of a strip, the faster one counts: turns take time. Longer pauses
    than a minute, ways of less than a metre and more than 60 m/s, as by a wrong tag, give none.

    Args:
        centres: (n, 3) metres.
        seconds: (n,) time of each photo; NaN: not known.
        camera: (n,) number of the camera of each: photos of one camera are compared.
    """
    out = np.zeros_like(centres)
    for one in np.unique(camera):
        who = np.flatnonzero((camera == one) & np.isfinite(seconds))
        who = who[np.argsort(seconds[who], kind="stable")]
        way, time = np.diff(centres[who], axis=0), np.diff(seconds[who])
        long = np.linalg.norm(way, axis=1)
        good = (time > 0) & (time <= 60.0) & (long > 1.0) & (long <= 60.0 * time)
        for k, i in enumerate(who):
            out[i] = _between(k - 1, k, way, time, good)
    return out


def _between(before: int, after: int, way: F64, time: F64, good: Mask) -> F64:
    """Velocity (3,) m/s at the photo between two ways, from those that are good; 0 if none is."""
    used = [k for k in (before, after) if 0 <= k < len(good) and good[k]]
    speed = [way[k] / time[k] for k in used]
    if len(used) == 2:
        a, b = (v / np.linalg.norm(v) for v in speed)
        if float(a @ b) > 0.8:  # the same way
            return np.asarray((way[used[0]] + way[used[1]]) / (time[used[0]] + time[used[1]]))
        return np.asarray(speed[int(np.argmax([np.linalg.norm(v) for v in speed]))])
    return np.asarray(speed[0]) if speed else np.zeros(3)
