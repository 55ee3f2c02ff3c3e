"""Read libraries of labelled pictures of land cover."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from alight.arrays import U8
from alight.documents import DocumentError, read_text
from alight.records import InputError, Terrain
from alight.sources.image_formats import PLAIN
from alight.sources.images import UNREADABLE, image_size, read_image
from alight.training.patches import LabelledPatch

SAMPLING = 0.05  # metres per pixel, if no other value is given
TILE = 4.8  # metres; larger pictures are cut into tiles with this side
KINDS = {
    Terrain.BARE: "bare gravel soil sand dirt",
    Terrain.SHORT_GRASS: "short_grass grass lawn",
    Terrain.TALL_VEGETATION: "tall_vegetation tall_grass vegetation shrub shrubs crop crops",
    Terrain.TREE: "tree trees forest",
    Terrain.WATER: "water",
    Terrain.ROCK: "rock rocks boulder boulders",
    Terrain.PAVED: "paved road asphalt concrete",
    Terrain.STRUCTURE: "structure building buildings vehicle vehicles building_vehicle roof roofs car cars",
}
CODES = {name: kind for kind, known in KINDS.items() for name in known.split()}


def kind_of(folder: str) -> Terrain | None:
    """Return the class that a folder is named for (`water`, `5_water` or `5`); None if it is named for no class."""
    name = folder.lower().replace("-", "_").replace(" ", "_")
    number, _, rest = name.partition("_")
    if number.isdigit():
        return Terrain(int(number)) if 1 <= int(number) <= max(Terrain) else CODES.get(rest)
    return CODES.get(name)


def _index(folder: Path) -> dict[str, dict[str, str]]:
    path = folder / "index.csv"
    if not path.exists():
        return {}
    try:
        return {row["file"]: row for row in csv.DictReader(io.StringIO(read_text(path, 100_000_000), newline=""))}
    except (OSError, DocumentError, csv.Error, KeyError) as e:
        raise InputError(f"{path}: not a table with the columns file, site, gsd_m; mend it or take it away") from e


def _tiles(rgb: U8, sampling: float) -> Iterator[U8]:
    side = max(8, round(TILE / sampling))
    if min(rgb.shape[:2]) < 2 * side:
        yield rgb
        return
    rows, cols = (np.unique(np.linspace(0, n - side, min(5, n // side)).astype(int)) for n in rgb.shape[:2])
    for r in rows:
        for c in cols:
            yield np.ascontiguousarray(rgb[r : r + side, c : c + side])


def read_picture(path: Path) -> U8:
    """Read a picture as (H, W, 3) RGB.

    Raises:
        InputError: the picture cannot be read or is grey.
    """
    rgb = _read(path)
    if rgb.ndim != 3:
        raise InputError(f"{path}: grey; terrain is learned from colour pictures, take it away")
    return rgb


def _read(path: Path) -> U8:
    try:
        return read_image(path, image_size(path))
    except UNREADABLE as e:
        raise InputError(
            f"{path}: not a readable picture ({' '.join(str(e).split())}); copy it again or take it away"
        ) from e


def _pictures(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in PLAIN and not p.is_dir())


def read_library(folder: Path, usual: float = SAMPLING) -> list[LabelledPatch]:
    """Read labelled patches from a folder that has one sub-folder per class.

    The site of a picture comes from index.csv, else from the folder between the picture and its class's folder.
    Otherwise all pictures share one site.

    Args:
        folder: contains `bare/`, `water/`, ... or class codes, `5_water/`; index.csv (file, site, gsd_m) is optional.
        usual: metres per pixel of pictures for which index.csv gives none.

    Raises:
        InputError: no sub-folder is named for a class, a class has no pictures, or a picture cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name one that has a folder of pictures for each class")
    index, patches = _index(folder), []
    for sub in sorted(p for p in folder.iterdir() if p.is_dir()):
        kind = kind_of(sub.name)
        if kind is None:
            continue
        found = _pictures(sub)
        if not found:
            raise InputError(f"{sub}: no pictures (jpg, png, tif); add some or take the folder away")
        for path in found:
            name = path.relative_to(folder).as_posix()
            row = index.get(name, {})
            between = path.parent.relative_to(sub).parts
            site = row.get("site") or (between[0] if between else "all")
            try:
                sampling = float(row.get("gsd_m") or usual)
            except ValueError:
                sampling = 0.0
            if not 0 < sampling < 100:
                why = f"gsd_m in index.csv is {row.get('gsd_m', '')!r}; give metres a pixel such as 0.05"
                raise InputError(f"{path}: {why}")
            patches += [LabelledPatch(t, sampling, int(kind), site, name) for t in _tiles(read_picture(path), sampling)]
    if not patches:
        known = ", ".join(k.name.lower() for k in KINDS)
        raise InputError(f"{folder}: no folder in it is named for a class; name them {known}")
    return patches


def is_labelled(folder: Path) -> bool:
    """Whether a folder holds pictures with one label per pixel, instead of one sub-folder per class."""
    return (folder / "images").is_dir() and (folder / "labels").is_dir()


def read_labelled(folder: Path) -> Iterator[tuple[str, U8, U8]]:
    """Yield name, picture (H, W, 3) and `Terrain` codes (H, W) of each picture in `images/` with a label in `labels/`.

    Raises:
        InputError: no picture has a label, a file cannot be read, or picture and label differ in size.
    """
    labels = {p.stem: p for p in _pictures(folder / "labels")}
    both = [p for p in _pictures(folder / "images") if p.stem in labels]
    if not both:
        raise InputError(f"{folder}: no picture in images/ has one of the same name in labels/")
    for path in both:
        rgb, where = read_picture(path), labels[path.stem]
        label = _read(where)
        if label.shape != rgb.shape[:2] or label.max() > max(Terrain):
            raise InputError(f"{where}: needs one grey value a pixel of {path.name}, the code of its class (0 to 8)")
        yield path.stem, rgb, label
