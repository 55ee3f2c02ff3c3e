"""The picture that a factory calibration is for, of which a tool may have made a resized, cropped or turned photo."""

from __future__ import annotations

from typing import NamedTuple

from PIL import ExifTags

from alight.photos.reading.photo_tags import PhotoTags

Base = ExifTags.Base


class CalibratedPicture(NamedTuple):
    """Picture that the factory calibration is for, with its sides in the order of the photo's."""

    width: float  # pixels
    height: float
    scale: float  # photo pixels per pixel of this picture, digital zoom not included
    turned: bool  # whether the photo was turned by 90 degrees, to either side
    is_known: bool  # False: no tag gives the size, so that of the photo is assumed

    def doubt(self, size: tuple[int, int], focal: float, alone: bool) -> str:
        """Return in words what the tags leave open about a focal length; empty: nothing.

        Args:
            size: width and height of the photo, pixels.
            focal: focal length, pixels, on the assumption that a photo smaller than this picture was resized.
            alone: whether every source of the focal length depends on whether photos were resized.
        """
        if alone and not self.is_known:
            return (
                f"{focal:.0f} px is unconfirmed, since no tag has the size of the picture that it is for: if the "
                "photos were resized, give it with --set sources.calibration=PIXELS"
            )
        if self.scale > 0.9:
            return ""
        return (
            f"photos of {size[0]}x{size[1]} come from {self.width:.0f}x{self.height:.0f} pixels: {focal:.0f} px is "
            f"used, as for resized photos; for cropped ones, --set sources.calibration={focal / self.scale:.0f}"
        )


def calibrated_picture(tags: PhotoTags) -> CalibratedPicture:
    """Find the picture that the factory calibration is for, by the size and the optical centre in the tags.

    Tools may rewrite the size, but not the centre. If the aspect ratios differ, the photo was cropped, and is assumed
    to have the full width or the full height. If they agree, resized and cropped photos look alike: see `doubt`.
    """
    (w, h), exif_width = tags.size, tags.number(Base.ExifImageWidth)
    width = exif_width or w
    height = tags.number(Base.ExifImageHeight) or width * h / w
    centre = "{}:CalibratedOpticalCenter{}".format
    across, down = (2 * (tags.xmp_number(centre("dji", a)) or tags.xmp_number(centre("skydio", a)) or 0) for a in "XY")
    if across > 0 and not _alike(across, width) and _alike(across, height):
        width, height = height, width  # the size was rewritten after a turn
    if across > 0:
        down = down if down > 0 else across * height / width
        width, height = (s if _alike(s, by_centre) else by_centre for s, by_centre in ((width, across), (height, down)))
    turned = (w - h) * (width - height) < 0 and not _alike(w, width) and not _alike(h, height)
    if turned:
        width, height = height, width
    by_dji = any(tags.xmp.get(f"dji:{k}") for k in ("CalibratedFocalLength", "DewarpData", "DewarpDataK6"))
    # DJI writes the centre beside each calibration: without it, a tool has rewritten the tags, and perhaps the size
    known = across > 0 or (bool(exif_width) and (not by_dji or width != w))
    return CalibratedPicture(width, height, max(w / width, h / height), turned, known)


def _alike(a: float, b: float) -> bool:
    """Whether two lengths differ by a tenth at most, as twice the optical centre and the size of one picture do."""
    return abs(a / b - 1) <= 0.1
