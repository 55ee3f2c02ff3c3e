"""Pack results of tasks into bytes and restore them bit by bit: arrays, numbers, text and listed records, no code."""

from __future__ import annotations

import io
import pickle
from enum import Enum
from hashlib import blake2b
from typing import Any

import lz4.frame
import numpy as np

from alight.geometry import Camera, Grid, Pose
from alight.parallax.batch import MatchedBlock
from alight.photos.bundle.features import PhotoFeatures
from alight.photos.bundle.matching import Pair
from alight.pipeline.navigation import Trajectory
from alight.records import Heights, KeyframePosterior, Motion, MotionState, PhotoOutcome, Rig, RigCamera

KINDS = (
    Camera, Grid, Heights, KeyframePosterior, MatchedBlock, Motion, MotionState, Pair, PhotoFeatures, PhotoOutcome,
    Pose, Rig, RigCamera, Trajectory,
)  # fmt: skip
_ARRAYS = ("_frombuffer", "_reconstruct", "scalar", "ndarray", "dtype")  # what NumPy restores its arrays with
_DIGEST = blake2b().digest_size  # bytes of the digest before the pickle


class _Pickler(pickle.Pickler):
    """Pickler of arrays, numbers, text, containers and records of `KINDS`; TypeError for all else."""

    def reducer_override(self, value: Any) -> Any:
        if not isinstance(value, (*KINDS, np.ndarray, np.generic, np.dtype, type)) and not callable(value):
            raise TypeError(f"a task gave a {type(value).__name__}, which is not saved")
        # Python 3.11.2 itself would pickle a call of getattr, which is not restored
        return (type(value), (value.value,)) if isinstance(value, Enum) else NotImplemented


class _Unpickler(pickle.Unpickler):
    """Unpickler that makes no other objects than `_Pickler` writes."""

    def find_class(self, module: str, name: str) -> Any:
        listed = any((kind.__module__, kind.__name__) == (module, name) for kind in KINDS)
        if not listed and not (module.split(".")[0] == "numpy" and name in _ARRAYS):
            raise pickle.UnpicklingError(f"{module}.{name} is not saved")
        return super().find_class(module, name)


def pack_result(value: Any, about: str) -> bytes:
    """Pack the result of a task into a digest and a compressed pickle.

    Args:
        value: records of `KINDS`, arrays, numbers and text, in tuples, lists and mappings.
        about: further inputs of the result, as text; they enter the digest only.
    """
    out = io.BytesIO()
    _Pickler(out, pickle.HIGHEST_PROTOCOL).dump(value)
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
        return _Unpickler(io.BytesIO(lz4.frame.decompress(data[_DIGEST:]))).load()
    except Exception as e:  # damaged bytes can make the library raise any exception
        raise ValueError(f"damaged ({e})") from e


def _digest(about: str, body: bytes) -> bytes:
    return blake2b(b"\0".join([about.encode(), body])).digest()
