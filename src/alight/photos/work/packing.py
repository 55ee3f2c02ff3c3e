"""Results of tasks as bytes, and back to the same bits: numbers, text and listed records, but no code."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from typing import Any

import lz4.frame
import numpy as np
from numpy.typing import NDArray

from alight.documents import parse_json
from alight.geometry import Camera, Grid, Pose
from alight.parallax.batch import MatchedBlock
from alight.photos.bundle.features import PhotoFeatures
from alight.photos.bundle.matching import Pair
from alight.pipeline.navigation import Trajectory
from alight.records import Heights, KeyframePosterior, Motion, MotionState, PhotoOutcome, Rig, RigCamera

KINDS: dict[str, type[Any]] = {
    k.__name__: k
    for k in (
        Camera, Grid, Heights, KeyframePosterior, MatchedBlock, Motion, Pair, PhotoFeatures, PhotoOutcome, Pose, Rig,
        RigCamera, Trajectory,
    )
}  # fmt: skip
_HEAD = struct.Struct("<16sI")  # digest of the data and of `about`; length of the tree
DTYPES = frozenset(["<f4", "<f8", "<i8", "<i4", "<u2", "|u1", "|b1"])


def pack_result(value: Any, about: str) -> bytes:
    """Pack the result of a task.

    Args:
        value: records that are listed here, arrays, numbers and text, in tuples, lists and mappings.
        about: further inputs of the result, as text; part of the digest alone.
    """
    arrays = list[NDArray[Any]]()
    plain = _plain(value, arrays)
    tree = json.dumps({"value": plain, "arrays": [(a.dtype.str, a.shape) for a in arrays]}).encode()
    body: bytes = tree + lz4.frame.compress(b"".join(a.tobytes() for a in arrays))
    return _HEAD.pack(_digest(about.encode(), body), len(tree)) + body


def is_whole(data: bytes, about: str) -> bool:
    """True if bytes are undamaged and were packed with the same `about`."""
    return len(data) > _HEAD.size and _HEAD.unpack_from(data)[0] == _digest(about.encode(), data[_HEAD.size :])


def unpack_result(data: bytes) -> Any:
    """Return the value that was packed, equal to the bit.

    Raises:
        ValueError: the bytes are no packed result.
    """
    try:
        size = _HEAD.unpack_from(data)[1]
        body = data[_HEAD.size :]
        head, raw, at, arrays = parse_json(body[:size]), lz4.frame.decompress(body[size:]), 0, list[NDArray[Any]]()
        for dtype, shape in head["arrays"]:
            if dtype not in DTYPES:
                raise ValueError(f"an array of {dtype}")
            count = math.prod(shape)
            arrays.append(np.frombuffer(raw, dtype, count, at).reshape(shape).copy())
            at += arrays[-1].nbytes
        return _whole(head["value"], arrays)
    except (KeyError, TypeError, IndexError, AttributeError, struct.error, RuntimeError) as e:
        raise ValueError(f"damaged ({e})") from e


def _digest(about: bytes, body: bytes) -> bytes:
    return blake2b(blake2b(about).digest() + body, digest_size=16).digest()


def _plain(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Convert to JSON, arrays apart. Numbers and text stay; all else becomes a list that begins with its type."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return ["array", len(arrays) - 1]
    if isinstance(value, MotionState):
        return ["state", int(value)]
    if isinstance(value, tuple | list):
        return ["tuple" if isinstance(value, tuple) else "list", *(_plain(v, arrays) for v in value)]
    if isinstance(value, dict):
        return ["dict", *([str(k), _plain(v, arrays)] for k, v in value.items())]
    if is_dataclass(value) and KINDS.get(type(value).__name__) is type(value):
        return [type(value).__name__, *(_plain(getattr(value, f.name), arrays) for f in fields(value))]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or (isinstance(value, bool | int | float | str) and not isinstance(value, Enum)):
        return value
    raise TypeError(f"a task gave a {type(value).__name__}, which is not saved")


def _whole(plain: Any, arrays: list[NDArray[Any]]) -> Any:
    if not isinstance(plain, list):
        return plain
    what, *parts = plain
    if what == "array":
        return arrays[parts[0]]
    if what == "state":
        return MotionState(parts[0])
    if what in ("tuple", "list"):
        inner = [_whole(p, arrays) for p in parts]
        return tuple(inner) if what == "tuple" else inner
    if what == "dict":
        return {k: _whole(v, arrays) for k, v in parts}
    return KINDS[what](*(_whole(p, arrays) for p in parts))
