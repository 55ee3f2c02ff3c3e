"""The fitted tables of the package: `.npz` files, each with a card (`.md`) of the same name beside it."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32
from alight.learned.net import AffineLayer, Net
from alight.learned.terms import LAND_COVER_TERMS

LARGEST = 256_000_000  # bytes of the arrays of a table
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, KeyError, IndexError, TypeError, SyntaxError,
    NotImplementedError, OverflowError, RuntimeError, MemoryError,
)  # fmt: skip
TERMS_OF = {"land_cover": LAND_COVER_TERMS}


def table_path(name: str) -> Path:
    """The file of a table of the package."""
    return Path(__file__).parent / f"{name}.npz"


def arrays_of(content: bytes, terms: tuple[str, ...] | None = None, largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of a table, by name; checked against `terms` where they are given.

    Args:
        content: of an archive (.npz) without Python objects, however damaged.
        terms: that the table must have been fitted on.
        largest: bytes that its arrays may need.

    Raises:
        ValueError: it is damaged, holds Python objects, unpacks to more than `largest`, or was fitted on other terms.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > largest:
            raise ValueError(f"the table unpacks to {unpacked / 1e6:.0f} MB")
        with np.load(io.BytesIO(content), allow_pickle=False) as z:
            arrays = {key: z[key] for key in z.files}
    except _DAMAGED as e:
        raise ValueError(f"the table is damaged ({e})") from e
    if terms is not None and "terms" not in arrays:
        raise ValueError("the table does not say what it was fitted on")
    if terms is not None and tuple(map(str, arrays["terms"])) != terms:
        raise ValueError("the table was fitted on other terms than this version computes; fit it anew (training/)")
    return arrays


@cache
def read_net(name: str) -> Net:
    """Read and check a net of the package (`land_cover`), once.

    Raises:
        ValueError: the file does not fit this version: other terms, shapes that do not fit, numbers not finite.
    """
    return net_of(table_path(name).read_bytes(), TERMS_OF[name])


def net_of(content: bytes, terms: tuple[str, ...]) -> Net:
    """Read a net from the bytes of its file; check it against the terms that this version computes.

    Raises:
        ValueError: as `read_net`.
    """
    arrays = arrays_of(content, terms)
    layers = [
        AffineLayer(arrays[f"{k}_weights"].astype(np.float32), arrays[f"{k}_bias"].astype(np.float32))
        for k in ("hidden", "output")
    ]
    calibration = arrays["calibration"].astype(np.float64) if "calibration" in arrays else None
    net = Net(terms, arrays["usual"], arrays["spread"], layers[0], layers[1], calibration)
    _check(net)
    return net


def _check(net: Net) -> None:
    count, units = net.hidden.weights.shape
    inputs = net.output.weights.shape[0]
    if not count == len(net.terms) == net.usual.size == net.spread.size or inputs not in (units, units + count):
        raise ValueError("the shapes of the table's layers do not fit its terms")
    if any(layer.bias.shape != layer.weights.shape[1:] for layer in (net.hidden, net.output)):
        raise ValueError("the shapes of the table's biases do not fit its layers")
    arrays: list[NDArray[np.floating[Any]]] = [net.usual, net.spread, *net.hidden, *net.output]
    arrays += [] if net.calibration is None else [net.calibration]
    if not all(np.isfinite(a).all() for a in arrays) or not (net.spread > 0).all():
        raise ValueError("the table holds numbers that are not finite, or a spread that is not positive")
    if net.calibration is not None and (net.calibration.shape[0] != 2 or not (np.diff(net.calibration[0]) > 0).all()):
        raise ValueError("the table's calibration must be two rows, the first ascending")


def net_bytes(net: Net) -> bytes:
    """Content of the file (.npz) of a net: weights as 16 bit floats, scales of the terms rounded to four digits."""
    arrays: dict[str, Any] = {
        "terms": np.array(net.terms),
        "usual": _rounded(net.usual),
        "spread": _rounded(net.spread),
        **{f"{k}_{f}": np.asarray(getattr(layer, f), np.float16)
           for k, layer in (("hidden", net.hidden), ("output", net.output)) for f in AffineLayer._fields},
    }  # fmt: skip
    if net.calibration is not None:
        arrays["calibration"] = net.calibration
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def _rounded(values: F32) -> F32:
    return np.array([float(f"{v:.4g}") for v in values], np.float32)
