"""A folder of drone photos as a source: one exposure and one GPS/INS measurement a photo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from alight.geometry import Camera
from alight.records import Event, Frame, InputError, Rig, RigCamera
from alight.settings import ImuNoise, Settings
from alight.sources.images import UNREADABLE, read_image
from alight.sources.kalibr import read_camchain
from alight.sources.photo_camera import photo_camera
from alight.sources.photo_pose import BODY_FROM_CAM, local_frame, nav_sample, photo_attitude, position_sigma, rtk_flag
from alight.sources.photo_tags import PhotoTags, read_tags
from alight.sources.source import Findings, RecordedSource, Trajectory

SUFFIXES = (".jpg", ".jpeg")
GENERIC = ("images", "photos", "dcim", "jpg")  # folder names that say nothing; the parent's says more
SECOND = 1_000_000_000
RTK_NAMES = {50: "RTK fixed", 34: "RTK float", 16: "single point"}


def find_photos(folder: Path) -> list[Path]:
    """JPEG files of a folder and of its sub-folders (one level: DCIM/100MEDIA), hidden ones left out."""
    found = [*folder.iterdir(), *(p for sub in sorted(folder.iterdir()) if sub.is_dir() for p in sub.iterdir())]
    return sorted(p for p in found if p.suffix.lower() in SUFFIXES and not p.name.startswith(".") and p.is_file())


class Photos(RecordedSource):
    """The photos of one camera in one folder.

    Raises:
        InputError: no readable photo, none with GPS, or no focal length.
    """

    kind: Literal["photos"] = "photos"
    truth_trajectory: Trajectory | None = None
    georeferenced = True
    imu_noise = ImuNoise()

    def __init__(self, root: Path, files: Sequence[Path], settings: Settings) -> None:
        self._findings = Findings()
        self._findings.expect("photos", len(files))
        self.name = root.parent.name if root.name.lower() in GENERIC else root.name
        photos = self._one_camera(self._upright(self._readable(files)))
        if not any(p.position for p in photos):
            raise InputError(
                f"{root}: no photo has a GPS position; photos need EXIF GPS latitude, longitude and altitude"
            )
        ordered = self._in_order(photos)[settings.sources.skip :: settings.sources.every]
        if not any(p.position for _, p in ordered):
            raise InputError(f"{root}: no photo with GPS is left; lower sources.skip ({settings.sources.skip})")
        self._photos = ordered
        self._names = _names([p for _, p in ordered], root)
        self.length = len(ordered)
        self.local = local_frame([p for _, p in ordered])
        self.rig, self.notes = self._calibrate(settings)
        self._note()

    def events(self) -> Iterator[Event]:
        lens = self.rig.cameras[0].camera
        for (t_ns, tags), name in zip(self._photos, self._names, strict=True):
            try:
                image = read_image(tags.path, (lens.width, lens.height))
            except ValueError as e:
                self._findings.lose("photos", name, str(e))
                continue
            yield nav_sample(tags, t_ns, self.local)
            yield Frame(t_ns, (image,), name)

    # -- opening

    def _readable(self, files: Sequence[Path]) -> list[PhotoTags]:
        photos = []
        for path in files:
            try:
                tags, problem = read_tags(path)
            except UNREADABLE as e:
                self._findings.lose("photos", path.name, "it is no image" if "identify" in str(e) else str(e))
                continue
            photos.append(tags)
            if problem:
                self._findings.say(f"{path.name}: {problem}, so its gimbal and calibration are unknown")
        if not photos:
            raise InputError(f"{files[0].parent}: none of the {len(files)} JPEG files can be read; copy them again")
        return photos

    def _upright(self, photos: list[PhotoTags]) -> list[PhotoTags]:
        """Leave out photos that are stored turned: their attitude tags do not say about which axes."""
        upright = [p for p in photos if p.orientation in (0, 1)]
        for p in photos:
            if p.orientation not in (0, 1):
                why = f"its EXIF orientation is {p.orientation}; turn it losslessly and set the tag to 1"
                self._findings.lose("photos", p.path.name, why)
        if not upright:
            raise InputError(
                f"{photos[0].path.parent}: every photo has an EXIF orientation other than 1; turn them losslessly"
            )
        return upright

    def _one_camera(self, photos: list[PhotoTags]) -> list[PhotoTags]:
        groups = Counter(p.camera for p in photos)
        (chosen, _), *others = groups.most_common()
        for other, count in others:
            first = next(p.path.name for p in photos if p.camera == other)
            self._findings.say(f"{count} photo(s) of another camera are left out: {_title(other)} (first: {first})")
            self._findings.counts["photos of another camera"] = sum(n for _, n in others)
        return [p for p in photos if p.camera == chosen]

    def _in_order(self, photos: list[PhotoTags]) -> list[tuple[int, PhotoTags]]:
        """By time of capture, then name; photos of one second share it out, so that time rises strictly."""
        times = {p.path: p.time_ns for p in photos}
        if any(t is None for t in times.values()):
            n = sum(t is None for t in times.values())
            self._findings.say(f"{n} photo(s) have no capture time: the order of the file names is used")
            return [(k * SECOND, p) for k, p in enumerate(sorted(photos, key=lambda p: p.path))]
        ordered = sorted(photos, key=lambda p: (times[p.path] or 0, p.path))
        return list(zip(_spread([times[p.path] or 0 for p in ordered]), ordered, strict=True))

    def _calibrate(self, settings: Settings) -> tuple[Rig, dict[str, Any]]:
        first = self._photos[0][1]
        if settings.sources.calibration:
            path = Path(settings.sources.calibration).expanduser()
            blank = Rig((RigCamera("cam0", Camera(*first.size, 1, 1, 0, 0), BODY_FROM_CAM),))
            lens = read_camchain(path, blank, BODY_FROM_CAM).cameras[0].camera
            return Rig((RigCamera("cam0", lens, BODY_FROM_CAM),)), {
                "focal_from": f"Kalibr {path.name}",
                "focal_px": lens.fu,
            }
        dewarp = Counter(p.xmp.get("dji:DewarpData", "") for _, p in self._photos).most_common()
        chosen = next(p for _, p in self._photos if p.xmp.get("dji:DewarpData", "") == dewarp[0][0])
        if len(dewarp) > 1:
            self._findings.say(
                f"the photos carry {len(dewarp)} different factory calibrations: the most frequent one is used"
            )
        lens, notes = photo_camera(chosen)
        return Rig((RigCamera("cam0", lens, BODY_FROM_CAM),)), notes

    def _note(self) -> None:
        photos = [p for _, p in self._photos]
        kinds = Counter(photo_attitude(p)[1] or "none" for p in photos)
        flags = Counter(RTK_NAMES.get(rtk_flag(p) or 0, "GPS") for p in photos if p.position)
        self.notes |= {
            "camera": _title(photos[0].camera),
            "image_size": list(photos[0].size),
            "gps": dict(flags),
            "attitude_from": dict(kinds),
            "position_sigma": np.median([position_sigma(p) for p in photos], axis=0).round(3).tolist(),
        }
        if set(flags) - {"RTK fixed"}:
            self.notes["height_note"] = (
                "without an RTK fix a drone's altitude may be above sea level, not the ellipsoid"
            )
        if missing := sum(p.position is None for p in photos):
            low = sum(p.position is None and p.place is not None for p in photos)
            but = f" ({low} of them lack the altitude alone: write GPSAltitude)" if low else ""
            self._findings.say(
                f"{missing} of {len(photos)} photos have no GPS position{but}: their place comes from the pictures "
                "alone"
            )
        if kinds["flight"]:
            self._findings.say(
                f"{kinds['flight']} photo(s) have no gimbal angles: a camera fixed to look down is assumed"
            )
        if kinds["none"]:
            self._findings.say(f"{kinds['none']} photo(s) say nothing about where the camera looked")


def _title(camera: tuple[str, str, tuple[int, int], float | None]) -> str:
    make, model, (w, h), focal = camera
    return f"{make or 'unknown'} {model or 'camera'}, {w}x{h}" + (f", {focal:g} mm" if focal else "")


def _names(photos: Sequence[PhotoTags], root: Path) -> list[str]:
    """File names; where two folders have the same one, with the folder."""
    taken = Counter(p.path.name for p in photos)
    return [p.path.name if taken[p.path.name] == 1 else p.path.relative_to(root).as_posix() for p in photos]


def _spread(times: Sequence[int]) -> list[int]:
    out: list[int] = []
    i = 0
    while i < len(times):
        n = times.count(times[i])
        gap = min(SECOND, times[i + n] - times[i]) if i + n < len(times) else SECOND
        out += [times[i] + k * gap // n for k in range(n)]
        i += n
    return out
