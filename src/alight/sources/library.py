"""Libraries of terrain pictures, and the models that were trained on them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import U8
from alight.documents import DocumentError, read_bytes, read_text
from alight.learned import arrays_of, table_path
from alight.records import InputError, Terrain
from alight.sources.images import UNREADABLE, image_size, read_image
from alight.terrain.features import LEVELS, names
from alight.terrain.model import Head, Model
from alight.training.patches import LabelledPatch

DEFAULT_MODEL = table_path("appearance")
PICTURES = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
SAMPLING = 0.05  # metres a pixel, where no other value is given
TILE = 4.8  # metres: larger pictures are cut into tiles of this side
LARGEST, LARGEST_INDEX = 64_000_000, 100_000_000  # bytes of a model, of index.csv
LONGEST_PROVENANCE = 20_000  # characters
MOST_TILES = 25  # of one picture
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
    """The class in a folder's name: `water`, `5_water` or `5`; None if it names none."""
    name = folder.lower().replace("-", "_").replace(" ", "_")
    number, _, rest = name.partition("_")
    if number.isdigit():
        return Terrain(int(number)) if 1 <= int(number) <= max(Terrain) else CODES.get(rest)
    return CODES.get(name)


def _index(folder: Path) -> dict[str, dict[str, str]]:
    """Rows of index.csv by file name; empty without one."""
    path = folder / "index.csv"
    if not path.exists():
        return {}
    try:
        return {row["file"]: row for row in csv.DictReader(io.StringIO(read_text(path, LARGEST_INDEX), newline=""))}
    except (OSError, DocumentError, csv.Error, KeyError) as e:
        raise InputError(f"{path}: not a table with the columns file, site, gsd_m; mend it or take it away") from e


def _sampling(row: dict[str, str], usual: float, path: Path) -> float:
    text = row.get("gsd_m") or ""
    try:
        value = float(text) if text else usual
    except ValueError:
        value = 0.0
    if not 0 < value < 100:
        raise InputError(f"{path}: gsd_m in index.csv is {text!r}; give metres a pixel such as 0.05")
    return value


def _tiles(rgb: U8, sampling: float) -> Iterator[U8]:
    """The picture, or tiles spread over it when it is much larger than one."""
    side = max(8, round(TILE / sampling))
    if min(rgb.shape[:2]) < 2 * side:
        yield rgb
        return
    many = int(np.sqrt(MOST_TILES))
    rows, cols = (np.unique(np.linspace(0, n - side, min(many, n // side)).astype(int)) for n in rgb.shape[:2])
    for r in rows:
        for c in cols:
            yield np.ascontiguousarray(rgb[r : r + side, c : c + side])


def read_picture(path: Path) -> U8:
    """A picture as RGB.

    Raises:
        InputError: it cannot be read or is grey.
    """
    try:
        rgb = read_image(path, image_size(path))
    except UNREADABLE as e:
        raise InputError(
            f"{path}: not a readable picture ({' '.join(str(e).split())}); copy it again or take it away"
        ) from e
    if rgb.ndim != 3:
        raise InputError(f"{path}: grey; terrain is learned from colour pictures, take it away")
    return rgb


def _pictures(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in PICTURES and not p.is_dir())


def read_library(folder: Path, usual: float = SAMPLING) -> list[LabelledPatch]:
    """Patches of a folder that has one folder a class.

    A picture's site is that of index.csv, else the folder between it and its class's folder, else one site for all.

    Args:
        folder: `bare/`, `water/`, ... or with their codes, `5_water/`; index.csv (file, site, gsd_m) is optional.
        usual: metres a pixel where index.csv gives none.

    Raises:
        InputError: no folder is named for a class, one has no pictures, or a picture cannot be read.
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
            sampling = _sampling(row, usual, path)
            patches += [LabelledPatch(t, sampling, int(kind), site, name) for t in _tiles(read_picture(path), sampling)]
    if not patches:
        known = ", ".join(k.name.lower() for k in KINDS)
        raise InputError(f"{folder}: no folder in it is named for a class; name them {known}")
    return patches


def is_labelled(folder: Path) -> bool:
    """True if a folder holds pictures with a label a pixel instead of a folder a class."""
    return (folder / "images").is_dir() and (folder / "labels").is_dir()


def read_labelled(folder: Path) -> Iterator[tuple[str, U8, U8]]:
    """Name, picture and (H, W) Terrain codes of every picture in `images/` with a label in `labels/`.

    Raises:
        InputError: there is none, one cannot be read, or the two differ in size.
    """
    labels = {p.stem: p for p in _pictures(folder / "labels")}
    both = [p for p in _pictures(folder / "images") if p.stem in labels]
    if not both:
        raise InputError(f"{folder}: no picture in images/ has one of the same name in labels/")
    for path in both:
        rgb, where = read_picture(path), labels[path.stem]
        try:
            label = read_image(where, image_size(where))
        except UNREADABLE as e:
            raise InputError(f"{where}: not a readable picture; copy it again or take it away") from e
        if label.shape != rgb.shape[:2] or label.max() > max(Terrain):
            raise InputError(f"{where}: needs one grey value a pixel of {path.name}, the code of its class (0 to 8)")
        yield path.stem, rgb, label


def model_bytes(model: Model) -> bytes:
    """The model as a plain NumPy archive."""
    arrays: dict[str, Any] = {"classes": model.classes, "provenance": np.array(model.provenance)}
    for level, head in enumerate(model.heads):
        if head is not None:
            arrays[f"{level}.names"] = np.array(names(level))
            arrays |= {f"{level}.{f.name}": np.asarray(getattr(head, f.name), np.float32) for f in fields(Head)}
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def read_model(path: Path | None = None) -> Model:
    """Read a model from its file; without a name, the model of the package.

    Raises:
        InputError: it is missing, is no model, or was trained for other features.
    """
    return _default_model() if path is None else _model_of(path)


@cache
def _default_model() -> Model:
    return _model_of(DEFAULT_MODEL)


def _model_of(path: Path) -> Model:
    try:
        arrays = arrays_of(read_bytes(path, LARGEST))
        classes = _classes(arrays["classes"])
        heads = tuple(_head(arrays, len(classes), level) for level in range(LEVELS))
        provenance = str(arrays["provenance"])[:LONGEST_PROVENANCE]
    except OSError as e:
        raise InputError(
            f"{path}: cannot be read ({e.strerror or 'no model'}); name a file of 'alight terrain train'"
        ) from e
    except (KeyError, ValueError, TypeError) as e:
        raise InputError(f"{path}: no model of this version ({e}); make one with 'alight terrain train'") from e
    return Model(classes, heads, provenance)


def _classes(codes: NDArray[Any]) -> U8:
    """The classes of a model; a ValueError where they are no codes of land cover."""
    if codes.ndim != 1 or codes.dtype.kind not in "ui" or not 1 < codes.size == np.unique(codes).size:
        raise ValueError("its classes are no list of different codes")
    if codes.min() < 1 or codes.max() > max(Terrain):
        raise ValueError("a class that is none of ours")
    return codes.astype(np.uint8)


def _head(z: Mapping[str, NDArray[Any]], classes: int, level: int) -> Head | None:
    if f"{level}.names" not in z:
        return None
    if tuple(z[f"{level}.names"]) != names(level):
        raise ValueError("other features")
    if any(z[f"{level}.{f.name}"].dtype.kind not in "fiu" for f in fields(Head)):
        raise ValueError("an array of other than numbers")
    values: dict[str, Any] = {f.name: z[f"{level}.{f.name}"].astype(np.float32) for f in fields(Head)}
    numbers: dict[str, Any] = {k: float(v) if v.ndim == 0 else v for k, v in values.items()}
    head = Head(**numbers)
    _check(head, classes, len(names(level)))
    return head


def _check(head: Head, classes: int, features: int) -> None:
    """Raise a ValueError for a head of other shapes, or with numbers that are not finite."""
    wanted = {
        "mean": (features,), "spread": (features,), "weights": (classes, features), "bias": (classes,),
        "centres": (classes, features), "metric": (features, features), "reach": (), "temperature": (),
    }  # fmt: skip
    for name, shape in wanted.items():
        value = np.asarray(getattr(head, name))
        if value.shape != shape or not np.isfinite(value).all():
            raise ValueError(f"{name} is not {shape} finite numbers")
    if not ((head.spread > 0).all() and head.reach > 0 and head.temperature > 0):
        raise ValueError("spread, reach and temperature must be above 0")
