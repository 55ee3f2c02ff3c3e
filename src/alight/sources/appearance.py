"""Read and write models of the appearance of land cover."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import U8
from alight.documents import read_bytes
from alight.learned import arrays_of, table_path
from alight.records import InputError, Terrain
from alight.terrain.model import LEVELS, Head, Model, names

DEFAULT_MODEL = table_path("appearance")


def model_bytes(model: Model) -> bytes:
    """Pack a model into a compressed NumPy archive."""
    arrays: dict[str, Any] = {"classes": model.classes, "provenance": np.array(model.provenance)}
    for level, head in enumerate(model.heads):
        if head is not None:
            arrays[f"{level}.names"] = np.array(names(level))
            arrays |= {f"{level}.{f.name}": np.asarray(getattr(head, f.name), np.float32) for f in fields(Head)}
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def read_model(path: Path | None = None) -> Model:
    """Read a model from its file; without a path, read the model in the package.

    Raises:
        InputError: the file is missing, is not a model, or was trained for other features.
    """
    return _default_model() if path is None else _model_of(path)


@cache
def _default_model() -> Model:
    return _model_of(DEFAULT_MODEL)


def _model_of(path: Path) -> Model:
    try:
        arrays = arrays_of(read_bytes(path, 64_000_000))
        classes = _classes(arrays["classes"])
        heads = tuple(_head(arrays, len(classes), level) for level in range(LEVELS))
        provenance = str(arrays["provenance"])[:20_000]
    except OSError as e:
        raise InputError(
            f"{path}: cannot be read ({e.strerror or 'no model'}); name a file of 'alight terrain train'"
        ) from e
    except (KeyError, ValueError, TypeError) as e:
        raise InputError(f"{path}: no model of this version ({e}); make one with 'alight terrain train'") from e
    return Model(classes, heads, provenance)


def _classes(codes: NDArray[Any]) -> U8:
    """Return the land-cover codes of a model as bytes; raise ValueError if `codes` are not different valid codes."""
    if codes.ndim != 1 or codes.dtype.kind not in "ui" or not 1 < codes.size == np.unique(codes).size:
        raise ValueError("its classes are no list of different codes")
    if codes.min() < 1 or codes.max() > max(Terrain):
        raise ValueError("a class that is none of ours")
    return codes.astype(np.uint8)


def _head(z: Mapping[str, NDArray[Any]], classes: int, level: int) -> Head | None:
    """Return the head of a level from the named arrays `z` of a model with `classes` classes; None if it is absent.

    Raises:
        ValueError: an array is not valid.
    """
    if f"{level}.names" not in z:
        return None
    if tuple(z[f"{level}.names"]) != names(level):
        raise ValueError("other features")
    n, values = len(names(level)), dict[str, Any]()
    shapes = {
        "mean": (n,), "spread": (n,), "weights": (classes, n), "bias": (classes,), "centres": (classes, n),
        "metric": (n, n), "reach": (), "temperature": (),
    }  # fmt: skip
    for name, shape in shapes.items():
        value = z[f"{level}.{name}"]
        if value.dtype.kind not in "fiu":
            raise ValueError("an array of other than numbers")
        value = value.astype(np.float32)
        if value.shape != shape or not np.isfinite(value).all():
            raise ValueError(f"{name} is not {shape} finite numbers")
        values[name] = value if shape else float(value)
    head = Head(**values)
    if not ((head.spread > 0).all() and head.reach > 0 and head.temperature > 0):
        raise ValueError("spread, reach and temperature must be above 0")
    return head
