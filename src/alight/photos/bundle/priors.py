"""Priors of a bundle adjustment from GPS, gimbal and calibration, and their correction by the images.

With a rolling shutter, the rows of a photo are exposed one after the other. During the readout, a camera moves by its
velocity times the readout time, and rotates by a small angle. Each camera has one readout time, and each photo has six
numbers for its rotation (eqs. 10 and 11 in docs/method/bundle.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Camera
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.solver import Priors
from alight.photos.reading.photo_pose import GPS_SIGMA
from alight.records import NavSample, Rig
from alight.settings import BundleSettings

_SIGMA_LENS = {  # 1-sigma of scale, if the focal length is free, aspect, cu, cv, distortion: see docs/method/bundle.md
    "none": (0.02, 0.0, 10.0, 10.0),
    "radial-tangential": (0.02, 0.0, 10.0, 10.0, 0.05, 0.1, 0.002, 0.002, 0.2),
    "equidistant": (0.02, 0.0, 10.0, 10.0) + (0.02,) * 4,
}
SIGMA_RATE = 0.2  # rad/s, 1-sigma of the rotation of a camera without a gimbal
_SIGMA_READOUT = 0.05  # s, 1-sigma; cheap cameras take 20 to 160 ms, which is 0.2 to 2 m of flight
COMMON_HEADING = 0.5  # rad, 1-sigma of the common error of all headings; some compasses are off by 0.9 rad
HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # half a turn about the optical axis
_COMPASS = 0.05  # rad; headings with a smaller sigma are not from a compass
_LENS_PHOTOS = 12  # with fewer photos of a camera, its radial distortion is fixed


def make_priors(
    nav: Sequence[NavSample | None], rig: Rig, settings: BundleSettings, cameras: I64 | None = None
) -> Priors:
    """Build priors from positions, attitudes and calibration; the settings give the sigmas that a photo lacks.

    `cameras` (n,) is the index of the rig's camera that took each photo; None: the first camera took all photos. All
    cameras are assumed to share one mounting. There is no rolling shutter until `rolling_priors` adds it.
    """
    n = len(nav)
    centres, sigma = np.full((n, 3), np.nan), np.tile(GPS_SIGMA, (n, 1))
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
    """Return the initial camera and the sigmas of its parameters; a free lens without distortion model gets a model."""
    if settings.lens == "free" and camera.model == "none":
        camera = replace(camera, model="radial-tangential", distortion=(0.0,) * 4)
    sigma, free = np.zeros(5 + len(camera.distortion)), _SIGMA_LENS[camera.model]
    if settings.lens == "free":
        sigma[:-1] = free[: len(sigma) - 1]
    sigma[0] = free[0] if settings.focal == "free" else 0.0
    return camera, sigma


def levelled(priors: Priors) -> Priors:
    """Return the priors with all photos at one height, the median of the altitude tags."""
    centres = priors.centres.copy()
    centres[:, 2] = np.where(np.isfinite(centres[:, 2]), np.nanmedian(centres[:, 2]), np.nan)
    return replace(priors, centres=centres)


def corrected_priors(priors: Priors, turned: I64, contradicted: I64) -> Priors:
    """Rotate the gimbal tags of `turned` photos by half a turn, and drop the tags of `contradicted` photos."""
    attitude = priors.world_from_body.copy()
    B = priors.body_from_cam
    attitude[turned] = attitude[turned] @ (B @ HALF_TURN @ B.T)
    attitude[contradicted] = np.nan
    return replace(priors, world_from_body=attitude)


def one_compass(priors: Priors, groups: Sequence[I64]) -> Priors:
    """Enlarge heading sigmas so that all headings of a group, which share a compass error, weigh like one heading.

    Headings with a sigma below 0.05 rad do not come from a compass and are not changed.
    """
    sigma = priors.sigma_rotation.copy()
    tagged = np.isfinite(priors.world_from_body).all(axis=(1, 2)) & (sigma[:, 2] >= _COMPASS)
    for group in groups:
        some = group[tagged[group]]
        sigma[some, 2] = np.hypot(sigma[some, 2], COMMON_HEADING * np.sqrt(len(some)))
    return replace(priors, sigma_rotation=sigma)


def gps_heading_sigma(photos: I64, priors: Priors) -> float:
    """Return the 1-sigma (rad) of a heading from the GPS positions of two or more photos; infinite if all are equal."""
    centres, sigma = priors.centres[photos, :2], priors.sigma_centres[photos, :2]
    known = np.isfinite(centres).all(axis=1)
    arm = float(np.linalg.norm(centres[known] - centres[known].mean(axis=0)))
    return float(np.sqrt((sigma[known] ** 2).mean())) / arm if arm > 0 else float("inf")


def observable_lens(priors: Priors, photos: I64) -> Priors:
    """Fix the radial distortion, which correlates with height, of cameras with few photos (docs/method/bundle.md)."""
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
    """Add a rolling shutter, whose readout time is free if enough velocities are known and the maker does not give it.

    If all lens parameters are fixed, so are the readout times.

    Args:
        priors: priors of all photos.
        centres: (n, 3) metres, camera centres as adjusted so far.
        seconds: (n,) exposure time of each photo, s; NaN: unknown.
    """
    velocity = velocities(centres, seconds, priors.lenses.of)
    sigma, held = priors.sigma_lens.copy(), not priors.sigma_lens.any()
    for k, number in enumerate(priors.lenses.readout_numbers):
        known = velocity[priors.lenses.of == k].any(axis=1)
        free = not held and known.sum() >= _LENS_PHOTOS and priors.lenses.by_maker[k] is None
        sigma[number] = _SIGMA_READOUT if free else 0.0
    return replace(priors, sigma_lens=sigma, velocity=velocity)


def at_once(priors: Priors, sigma_turn: float = 0.0) -> Priors:
    """Return priors with fixed readout times; `sigma_turn`: rad, 1-sigma of a photo's rotation during the readout."""
    sigma = priors.sigma_lens.copy()
    sigma[priors.lenses.readout_numbers] = 0.0
    return replace(priors, sigma_lens=sigma, sigma_turn=sigma_turn)


def velocities(centres: F64, seconds: F64, camera: I64) -> F64:
    """Return the (n, 3) velocity in m/s at each photo, from the photos before and after it; 0 where unknown.

    If the legs before and after a photo differ in direction, as at the end of a strip, the faster leg is used, because
    the slower one contains the turn. Legs that last over a minute, are shorter than a metre, or are faster than 60 m/s
    (wrong tags) are ignored.

    Args:
        centres: (n, 3) metres.
        seconds: (n,) time of each photo, s; NaN: unknown.
        camera: (n,) camera index of each photo; only photos of one camera are compared.
    """
    out = np.zeros_like(centres)
    for one in np.unique(camera):
        who = np.flatnonzero((camera == one) & np.isfinite(seconds))
        who = who[np.argsort(seconds[who], kind="stable")]
        way, time = np.diff(centres[who], axis=0), np.diff(seconds[who])
        long = np.linalg.norm(way, axis=1)
        good = (time > 0) & (time <= 60.0) & (long > 1.0) & (long <= 60.0 * time)
        for k, i in enumerate(who):
            legs = [(way[j], time[j], long[j]) for j in (k - 1, k) if 0 <= j < len(good) and good[j]]
            if len(legs) == 2 and legs[0][0] @ legs[1][0] > 0.8 * legs[0][2] * legs[1][2]:  # the same direction
                out[i] = (legs[0][0] + legs[1][0]) / (legs[0][1] + legs[1][1])
            elif legs:
                out[i] = max((leg / t for leg, t, _ in legs), key=lambda v: float(v @ v))
    return out
