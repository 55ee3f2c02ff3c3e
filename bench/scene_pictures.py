"""Pictures of the built-in scenes, for the documentation where it shows them, and for `alight simulate --list`.

python bench/scene_pictures.py          # all; or the names of some
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

import alight_sim as simulate
from alight.arrays import U8
from alight_sim.scene import FOLDER, built_in

DOCS = Path(__file__).parents[1] / "docs" / "scenes"
HEIGHTS = (20, 100)  # metres
SMALL, SMALL_QUALITY = (120, 90), 72  # px
MOST_BYTES = 60_000
SEED = 1


def picture(name: str, height: float) -> U8:
    """Picture of the left camera from above the middle of a scene, (480, 640, 3) RGB."""
    return simulate.fly(name, SEED, 1.0, height=height, speed=1.0).image(4, 0)


def save(image: U8, path: Path, quality: int = 88) -> None:
    """Write a JPEG, coarser until it is small enough."""
    path.parent.mkdir(parents=True, exist_ok=True)
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    while True:
        data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if len(data) <= MOST_BYTES or quality < 30:
            break
        quality -= 5
    path.write_bytes(np.asarray(data).tobytes())
    print(f"{path}: {len(data) / 1000:.0f} kB, quality {quality}", flush=True)


def main() -> None:
    """Draw every scene at every height."""
    shown = (DOCS.parent / "simulator.md").read_text(encoding="utf-8")
    for name in sys.argv[1:] or built_in():
        for height in HEIGHTS:
            image = picture(name, height)
            path = DOCS / f"{name}-{height}m.jpg"
            if f"scenes/{path.name}" in shown:
                save(image, path)
        small = cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA)
        save(np.asarray(small), FOLDER / "pictures" / f"{name}.jpg", SMALL_QUALITY)


if __name__ == "__main__":
    main()
