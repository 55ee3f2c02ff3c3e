"""Selection of the photos of a folder that are used: thermal pictures and further bands are left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from alight.photos.reading.photo_tags import PhotoTags

THERMAL_SIZES = ((640, 512), (640, 480), (336, 256), (160, 120))  # of microbolometers, longer side first
BANDS = ("green", "red")  # the first ones among as many photos of each: most like a grey picture, the sharpest lenses
LEAST_OTHERS = 3  # other photos from which a thermal picture is recognised by its size alone


def thermal_photos(photos: Sequence[PhotoTags]) -> list[PhotoTags]:
    """Thermal pictures of a set that has others as well; empty where there are no others.

    They are recognised by the tags or the file's name. The size alone decides only beside enough others, since photos
    that were made smaller may have it too.
    """
    told = [p for p in photos if _told_thermal(p)]
    rest = [p for p in photos if not _told_thermal(p)]
    sized = [p for p in rest if (max(p.size), min(p.size)) in THERMAL_SIZES]
    others = len(rest) - len(sized)
    if others >= max(LEAST_OTHERS, len(sized) / 2):
        return told + sized
    return told if rest else []


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
    return max(counts, key=lambda band: (counts[band], *(band.lower() == b for b in BANDS)))


def _told_thermal(photo: PhotoTags) -> bool:
    source, band = photo.xmp.get("dji:ImageSource", "").lower(), photo.xmp.get("camera:BandName", "").lower()
    return "infrared" in source or band == "lwir" or photo.path.stem.endswith("_T")
