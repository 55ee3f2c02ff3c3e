"""evidence.npz: a run's result without its answer, from which another lander is judged (`alight judge`)."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import BaseModel

from alight.arrays import U8
from alight.documents import parse_json
from alight.outputs.vectors import plain
from alight.records import RunResult, Sites
from alight.records.executive import FlightDiary
from alight.settings import settings_of_run

EVIDENCE = "evidence.npz"
_DAMAGED = (
    OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, RecursionError, EOFError,
    MemoryError, zipfile.BadZipFile, NotImplementedError, shapely.GEOSException,
)  # fmt: skip


@dataclass(frozen=True)
class _Members:
    """Rasters of a record, by the name of their member in the file."""

    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)

    def tree_of(self, value: Any) -> Any:
        """Return a record, or a value of one, as a JSON tree; its rasters are added to the members."""
        if isinstance(value, BaseModel):
            return value.model_dump(mode="json")
        if is_dataclass(value) and not isinstance(value, type):
            return {f.name: self.tree_of(getattr(value, f.name)) for f in fields(value) if f.init}
        if isinstance(value, shapely.Geometry):
            return shapely.to_wkb(value, hex=True)
        if isinstance(value, np.ndarray):
            shown = {"dtype": value.dtype.str, "shape": value.shape}
            if value.dtype == np.float64:  # poses and covariances
                return {**shown, "values": value.ravel().tolist()}
            name = f"a{len(self.arrays)}"
            self.arrays[name] = packed(value)
            return {**shown, "member": name}
        if isinstance(value, Mapping):
            return {str(k): self.tree_of(v) for k, v in value.items()}
        if isinstance(value, Sequence) and not isinstance(value, str):
            return [self.tree_of(v) for v in value]
        return value.value if isinstance(value, Enum) else value.item() if isinstance(value, np.generic) else value

    def _array(self, tree: Any) -> NDArray[Any]:
        dtype, shape = np.dtype(str(tree["dtype"])), tuple(int(n) for n in tree["shape"])
        if dtype.kind not in "fiub":
            raise ValueError(f"numbers of type {dtype}")
        if "values" in tree:
            return np.array(tree["values"], dtype).reshape(shape)
        return unpacked(self.arrays[tree["member"]], dtype, shape)

    def value_of(self, kind: Any, tree: Any) -> Any:
        """Return the value of declared type `kind` from its JSON tree: the inverse of `tree_of`."""
        origin, inner = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType):
            kinds = [k for k in inner if k is not NoneType]
            return None if tree is None else self.value_of(kinds[0], tree)
        if origin is np.ndarray:
            return self._array(tree)
        if kind is shapely.Geometry:
            return shapely.from_wkb(tree)
        if origin is Literal or kind is object:
            return tree
        if origin is tuple:
            each = [inner[0]] * len(tree) if inner[-1] is Ellipsis else inner
            return tuple(self.value_of(k, v) for k, v in zip(each, tree, strict=True))
        if origin is not None and issubclass(origin, Mapping):
            return {k: self.value_of(inner[1], v) for k, v in tree.items()}
        if origin is not None:
            return [self.value_of(inner[0], v) for v in tree]
        if is_dataclass(kind):
            hints = _hints(kind)  # type: ignore[arg-type]
            return kind(**{name: self.value_of(hints[name], v) for name, v in tree.items()})  # type: ignore[operator]
        return settings_of_run(tree) if issubclass(kind, BaseModel) else kind(tree)


def packed(array: NDArray[Any]) -> U8:
    """Return the bytes of an array, (itemsize, N), in an order that compresses to three quarters of the room.

    They are of differences along the second axis, and bytes of equal weight lie beside each other.
    """
    bits = np.ascontiguousarray(array).view(f"u{array.itemsize}")
    steps = np.diff(bits, axis=min(1, bits.ndim - 1), prepend=bits.dtype.type(0))
    return np.ascontiguousarray(steps.reshape(-1, 1).view(np.uint8).T)


def unpacked(planes: U8, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the array of a type and shape whose bytes are given: the inverse of `packed`."""
    steps = np.ascontiguousarray(planes.T).view(f"u{dtype.itemsize}").reshape(shape)
    return np.cumsum(steps, axis=min(1, steps.ndim - 1), dtype=steps.dtype).view(dtype)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, localns={"FlightDiary": FlightDiary})


def encode_evidence(result: RunResult) -> bytes:
    """Return a result without its answer as a NumPy archive: its arrays, and `head`, the rest as JSON."""
    kept = replace(
        result, sites=Sites(()), others=(), elevation=None, terrain=None, hazards=None, route=None, timings={},
        not_written={}, notes=plain(result.notes),
    )  # fmt: skip
    members = _Members()
    head = json.dumps(members.tree_of(kept)).encode()
    members.arrays["head"] = np.frombuffer(head, np.uint8)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, array in members.arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    return out.getvalue()


def decode_evidence(data: bytes) -> RunResult:
    """Return the result that `encode_evidence` was given, without its answer.

    Raises:
        ValueError: the bytes are damaged, or of another version.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        result: RunResult = _Members(arrays).value_of(RunResult, parse_json(arrays.pop("head").tobytes()))
    except _DAMAGED as e:
        raise ValueError(str(e)) from e
    return result
