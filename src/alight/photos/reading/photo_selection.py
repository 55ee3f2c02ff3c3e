"""Search for the photos of a folder, as of a card or a survey; thermal pictures and further bands are left out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from alight.photos.reading.photo_tags import PhotoTags

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


class FoundPhotos(NamedTuple):
    """Pictures of a folder, sorted, and its sub-folders that may not be read."""

    files: list[Path]
    closed: list[Path]


def find_photos(folder: Path) -> FoundPhotos:
    """Pictures of a folder and of its sub-folders (as `DCIM/100MEDIA` of a card).

    Hidden files are left out, as are thumbnails and the output of programs, Alight's included. A file that links reach
    as well is taken once.

    Raises:
        OSError: the folder itself cannot be read.
    """
    closed, files = list[Path](), dict[str, Path]()
    for path in _pictures(folder, 3, closed):
        real = os.path.realpath(path)
        if real not in files or real == str(path):
            files[real] = path
    return FoundPhotos(sorted(files.values()), sorted(closed))


def _pictures(folder: Path, depth: int, closed: list[Path]) -> Iterator[Path]:
    """Yield the pictures of a folder and of so many levels below it; folders without permission go to `closed`."""
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


def thermal_photos(photos: Sequence[PhotoTags]) -> list[PhotoTags]:
    """Thermal pictures of a set that has others as well; empty where there are no others.

    They are recognised by the tags or the file's name. The size alone decides only beside enough others, since photos
    that were made smaller may have it too.
    """
    tagged = [p for p in photos if _is_tagged_thermal(p)]
    rest = [p for p in photos if not _is_tagged_thermal(p)]
    microbolometers = (640, 512), (640, 480), (336, 256), (160, 120)
    sized = [p for p in rest if (max(p.size), min(p.size)) in microbolometers]
    if len(rest) - len(sized) >= max(3, len(sized) / 2):
        return tagged + sized
    return tagged if rest else []


def band_to_use(photos: Sequence[PhotoTags]) -> str | None:
    """The band of a multispectral camera that is used alone; empty: the colour pictures; None: there are no bands.

    Each band has a lens and a place of its own. Colour pictures are used if they are at least half as many as those of
    a band.
    """
    counts = Counter(p.band for p in photos)
    colour = counts.pop("", 0)
    if not counts:
        return None
    if colour >= max(counts.values()) / 2:
        return ""
    # the first ones among as many photos of each: most like a grey picture, the sharpest lenses
    return max(counts, key=lambda band: (counts[band], *(band.lower() == b for b in ("green", "red"))))


def _is_tagged_thermal(photo: PhotoTags) -> bool:
    source, band = photo.xmp.get("dji:ImageSource", "").lower(), photo.xmp.get("camera:BandName", "").lower()
    return "infrared" in source or band == "lwir" or photo.path.stem.endswith("_T")
