"""Which photos of a folder are pictures of the ground as the eye sees it: thermal pictures stand aside."""

from __future__ import annotations

from collections.abc import Sequence

from alight.sources.photo_tags import PhotoTags

THERMAL_SIZES = ((640, 512), (640, 480), (336, 256), (160, 120))  # of microbolometers, longer side first
LEAST_OTHERS = 3  # other photos from which the size alone tells a thermal picture


def thermal_photos(photos: Sequence[PhotoTags]) -> list[PhotoTags]:
    """Thermal pictures of a set that has others as well; empty where there is nothing else.

    The tags or the file's name tell them. The size alone does so only beside enough others, since photos that were
    made smaller may have it too.
    """
    told = [p for p in photos if _told_thermal(p)]
    rest = [p for p in photos if not _told_thermal(p)]
    sized = [p for p in rest if (max(p.size), min(p.size)) in THERMAL_SIZES]
    others = len(rest) - len(sized)
    if others >= max(LEAST_OTHERS, len(sized) / 2):
        return told + sized
    return told if rest else []


def _told_thermal(photo: PhotoTags) -> bool:
    source, band = photo.xmp.get("dji:ImageSource", "").lower(), photo.xmp.get("camera:BandName", "").lower()
    return "infrared" in source or band == "lwir" or photo.path.stem.endswith("_T")
