"""Position and attitude of a photo from its tags, as GPS/INS measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from alight.arrays import F64
from alight.geometry import LocalFrame, Pose, enu_from_flu
from alight.photos.reading.agreement import METRES_A_DEGREE
from alight.photos.reading.photo_tags import PhotoTags
from alight.records import NavSample

# a photo's body frame is its gimbal's; at zero angles x points along the optical axis, y left, z up
BODY_FROM_CAM = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
CRAFT_FROM_NADIR = enu_from_flu(0, 0, 0).T @ enu_from_flu(0, -math.pi / 2, 0)  # a camera fixed to look down

SIGMAS = {  # m, east north up: of a consumer receiver, and least ones that a receiver gives; rad: of roll pitch yaw
    "consumer": np.array([3.0, 3.0, 5.0]), "RTK fixed": np.full(3, 0.01), "RTK float": np.full(3, 0.5),
    "others": np.array([0.02, 0.02, 0.03]), "gimbal": np.array([0.02, 0.02, 0.1]),
    "flight": np.array([0.05, 0.05, 0.1]),
}  # fmt: skip
GPS_SIGMA = SIGMAS["consumer"]
RTK_FIXES = ("RTK fixed", "RTK float")
GIMBALS = (
    "dji:Gimbal{}Degree", "parrot:Camera{}Degree", "autel:Gimbal{}Degree", "skydio:CameraOrientationNED{}",
    "yuneec:Gimbal{}", "Camera{}",  # the last pattern is of Yuneec's CGO3+
)  # fmt: skip
PIX4D, FLIGHT = "camera:{}", "dji:Flight{}Degree"
ACCURACIES = (  # horizontal, vertical
    ("camera:GPSXYAccuracy", "camera:GPSZAccuracy"), ("skydio:GpsHorizontalAccuracy", "skydio:GpsVerticalAccuracy"),
)  # fmt: skip


def photo_attitude(tags: PhotoTags) -> tuple[F64 | None, str]:
    """Return `world_from_body` (3, 3) of the gimbal, and the kind of tags that give it, or why no tags are used.

    The attitude is None without usable tags; the text is empty if there are no tags at all. The attitude is also None
    if the EXIF orientation turns the picture, because no maker documents whether the angles then belong to the turned
    picture or to the stored pixels.

    Makers' own tags give angles relative to NED; at zero the camera looks to the horizon. Pix4D's `Camera:Yaw, Pitch,
    Roll` (Autel, Parrot Sequoia, senseFly, Sentera and others) are zero if the camera looks down with the image's top
    to the north. Some Autel drones write a pitch from the horizon into Pix4D's tags, which is then below -45 degrees.
    """
    if tags.turned:
        return None, f"not used: EXIF orientation {tags.turned}"
    for pattern in GIMBALS:
        if (gimbal := _angles(tags, pattern)) is not None:
            return enu_from_flu(*gimbal), "gimbal"
    if (pix4d := _angles(tags, PIX4D)) is not None and pix4d[1] < math.radians(-45.0):
        return enu_from_flu(*pix4d), "camera, from the horizon"
    if pix4d is not None:
        yaw, pitch, roll = pix4d
        sign = -1 if "sensefly" in tags.text(0x010F).lower() else 1  # senseFly's roll has the opposite sign
        return enu_from_flu(yaw, pitch, sign * roll) @ CRAFT_FROM_NADIR, "camera"
    if (flight := _angles(tags, FLIGHT)) is not None:
        return enu_from_flu(*flight) @ CRAFT_FROM_NADIR, "flight"
    return None, "not used: the same in all photos" if tags.distrusted else ""


def with_attitudes_settled(photos: Sequence[PhotoTags]) -> tuple[list[PhotoTags], list[str]]:
    """Mark angles that cannot be attitudes as distrusted; return the photos, and a warning for each kind of angles.

    Such angles are zero in all photos, or equal to the last digit although the flight turned. With fewer than three
    photos, no angles are distrusted.
    """
    same, warnings = set[str](), list[str]()
    for pattern in (*GIMBALS, PIX4D, FLIGHT):
        found = {angles for p in photos if (angles := _angles(p, pattern)) is not None}
        if not found:
            continue
        if len(found) > 1 or len(photos) < 3 or (any(*found) and not _turns(photos)):
            break  # the first angles that vary are used
        same.add(pattern)
        which = pattern.format("").rstrip(":").removesuffix("Degree")
        what = "are the same, although the flight turned," if any(*found) else "are 0"
        warnings.append(f"the angles {which} {what} in all photos: they are not used")
    return [replace(p, distrusted=frozenset(same)) for p in photos] if same else list(photos), warnings


def _turns(photos: Sequence[PhotoTags]) -> bool:
    """Whether at least two legs each differ in direction by more than 45 degrees from at least two other legs.

    Legs shorter than the error of GPS are ignored. A single leg in another direction may be an error of GPS.
    """
    timed = sorted(photos, key=lambda p: (p.time_ns or 0, p.path))
    places = np.array([p.place for p in timed if p.place is not None]).reshape(-1, 2)
    legs = np.diff(places, axis=0) * (METRES_A_DEGREE * np.array([1.0, np.cos(np.radians(places[:1, 0])).sum()]))
    long = np.linalg.norm(legs, axis=1)
    ways = legs[long > GPS_SIGMA[0]] / long[long > GPS_SIGMA[0], None]
    others = (ways @ ways.T < math.cos(math.radians(45.0))).sum(axis=1)  # legs in other directions
    return int((others >= 2).sum()) >= 2


def _angles(tags: PhotoTags, pattern: str) -> tuple[float, float, float] | None:
    if pattern in tags.distrusted:
        return None
    values = [v for name in ("Yaw", "Pitch", "Roll") if (v := tags.xmp_number(pattern.format(name))) is not None]
    if len(values) < 3:
        return None
    yaw, pitch, roll = (math.radians(v or 0.0) for v in values)  # no negative zero
    return yaw, pitch, roll


def position_sigma(tags: PhotoTags) -> F64:
    """Return the 1-sigma (3,) of a photo's position in metres, east, north, up, from the position file, else the tags.

    Where none is given, it is the 1-sigma of a consumer receiver.
    """
    if tags.settled is not None and tags.settled.sigma is not None:
        return np.where(np.isfinite(tags.settled.sigma), tags.settled.sigma, GPS_SIGMA)
    own = [tags.xmp_number(f"dji:RtkStd{axis}") for axis in ("Lon", "Lat", "Hgt")]
    if (fix := rtk_fix(tags)) in RTK_FIXES and all(s is not None and s > 0 for s in own):
        return np.asarray(np.maximum(np.array(own, dtype=np.float64), SIGMAS[fix]))
    sigma = GPS_SIGMA.copy()
    for names in ACCURACIES:
        for name, axes in zip(names, (slice(0, 2), slice(2, 3)), strict=True):
            value = tags.xmp_number(name)
            if value is not None and value > 0:  # 0: unknown
                sigma[axes] = np.maximum(value, SIGMAS["others"][axes])
    return sigma


def rtk_fix(tags: PhotoTags) -> str:
    """Return the name of the position file if one is used, else the kind of fix by DJI's flag; empty without a flag."""
    if tags.settled is not None and tags.settled.source:
        return tags.settled.source
    flag = tags.xmp_number("dji:RtkFlag")
    if flag is None:
        return ""
    if flag in range(32, 50):
        return "RTK float"
    return {50: "RTK fixed", 16: "single point"}.get(int(flag), "")


def local_frame(photos: Sequence[PhotoTags]) -> LocalFrame:
    """Return the local frame of the set: its origin is the median location at the height of take-off.

    The height of take-off is the first photo's absolute minus its relative altitude or, without a relative altitude, 50
    m below the lowest photo. This height only keeps the numbers small; no measurement depends on it.
    """
    places = np.array([p for t in photos if (p := t.position) is not None])
    if np.ptp(places[:, 1]) > 180:  # photos on both sides of longitude 180: counted eastwards from 0 to 360
        places[:, 1] %= 360
    latitude, longitude = np.round(np.median(places[:, :2], axis=0), 7)
    first = next(t for t in photos if t.position is not None)
    relative = first.relative_altitude
    height = places[:, 2].min() - 50 if relative is None else places[0, 2] - relative
    longitude -= 360 * (longitude > 180)
    return LocalFrame(float(latitude), float(longitude), round(float(height), 2))


def nav_sample(tags: PhotoTags, t_ns: int, local: LocalFrame) -> NavSample:
    """Return the position and attitude of one photo as a measurement; each is None if the tags do not give it."""
    place = tags.position
    world_from_body, source = photo_attitude(tags)
    sigma = SIGMAS["flight" if source == "flight" else "gimbal"]
    return NavSample(
        t_ns,
        None if place is None else local.to_enu(*place),
        world_from_body,
        sigma_position=None if place is None else position_sigma(tags),
        sigma_attitude=None if world_from_body is None else sigma.copy(),
    )
