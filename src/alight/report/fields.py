"""Maps as fields of the page: rounded to codes and compressed, so that its script can paint and probe them."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64
from alight.geometry import Grid

Form = Literal["height", "length", "angle", "chance", "count", "text"]  # how the page writes a value


@dataclass(frozen=True, eq=False)
class Field:
    """A map as codes: 0 is unknown, code k stands for `values[k - 1]` or, without values, `low + (k - 1) * step`."""

    title: str
    form: Form
    grid: Grid
    codes: NDArray[Any]  # (R, C) uint8 or uint16
    values: Sequence[float] | Sequence[str] = ()
    low: float = 0.0
    step: float = 1.0

    @property
    def packed(self) -> bytes:
        """The differences along each row, one byte plane after the other, in zlib's format."""
        change = np.diff(self.codes, axis=1, prepend=self.codes.dtype.type(0))
        return zlib.compress(change.view(np.uint8).reshape(-1, change.itemsize).T.tobytes())

    @property
    def coarser(self) -> Field:
        """Every second row and column."""
        codes = self.codes[::2, ::2].copy()
        grid = replace(self.grid, cell=2 * self.grid.cell, rows=codes.shape[0], cols=codes.shape[1])
        return replace(self, grid=grid, codes=codes)

    def as_tree(self, packed: bytes) -> dict[str, Any]:
        """Return the field as in the data of the page."""
        fields = {k: v for k, v in vars(self).items() if k not in ("grid", "codes")}
        data = base64.b64encode(packed).decode()
        return {**fields, **vars(self.grid), "bytes": self.codes.itemsize, "data": data}


def measured(title: str, form: Form, grid: Grid, values: NDArray[Any], levels: F64) -> Field:
    """Return the field of values (R, C), each rounded to the nearest of at most 255 levels; NaN is unknown."""
    codes = np.searchsorted(0.5 * (levels[1:] + levels[:-1]), values) + 1
    return Field(title, form, grid, np.where(np.isfinite(values), codes, 0).astype(np.uint8), levels.tolist())


def lengths() -> F64:
    """Return levels from 1 mm to 100 m, or mrad to more than a right angle, in steps of 4.6 %."""
    return np.geomspace(1e-3, 100.0, 255).round(5)


def chances() -> F64:
    """Return levels of a probability, 0.9 % apart below 90 % and ever finer towards 99.99 %."""
    return np.concatenate([np.linspace(0.0, 0.9, 100, endpoint=False), 1 - np.geomspace(0.1, 1e-4, 155)]).round(5)


def heights(title: str, grid: Grid, values: NDArray[Any]) -> Field:
    """Return the field of heights (R, C), metres, in steps of 1 cm, or longer ones if they span more than 650 m."""
    known = np.isfinite(values)
    low, high = (float(f(values[known])) for f in (np.min, np.max)) if known.any() else (0.0, 0.0)
    step = max(0.01, (high - low) / 65_000)
    codes = np.where(known, np.rint((np.nan_to_num(values) - low) / step) + 1, 0).astype(np.uint16)
    return Field(title, "height", grid, codes, low=round(low, 3), step=step)


def named(title: str, grid: Grid, numbers: NDArray[Any], text_of: Callable[[int], str]) -> tuple[Field, list[int]]:
    """Return the field of the texts of numbers (R, C), uint8 or uint16, and the number of each text."""
    found = np.flatnonzero(np.bincount(numbers.ravel()))
    code_of = np.zeros(int(found[-1]) + 1, np.uint16)
    code_of[found] = np.arange(len(found)) + 1
    codes = code_of[numbers].astype(np.uint8 if len(found) < 256 else np.uint16)
    return Field(title, "text", grid, codes, [text_of(int(n)) for n in found]), found.tolist()


def trees(fields: dict[str, Field], most: int = 4_000_000) -> dict[str, Any]:
    """Return the fields as in the data of the page; the largest are made coarser until all fit `most` bytes."""
    fields = dict(fields)
    packed = {name: f.packed for name, f in fields.items()}
    while sum(map(len, packed.values())) > most:
        largest = max(packed, key=lambda name: len(packed[name]))
        fields[largest] = fields[largest].coarser
        packed[largest] = fields[largest].packed
    return {name: f.as_tree(packed[name]) for name, f in fields.items()}
