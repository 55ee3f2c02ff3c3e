"""The files of the fitted tables: `.npz`, or `.yaml` for a few numbers, each with a card (`.md`) of the same name."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DAMAGED = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, KeyError, IndexError, TypeError, SyntaxError,
    NotImplementedError, OverflowError, RuntimeError, MemoryError,
)  # fmt: skip


def table_path(name: str) -> Path:
    """The file of a table of the package."""
    return Path(__file__).parent / f"{name}.npz"


def arrays_of(content: bytes, largest: int = 256_000_000) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of a table, by name.

    Args:
        content: of an archive (.npz) without Python objects, however damaged.
        largest: bytes that its arrays may need.

    Raises:
        ValueError: it is damaged, holds Python objects, or unpacks to more than `largest`.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > largest:
            raise ValueError(f"the table unpacks to {unpacked / 1e6:.0f} MB")
        with np.load(io.BytesIO(content), allow_pickle=False) as z:
            return {key: z[key] for key in z.files}
    except _DAMAGED as e:
        raise ValueError(f"the table is damaged ({e})") from e
