"""Draw labels over photos, look at them on a run's map, and check the file.

    PYTHONPATH=bench python training/label.py page PHOTOS --out label.html
    PYTHONPATH=bench python training/label.py check bench/labels/mirafiori.json
    PYTHONPATH=bench python training/label.py show out/mirafiori bench/labels/mirafiori.json --out overlay.png
    PYTHONPATH=bench python training/label.py geojson out/mirafiori bench/labels/mirafiori.json --out labels.geojson

`page` writes one HTML page that holds the photos and is drawn on in a browser; it loads and saves the file of labels.
`show` paints the labels over a run's orthophoto. `geojson` gives them in longitude and latitude (RFC 7946) by the poses
of that run. docs/lab/land-cover.md explains why labels are kept in pixels of photos.
"""

from __future__ import annotations

import argparse
import base64
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio.features
from label_file import HAZARDS, KINDS, OPEN, ROUGH, counts, problems, read_labels
from label_projection import LabelledMap, labelled_map
from numpy.typing import NDArray

from alight.arrays import U8
from alight.outputs.reading import Run, read_run
from alight.photos.reading.photo_selection import find_photos
from alight.records import Frame
from alight.runner.opening import open_source
from alight.settings import Settings

TEMPLATE = Path(__file__).with_name("label_page.html")
GREEN, RED, ORANGE, MAGENTA = (40, 200, 40), (230, 40, 40), (255, 160, 0), (220, 60, 220)
COLOURS = dict.fromkeys(HAZARDS, RED) | dict.fromkeys(OPEN, GREEN) | {ROUGH: ORANGE, "unsure": MAGENTA}
TINT = 0.35  # share of a label's colour in the overlay


def photo_times(folder: Path) -> dict[str, int]:
    """Capture time in ns of every photo of a folder by its name, as in a run over the folder."""
    return {e.name: e.t_ns for e in open_source(folder, Settings()).events() if isinstance(e, Frame)}


def page(folder: Path, only: list[str]) -> str:
    """The page for drawing, with the photos in it.

    Args:
        folder: of photos.
        only: file names of the photos to show; empty: all.

    Raises:
        InputError: the folder holds no photos that a run can use.
        ValueError: a photo of `only` is not in the folder.
    """
    times = photo_times(folder)
    if unknown := sorted(set(only) - set(times)):
        raise ValueError(f"{folder}: no photo {', '.join(unknown)}")
    files = {p.name: p for p in find_photos(folder).files if p.name in times and (not only or p.name in only)}
    lens = open_source(folder, Settings()).rig.cameras[0].camera
    data = {
        "set": folder.parent.name if folder.name == "images" else folder.name,
        "width": lens.width,
        "height": lens.height,
        "times": {name: str(t) for name, t in times.items()},
        "kinds": KINDS,
        "colours": {kind: f"rgb{colour}" for kind, colour in COLOURS.items()},
        "photos": {name: base64.b64encode(path.read_bytes()).decode() for name, path in sorted(files.items())},
    }
    return TEMPLATE.read_text(encoding="utf-8").replace("/*DATA*/", json.dumps(data))


def overlay(run: Run, truth: LabelledMap) -> U8:
    """The orthophoto with the labels over it, (R, C, 3): hazards red, open ground green, rough orange, unsure violet.

    Raises:
        ValueError: the run has no orthophoto.
    """
    if run.ortho is None:
        raise ValueError(f"{run.folder}: the run has no ortho.tif")
    out = run.ortho.copy()
    for colour, where in (
        (GREEN, truth.open_ground),
        (ORANGE, truth.rough),
        (RED, truth.hazard),
        (MAGENTA, truth.unsure),
    ):
        out[where] = ((1 - TINT) * out[where] + TINT * np.array(colour)).astype(np.uint8)
        outlines, _ = cv2.findContours(where.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(out, outlines, -1, colour, 1)
    return out


def geojson(run: Run, truth: LabelledMap) -> dict[str, Any]:
    """The labels as polygons in longitude and latitude (RFC 7946), by the run's place on Earth."""
    if run.local is None:
        raise ValueError(f"{run.folder}: the run has no place on Earth")
    transform = rasterio.Affine(*truth.grid.transform)
    features = []
    for kind, where in truth.kinds.items():
        for shape, _ in rasterio.features.shapes(where.astype(np.uint8), mask=where, transform=transform):
            rings = [_lon_lat(run, np.array(ring), i > 0) for i, ring in enumerate(shape["coordinates"])]
            geometry = {"type": "Polygon", "coordinates": rings}
            features.append({"type": "Feature", "geometry": geometry, "properties": {"kind": kind}})
    return {"type": "FeatureCollection", "features": features}


def _lon_lat(run: Run, ring: NDArray[np.float64], hole: bool) -> list[list[float]]:
    """A closed ring (N, 2) of metres east and north in degrees: counter-clockwise, a hole clockwise (RFC 7946)."""
    assert run.local is not None
    (x, y), (x1, y1) = ring[:-1].T, ring[1:].T
    clockwise = float((x * y1 - x1 * y).sum()) < 0
    ring = ring if clockwise == hole else ring[::-1]
    latitude, longitude, _ = run.local.to_geodetic(np.column_stack([ring, np.zeros(len(ring))]))
    return [[round(float(x), 8), round(float(y), 8)] for x, y in zip(longitude, latitude, strict=True)]


def check(path: Path) -> int:
    """Print the faults of a file of labels, or its counts; return the exit code."""
    labels = read_labels(path)
    wrong = problems(labels)
    for sentence in wrong:
        print(f"{path}: {sentence}")
    if not wrong:
        held = ", ".join(f"{n} {kind}" for kind, n in counts(labels.polygons).items())
        print(f"{path}: {len(labels.polygons)} polygons in {len({p.photo for p in labels.polygons})} photos: {held}")
    return 1 if wrong else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("page", help="write the page for drawing")
    draw.add_argument("photos", type=Path)
    draw.add_argument("--photo", action="append", default=[], help="only this photo; may be given many times")
    draw.add_argument("--out", type=Path, required=True)
    for name, help_text in (("show", "paint the labels over a run's orthophoto"), ("geojson", "labels on Earth")):
        command = commands.add_parser(name, help=help_text)
        command.add_argument("run", type=Path)
        command.add_argument("labels", type=Path)
        command.add_argument("--out", type=Path, required=True)
    commands.add_parser("check", help="check a file of labels").add_argument("labels", type=Path)
    return parser


def main(given: list[str] | None = None) -> int:
    args = _parser().parse_args(given)
    if args.command == "check":
        return check(args.labels)
    if args.command == "page":
        args.out.write_text(page(args.photos, args.photo), encoding="utf-8")
        return 0
    run = read_run(args.run)
    truth = labelled_map(run, read_labels(args.labels))
    if args.command == "show":
        cv2.imwrite(str(args.out), cv2.cvtColor(overlay(run, truth), cv2.COLOR_RGB2BGR))
    else:
        args.out.write_text(json.dumps(geojson(run, truth)) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
