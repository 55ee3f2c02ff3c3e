"""Pack results of tasks into bytes and restore them bit by bit: arrays, numbers, text and listed records, no code."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from typing import Any
from zipfile import BadZipFile

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
_DIGEST = blake2b().digest_size  # bytes of the digest before the archive


def pack_result(value: Any, about: str) -> bytes:
    """Pack the result of a task into a digest and a compressed NumPy archive.

    Args:
        value: records of `KINDS`, arrays, numbers and text, in tuples, lists and mappings.
        about: further inputs of the result, as text; they enter the digest only.
    """
    arrays, out = list[NDArray[Any]](), io.BytesIO()
    tree = json.dumps({"value": _plain(value, arrays)})
    np.savez(out, *arrays, tree=np.array(tree))
    body: bytes = lz4.frame.compress(out.getvalue())
    return _digest(about, body) + body


def is_whole(data: bytes, about: str) -> bool:
    """Whether packed bytes are undamaged and were packed with an equal `about`."""
    return data[:_DIGEST] == _digest(about, data[_DIGEST:])


def unpack_result(data: bytes) -> Any:
    """Restore a packed value, bit by bit.

    Raises:
        ValueError: the bytes are not a packed result.
    """
    try:
        with np.load(io.BytesIO(lz4.frame.decompress(data[_DIGEST:])), allow_pickle=False) as archive:
            return _whole(parse_json(str(archive["tree"]))["value"], archive)
    except (KeyError, TypeError, IndexError, AttributeError, RuntimeError, OSError, EOFError, BadZipFile) as e:
        raise ValueError(f"damaged ({e})") from e


def _digest(about: str, body: bytes) -> bytes:
    return blake2b(b"\0".join([about.encode(), body])).digest()


def _plain(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return a value as JSON types, containers as lists [type, ...]; its arrays are appended to `arrays`."""
    if isinstance(value, np.ndarray):
        arrays.append(np.asarray(value, order="C"))
        return ["array", f"arr_{len(arrays) - 1}"]
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


def _whole(plain: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
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
