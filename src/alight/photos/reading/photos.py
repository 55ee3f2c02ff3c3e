"""A folder of drone photos as a source: one exposure and one GPS/INS measurement per photo.

Each zoom level, and each further camera with enough photos, is a camera of the rig. Each exposure has one picture.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from hashlib import blake2b, file_digest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.arrays import U8
from alight.geometry import Camera
from alight.photos.reading.photo_camera import (
    GUESSED,
    Claim,
    Notes,
    dewarp_text,
    focal_given,
    guessed_camera,
    photo_camera,
    photo_readout,
)
from alight.photos.reading.photo_pixels import PhotoPixels, PictureMemory, PictureReader
from alight.photos.reading.photo_pose import (
    BODY_FROM_CAM,
    local_frame,
    nav_sample,
    photo_attitude,
    position_sigma,
    rtk_fix,
    with_attitudes_settled,
)
from alight.photos.reading.photo_selection import LeftOut, other_bands, panoramas, thermal_photos, without_extra
from alight.photos.reading.photo_tags import PhotoCamera, PhotoTags, finite, read_tags
from alight.photos.reading.positions import flights_of, settle_positions
from alight.photos.reading.repeated import repeated_photos
from alight.records import Event, Frame, InputError, NavSample, PhotoFacts, Rig, RigCamera
from alight.settings import Settings
from alight.sources.calibration import read_camchain
from alight.sources.images import UNREADABLE
from alight.sources.source import Source

SECOND = 1_000_000_000  # ns
LEAST_OF_A_CAMERA = 3  # a further camera with fewer photos is left out


class UsedPhoto(NamedTuple):
    """A photo that is used, with its measurement and camera."""

    tags: PhotoTags
    nav: NavSample  # position and attitude by the tags
    camera: int  # index of the rig's camera


class Photos(Source):
    """Source of the photos in one folder.

    Args:
        root: the folder.
        files: paths of the photos.
        closed: sub-folders without read permission, which a warning names.
        read: returns the tags of a photo, and their fault in words; see `read_tags`.
        places, geoid: files for `settle_positions`.

    Raises:
        InputError: no photo can be read, or no photo has a GPS position.
    """

    kind = "photos"
    georeferenced = True

    def __init__(
        self,
        root: Path,
        files: Sequence[Path],
        settings: Settings,
        closed: Sequence[Path] = (),
        read: Callable[[Path], tuple[PhotoTags, str]] = read_tags,
        places: Path | None = None,
        geoid: Path | None = None,
    ) -> None:
        super().__init__()
        self._root = root
        self._reader = PictureReader()
        self._memory = PictureMemory(0.5 * 1e6 * settings.parallax.store_mb, self._reader.read)
        self._tags: dict[Path, PhotoTags] = {}  # of all readable photos
        self._left_out: dict[Path, str] = {}  # reason for each unused photo
        self.findings.expect("photos", len(files))
        if closed:
            names = ", ".join(self._name_of(p) for p in closed)
            self.findings.warn(f"no permission to read {names}: photos in there are left out")
        generic = root.name.lower() in ("images", "photos", "dcim", "jpg")
        self.name = root.parent.name if generic else root.name
        photos = self._readable(files, read)
        for left_out in (partial(repeated_photos, read=self._reader.pixels_of), panoramas, thermal_photos, other_bands):
            photos = self._without(photos, left_out(photos))
        photos = self._of_cameras(photos, settings)
        positions = settle_positions(photos, root, places, geoid)
        photos, distrusted = with_attitudes_settled(positions.photos)
        self._tags |= {p.path: p for p in photos}
        for warning in positions.warnings + distrusted:
            self.findings.warn(warning)
        for warning in positions.contradictions:
            self.findings.contradict(warning)
        self.notes |= {"positions_from": positions.source, "heights_count_from": positions.counted_from}
        if not any(p.position for p in photos):
            raise InputError(f"{root}: no photo has a GPS position; photos need EXIF GPS latitude and longitude")
        ordered = self._in_order(photos)[settings.sources.skip :: settings.sources.every]
        if not any(p.position for _, p in ordered):
            raise InputError(f"{root}: no photo with GPS is left; lower sources.skip ({settings.sources.skip})")
        self._photos = ordered
        skipped = {p.path for p in photos} - {p.path for _, p in ordered}
        self._left_out |= dict.fromkeys(skipped, "by sources.skip or sources.every")
        self._cameras = [c for c, _ in Counter(p.camera for _, p in ordered).most_common()]
        self._names = _names([p for _, p in ordered], root)
        self._flights = flights_of([p for _, p in ordered])
        self.length = len(ordered)
        self.local = local_frame([p for _, p in ordered])
        self.rig = self._calibrate(settings)
        self.notes |= self._reader.settle([p for _, p in ordered])
        self._note()

    def events(self) -> Iterator[Event]:
        for (t_ns, tags), name in zip(self._photos, self._names, strict=True):
            try:
                self._memory.get(tags.path, tags.size)
            except ValueError as e:
                self._lose(tags.path, str(e))
                continue
            yield nav_sample(tags, t_ns, self.local)
            pixels, own = PhotoPixels(tags.path, tags.size, self._memory), self._cameras.index(tags.camera)
            yield Frame(t_ns, tuple(pixels if k == own else None for k in range(len(self._cameras))), name)

    @property
    def photos(self) -> list[PhotoFacts]:
        """Facts about each photo, including unused photos; complete after all `events` have been read."""
        facts = {path: facts_of(tags) for path, tags in self._tags.items()}
        source = str(self.notes["focal_from"])
        by_user = source if source.startswith(("Kalibr", "sources.")) else ""
        for (t_ns, tags), name, flight in zip(self._photos, self._names, self._flights, strict=True):
            own, focal_from = self._cameras.index(tags.camera), facts[tags.path].focal_from
            facts[tags.path] = replace(
                facts[tags.path], name=name, t_ns=t_ns, group=f"flight {flight + 1}, camera {own + 1}",
                focal_px=round(self.rig.cameras[own].camera.fu, 1), focal_from=by_user or focal_from or GUESSED,
            )  # fmt: skip
        for path, why in self._left_out.items():
            known = facts.get(path) or PhotoFacts(self._name_of(path), (0, 0), "")
            facts[path] = replace(known, left_out=why, t_ns=None)
        return [facts[path] for path in sorted(facts)]

    @property
    def exposures(self) -> list[UsedPhoto]:
        """The used photos in order of time."""
        return [
            UsedPhoto(tags, nav_sample(tags, t_ns, self.local), self._cameras.index(tags.camera))
            for t_ns, tags in self._photos
        ]

    def read(self, tags: PhotoTags) -> U8:
        """Decode a photo of the set; see `PictureReader.read` for shapes and errors."""
        return self._reader.pixels_of(tags)

    def digest(self) -> str:
        """Compute a digest of the names, times, XMP tags, settled positions and bytes of all used photos."""
        of = blake2b()
        for (t_ns, tags), name in zip(self._photos, self._names, strict=True):
            with tags.path.open("rb") as file:
                line = f"{name} {t_ns} {tags.xmp} {tags.settled} {file_digest(file, blake2b).hexdigest()}\n"
            of.update(line.encode(errors="surrogateescape"))
        return of.hexdigest()

    # -- opening

    def _name_of(self, path: Path) -> str:
        return path.relative_to(self._root).as_posix()

    def _lose(self, path: Path, why: str) -> None:
        self.findings.lose("photos", self._name_of(path), why)
        self._left_out[path] = why

    def _without(self, photos: list[PhotoTags], left_out: LeftOut) -> list[PhotoTags]:
        """Return the photos that `left_out` does not contain; record its reasons, count and warning."""
        self._left_out |= left_out.reasons
        self.findings.counts |= {left_out.group: len(left_out.reasons)} if left_out.reasons else {}
        if left_out.warning:
            self.findings.warn(left_out.warning)
        return [p for p in photos if p.path not in left_out.reasons]

    def _readable(self, files: Sequence[Path], read: Callable[[Path], tuple[PhotoTags, str]]) -> list[PhotoTags]:
        damaged, lacking = list[str](), without_extra(files)
        self._without([], lacking)
        for path in (f for f in files if f not in lacking.reasons):
            try:
                self._tags[path], problem = read(path)
            except UNREADABLE as e:
                self._lose(path, "it is no image" if "identify" in str(e) else str(e))
                continue
            if problem:
                damaged.append(f"{path.name}: {problem}")
        if damaged:
            self.findings.warn(
                f"{len(damaged)} photo(s) have damaged XMP (first: {damaged[0]}): of attitude and calibration, only "
                "what can be picked out of it is used"
            )
        if not self._tags:
            why = lacking.warning or "copy them again"
            raise InputError(f"{files[0].parent}: none of the pictures can be read ({len(files)} found); {why}")
        return list(self._tags.values())

    def _of_cameras(self, photos: list[PhotoTags], settings: Settings) -> list[PhotoTags]:
        """Return the photos of the most used camera, and of others with enough photos and a focal length in their tags.

        If the settings give a calibration, the photos of all other cameras are left out.
        """
        out = dict[object, str]()
        for camera, count in Counter(p.camera for p in photos).most_common()[1:]:
            first = next(p for p in photos if p.camera == camera)
            if settings.sources.calibration:
                out[camera] = "the focal length that is given is of another camera"
            elif count < LEAST_OF_A_CAMERA:
                out[camera] = f"fewer than {LEAST_OF_A_CAMERA} photos of its camera"
            elif facts_of(first).focal_px is None:
                out[camera] = "no focal length in its tags"
            else:
                continue
            self.findings.warn(
                f"{count} photo(s) of another camera are left out: {camera.title} (first: {first.path.name}): "
                f"{out[camera]}"
            )
        return self._without(
            photos, LeftOut({p.path: out[p.camera] for p in photos if p.camera in out}, "photos of another camera")
        )

    def _in_order(self, photos: list[PhotoTags]) -> list[tuple[int, PhotoTags]]:
        """Return (ns, photo) sorted by capture time, then path; equal times are spread out, so that time rises."""
        times = {p.path: t for p in photos if (t := p.time_ns) is not None}
        if n := len(photos) - len(times):
            self.findings.warn(f"{n} photo(s) have no capture time: the order of the file names is used")
            return [(k * SECOND, p) for k, p in enumerate(sorted(photos, key=lambda p: p.path))]
        ordered = sorted(photos, key=lambda p: (times[p.path], p.path))
        return list(zip(spread_times([times[p.path] for p in ordered]), ordered, strict=True))

    def _calibrate(self, settings: Settings) -> Rig:
        """Build the rig with one lens per camera; record in the notes where the focal lengths come from."""
        focal_px = finite(settings.sources.calibration)
        if settings.sources.calibration and focal_px is None:
            path = Path(settings.sources.calibration).expanduser()
            blank = RigCamera("cam0", Camera(*self._photos[0][1].size, 1, 1, 0, 0), BODY_FROM_CAM)
            lens = read_camchain(path, Rig((blank,)), BODY_FROM_CAM).cameras[0].camera
            given = Claim(f"Kalibr {path.name}", lens, family="user")
            self.notes |= self._settled(photo_camera(self._photos[0][1], given)[1], self._cameras[0])
            return Rig((replace(blank, camera=lens),))
        cameras, notes = list[RigCamera](), list[Notes]()
        for k, camera in enumerate(self._cameras):
            its = [p for _, p in self._photos if p.camera == camera]
            lens, its_notes = self._lens(camera, its, focal_px)
            readout = Counter(photo_readout(p) for p in its).most_common(1)[0][0]
            cameras.append(RigCamera(f"cam{k}", lens, BODY_FROM_CAM, readout))
            notes.append(its_notes)
        self.notes |= notes[0]
        if len(cameras) > 1:
            self.notes["cameras"] = [
                f"{c.title}: {n['focal_px']:g} px, {n['focal_from']}" for c, n in zip(self._cameras, notes, strict=True)
            ]
        return Rig(tuple(cameras))

    def _settled(self, notes: Notes, camera: PhotoCamera) -> Notes:
        """Record `focal_warning` as a contradiction and `focal_doubt` as a warning; return the notes without the two.

        Both are removed from `notes`, which describe the focal length of `camera`.
        """
        if warning := notes.pop("focal_warning", ""):
            self.findings.contradict(f"focal length of {camera.title}: {warning}")
        if doubt := notes.pop("focal_doubt", ""):
            self.findings.warn(f"focal length of {camera.title}: {doubt}")
        return notes

    def _lens(self, camera: PhotoCamera, photos: list[PhotoTags], focal_px: float | None) -> tuple[Camera, Notes]:
        """Return the lens of one camera and notes on it, from the calibration that most of its `photos` carry.

        `focal_px`: focal length given by the user; None: by the tags or, with a warning, guessed.
        """
        dewarp = Counter(dewarp_text(p) for p in photos).most_common()
        chosen = next(p for p in photos if dewarp_text(p) == dewarp[0][0])
        if len(dewarp) > 1:
            self.findings.warn(
                f"the photos carry {len(dewarp)} different factory calibrations: the most frequent one is used"
            )
        try:
            lens, notes = photo_camera(chosen, None if focal_px is None else focal_given(chosen, focal_px))
            return lens, self._settled(notes, camera)
        except InputError:
            lens, notes = guessed_camera(chosen)
            self.findings.warn(
                f"no usable focal length in the tags of {camera.title}: {lens.fu:.0f} pixels are a guess, wrong by up "
                "to a quarter, and heights above ground scale with it; give the true one with --set "
                "sources.calibration=PIXELS, or camchain.yaml"
            )
            return lens, notes

    def _note(self) -> None:
        photos = [p for _, p in self._photos]
        kinds = Counter(photo_attitude(p)[1] or "none" for p in photos)
        flags = Counter(rtk_fix(p) or "GPS" for p in photos if p.position)
        self.notes |= {
            "camera": photos[0].camera.title,
            "image_size": list(photos[0].size),
            "gps": dict(flags),
            "attitude_from": dict(kinds),
            "position_sigma": np.median([position_sigma(p) for p in photos], axis=0).round(3).tolist(),
        }
        if not str(self.notes["heights_count_from"]).startswith("ellipsoid"):
            self.notes["height_note"] = (
                "an altitude above sea level lies up to 100 m from one above the ellipsoid: all heights alike"
            )
        if self._flights[-1]:
            self.notes["flights"] = self._flights[-1] + 1
        missing = sum(p.position is None for p in photos)
        low = sum(p.position is None and p.place is not None for p in photos)
        but = f" ({low} of them lack the altitude alone: write GPSAltitude)" if low else ""
        turned = sum(p.turned > 0 for p in photos)
        shows, hidden = self.notes.get("false_colours", ""), self.notes.get("hidden", "")
        for count, warning in (
            (len(photos) if shows else 0, f"the colours of all {len(photos)} pictures show {shows} (first: "
             f"{photos[0].path.name}): they are read as grey, and refuse no water or plants; give colour pictures too"),
            (len(hidden), f"transparency hides pixels ({hidden}): they are filled smoothly from their "
             "surroundings, and are no evidence of heights"),
            (missing, f"{missing} of {len(photos)} photos have no GPS position{but}: their place comes from the "
             "pictures alone"),
            (kinds["flight"], f"{kinds['flight']} photo(s) have no gimbal angles: a camera fixed to look down is "
             "assumed"),
            (turned, f"{turned} photo(s) have an EXIF orientation other than 1: their pixels are used as they are "
             "stored, their attitude tags are not used"),
            (kinds["none"], f"{kinds['none']} photo(s) say nothing about where the camera looked"),
        ):  # fmt: skip
            if count:
                self.findings.warn(warning)


def facts_of(tags: PhotoTags) -> PhotoFacts:
    """Return facts about one photo from its own tags."""
    make, model, size, *_ = tags.camera
    focal, focal_from = None, ""
    with suppress(InputError):
        lens, notes = photo_camera(tags)
        focal, focal_from = round(lens.fu, 1), str(notes["focal_from"])
    place, t_ns = tags.position, tags.time_ns
    fix = rtk_fix(tags) or "GPS"
    return PhotoFacts(
        tags.path.name, size, f"{make or 'unknown'} {model or 'camera'}", focal, focal_from,
        None if place is None else place[:2], "" if place is None else fix, None if place is None else place[2],
        "" if place is None else tags.altitude_kind, tags.relative_altitude, photo_attitude(tags)[1],
        "" if t_ns is None else f"{datetime.fromtimestamp(t_ns // SECOND, UTC):%Y-%m-%d %H:%M:%S}",
    )  # fmt: skip


def _names(photos: Sequence[PhotoTags], root: Path) -> list[str]:
    """Return the file names of photos; where folders share a file name, return paths relative to `root`."""
    taken = Counter(p.path.name for p in photos)
    return [p.path.name if taken[p.path.name] == 1 else p.path.relative_to(root).as_posix() for p in photos]


def spread_times(times: Sequence[int]) -> list[int]:
    """Spread equal times of a sorted list, ns, over the gap to the next later time, over one second at most."""
    out: list[int] = []
    for t, n in Counter(times).items():
        after = len(out) + n
        gap = min(SECOND, times[after] - t) if after < len(times) else SECOND
        out += [t + k * gap // n for k in range(n)]
    return out
