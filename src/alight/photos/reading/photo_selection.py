"""Find photos in a folder; leave out panoramas, thermal pictures and further bands; recognise false colours."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from alight.arrays import U8
from alight.photos.reading.photo_tags import COLOUR, Base, PhotoTags
from alight.records import InputError
from alight.sources.image_formats import EXTRAS, PLAIN, missing_extra

SUFFIXES = (*PLAIN, *EXTRAS)
VIVID = 30.0  # grey levels, spread of the colours about grey: photos of the ground have 4 to 21, palettes 24 to 170
CURVE = 1.5  # cells of 16 levels that colours take, per level of spread: palettes take 0.2 to 1.5, vivid photos 2 to 10


class FoundPhotos(NamedTuple):
    """Pictures found in a folder, sorted, and sub-folders without read permission."""

    files: list[Path]
    closed: list[Path]


def find_photos(folder: Path) -> FoundPhotos:
    """Find the pictures in a folder and its sub-folders, such as `DCIM/100MEDIA` on a card.

    Hidden files, thumbnails and the output of programs, including Alight, are left out. A file with several links to it
    appears once. A raw or HEIC picture is left out if a plain picture of the same name lies next to it.

    Raises:
        OSError: the folder itself cannot be read.
    """
    closed, files = list[Path](), dict[str, Path]()
    for path in _pictures(folder, 3, closed):
        real = os.path.realpath(path)
        if real not in files or real == str(path):
            files[real] = path
    plain = {path.with_suffix("") for path in files.values() if path.suffix.lower() in PLAIN}
    found = [p for p in files.values() if p.suffix.lower() in PLAIN or p.with_suffix("") not in plain]
    return FoundPhotos(sorted(found), sorted(closed))


def _pictures(folder: Path, depth: int, closed: list[Path]) -> Iterator[Path]:
    """Yield the pictures in a folder, down to `depth` levels below it; append unreadable sub-folders to `closed`."""
    for path in sorted(folder.iterdir()):
        if not path.is_dir():
            if path.suffix.lower() in SUFFIXES and not path.name.startswith("."):
                yield path
        elif depth > 0:
            try:
                inside = list(_pictures(path, depth - 1, closed)) if _may_hold_photos(path) else []
            except PermissionError:
                closed.append(path)
            else:
                yield from inside


def _may_hold_photos(folder: Path) -> bool:
    name = folder.name.lower()
    output = name == "mav0" or name.startswith((".", "odm_", "thumb")) or "thumbnails" in name
    return not output and not (folder / "run.json").exists()


class LeftOut(NamedTuple):
    """Photos of a set that are not used, with reasons."""

    reasons: dict[Path, str]  # reason by path
    group: str  # name under which these photos are counted
    warning: str = ""  # one sentence; empty: no warning


def without_extra(files: Sequence[Path]) -> LeftOut:
    """Return the files to leave out because their format needs an extra (optional package) that is not installed."""
    lacking = {path: str(error) for path in files if (error := missing_extra(path)) is not None}
    counts = Counter(lacking.values())
    warning = "; ".join(f"{count} photo(s) are left out: {why}" for why, count in counts.items())
    return LeftOut(lacking, "photos without their extra", warning)


def thermal_photos(photos: Sequence[PhotoTags]) -> LeftOut:
    """Return the thermal pictures to leave out of a set that also has other pictures.

    Thermal pictures are recognised by tags or file name. A name that a user may have chosen is evidence only if all
    pictures of its camera have such names, and another camera took pictures too. A thermal sensor's picture size is
    evidence only next to enough other pictures, because downsized photos may have that size too. A set of thermal
    pictures alone is kept.
    """
    cameras = {p.camera for p in photos if not _is_named_thermal(p)}
    tagged = [p for p in photos if _is_tagged_thermal(p)
              or (cameras and p.camera not in cameras and _is_named_thermal(p))]  # fmt: skip
    found = {p.path for p in tagged}
    rest = [p for p in photos if p.path not in found]
    sized = [p for p in rest if _has_thermal_size(p)]
    thermal = tagged + sized if len(rest) - len(sized) >= max(3, len(sized) / 2) else tagged if rest else []
    warning = f"{len(thermal)} thermal picture(s) are left out (first: {thermal[0].path.name})" if thermal else ""
    return LeftOut({p.path: "a thermal picture" for p in thermal}, "thermal pictures", warning)


def panoramas(photos: Sequence[PhotoTags]) -> LeftOut:
    """Return the stitched panoramas to leave out, by their XMP tags; warn of other pictures twice as wide as high.

    Raises:
        InputError: all pictures are panoramas.
    """
    kinds = {p.path: kind for p in photos if (kind := p.xmp.get("gpano:ProjectionType"))}
    wide = [p.path.name for p in photos if p.path not in kinds and p.size[0] == 2 * p.size[1]]
    if kinds and len(kinds) == len(photos):
        raise InputError(
            f"{photos[0].path.parent}: all {len(photos)} pictures are panoramas ({photos[0].path.name}), which have no "
            "focal length; give the single pictures"
        )
    warnings = [f"{len(kinds)} panorama(s) are left out (first: {next(iter(kinds)).name})"] if kinds else []
    if wide:
        warnings.append(f"{len(wide)} picture(s) are twice as wide as high, as panoramas are (first: {wide[0]})")
    reasons = {path: f"a panorama ({kind})" for path, kind in kinds.items()}
    return LeftOut(reasons, "panoramas", "; ".join(warnings))


def band_to_use(photos: Sequence[PhotoTags]) -> str | None:
    """Return the one band of a multispectral set to use; empty: its colour pictures; None: the set has no bands.

    Bands are not mixed, because each has its own lens and position. Colour pictures are used if they are at least
    half as many as the pictures of the largest band.
    """
    counts = Counter(p.band for p in photos)
    colour = counts.pop("", 0)
    if not counts:
        return None
    if colour >= max(counts.values()) / 2:
        return ""
    # of bands with equally many photos, green and red come first: most like a grey picture, the sharpest lenses
    return max(counts, key=lambda band: (counts[band], *(band.lower() == b for b in ("green", "red"))))


def other_bands(photos: Sequence[PhotoTags]) -> LeftOut:
    """Return the pictures to leave out because a multispectral camera took them in a band that is not used."""
    group, band = "pictures of other bands", band_to_use(photos)
    if band is None:
        return LeftOut({}, group)
    others = [p for p in photos if p.band != band]
    used = f"band {band.removeprefix('band ')} is" if band else "the colour pictures are"
    first = f" (first: {others[0].path.name})" if others else ""
    return LeftOut(
        {p.path: f"{p.band or 'colour'}: {used} used" for p in others}, group,
        f"{len(others)} picture(s) of single bands are left out{first}: of a multispectral camera {used} used",
    )  # fmt: skip


def false_colours(photos: Sequence[PhotoTags], read: Callable[[PhotoTags], U8]) -> str:
    """Return what the colours of a set show: `temperatures`, `near infrared`, or empty for true colours and for grey.

    A palette gives colours that no ground has, and either lies on a curve in the space of colours or has a thermal
    sensor's picture size. That size alone is no evidence, because downsized photos may have it too; if grey pictures
    have it, the text mentions that they may show temperatures.

    Args:
        photos: photos of the set; thermal pictures are already left out if there are other pictures.
        read: decodes a photo, (H, W) or (H, W, 3); may raise ValueError.
    """
    if all(_is_tagged_thermal(p) for p in photos):
        return "temperatures"
    if all(_sees_infrared(p) for p in photos):
        return "near infrared"
    sized, pictures = all(_has_thermal_size(p) for p in photos), list[U8]()
    for photo in photos[:: -(-len(photos) // 3)]:
        with suppress(ValueError):
            pictures.append(read(photo))
    coloured = [_is_palette(p, sized) for p in pictures if p.ndim == 3]
    if coloured and all(coloured):
        return "temperatures"
    grey = sized and pictures and all(p.ndim == 2 or np.ptp(p, axis=2).mean() < 1 for p in pictures)
    return "temperatures, if of a thermal camera, whose size they have" if grey else ""


def _is_palette(picture: U8, sized: bool) -> bool:
    """Whether a picture (H, W, 3) has the colours of a palette; `sized`: whether it has a thermal sensor's size."""
    every = -(-max(picture.shape) // 1000)
    sample = picture[::every, ::every].reshape(-1, 3).astype(np.int64)
    about = sample - sample.mean(axis=1, keepdims=True)
    spread = float(np.sqrt(about.var(axis=0).sum()))
    full = np.sort(np.bincount(sample // 16 @ np.array([256, 16, 1])))[::-1].cumsum()
    return spread > VIVID and (sized or int(np.searchsorted(full, 0.95 * full[-1])) < CURVE * spread)


def _is_tagged_thermal(photo: PhotoTags) -> bool:
    source, band = photo.xmp.get("dji:ImageSource", "").lower(), photo.xmp.get("camera:BandName", "").lower()
    by_maker = re.search(r"^DJI_\d[\d_]*_(T|IR)(_|$)|^IRX_", photo.path.stem, re.IGNORECASE) is not None
    hinted = _is_named_thermal(photo) or photo.is_radiometric or "flir" in photo.text(Base.Make).lower()
    return "infrared" in source or band == "lwir" or by_maker or (hinted and _has_thermal_size(photo))


def _is_named_thermal(photo: PhotoTags) -> bool:
    """Whether the file's name has the letters of thermal pictures (T or IR); an owner may have chosen them, too."""
    return re.search(r"_(T|IR)$|\d_(T|IR)_|^IRX_", photo.path.stem, re.IGNORECASE) is not None


def _has_thermal_size(photo: PhotoTags) -> bool:
    return [max(photo.size), min(photo.size)] in _thermal_sizes()


@cache
def _thermal_sizes() -> list[list[int]]:
    """Return width and height of thermal sensors (microbolometers), pixels."""
    found: list[list[int]] = json.loads(Path(__file__).with_name("thermal_sizes.json").read_text())
    return found


def _sees_infrared(photo: PhotoTags) -> bool:
    """Whether a colour channel is infrared, by the band names or by the filter name of a MAPIR Survey camera."""
    bands = [b.strip().lower() for b in photo.xmp.get("camera:BandName", "").split(",") if b.strip()]
    by_filter = re.search(r"(RGN|NGB|OCN|RE|NIR)$", photo.text(Base.Model)) is not None
    by_bands = len(bands) > 1 and not set(bands) <= {"red", "green", "blue", *COLOUR}
    return by_bands or (by_filter and "survey" in photo.text(Base.Model).lower())
