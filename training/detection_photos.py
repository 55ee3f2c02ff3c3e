"""Probability that pixels show a spot, from real photos and their reduced copies (docs/lab/p-safe.md); prints only.

    PYTHONPATH=bench python training/detection_photos.py ../shared/data/mirafiori ../shared/data/caliterra

A spot has, at full resolution, a contrast above that of 98 % of the places of the same photo: as in `detection.py`, but
without a truth. It is found where this holds again in the photo reduced 2, 3 and 4 times and compressed anew. Reduced
photos are sharper and less noisy than photos from farther away, so the shares are upper bounds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from alight.arrays import F32, F64
from alight.hazards.evidence import patch_mean
from alight.hazards.picture_spots import spots_of
from alight.raster import local_max, log_brightness

WIDTHS = (6.0, 9.0, 12.0, 18.0, 24.0)  # pixels of the full photo
REDUCED = (2, 3, 4)
FALSE = 0.98  # share of the places of a photo below the limit of a spot
QUALITY = 92  # of the JPEG that the reduced photo becomes
PHOTOS = 12  # of a folder, evenly spread


def strength(rgb: np.ndarray, width: float) -> F32:
    """Root mean square contrast of spots of a width in pixels, as in the evidence, (H, W)."""
    height = width / 2
    return np.sqrt(np.maximum(patch_mean(spots_of(log_brightness(rgb), height) ** 2, 1.0, height), 0))


def reduced(rgb: np.ndarray, factor: int) -> np.ndarray:
    """The photo as from a camera with fewer pixels: reduced and compressed."""
    size = (rgb.shape[1] // factor, rgb.shape[0] // factor)
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    packed = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))


def found_again(photo: Path) -> list[tuple[float, int, int]]:
    """Rows of one photo: width over the reduced pixel, number of spots, and number of those found again."""
    rgb, out = np.asarray(cv2.imread(str(photo))), []
    for width in WIDTHS:
        full = strength(rgb, width)
        peaks = (full >= local_max(full, round(width / 2))) & (full > np.quantile(full[::4, ::4], FALSE))
        rows, cols = np.nonzero(peaks)
        for factor in REDUCED:
            small = strength(reduced(rgb, factor), width / factor)
            near = local_max(small, 1)
            at = (rows // factor).clip(0, small.shape[0] - 1), (cols // factor).clip(0, small.shape[1] - 1)
            out.append((width / factor, len(rows), int((near[at] > np.quantile(small[::2, ::2], FALSE)).sum())))
    return out


def main() -> None:
    """Print the shares of each folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    for folder in parser.parse_args().folders:
        photos = sorted(p for p in folder.rglob("*") if p.suffix.lower() in {".jpg", ".jpeg"})
        counts: dict[float, F64] = {}
        for photo in photos[:: max(1, len(photos) // PHOTOS)][:PHOTOS]:
            for size, spots, again in found_again(photo):
                counts[size] = counts.get(size, np.zeros(2)) + np.array([spots, again])
        print(folder.name)
        for size in sorted(counts):
            spots, again = counts[size]
            print(f"  {size:5.1f} pixels wide: {100 * again / spots:5.1f} % of {spots:.0f} spots found again")


if __name__ == "__main__":
    main()
