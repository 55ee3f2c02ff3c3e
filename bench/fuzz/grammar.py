"""The grammar of damage to logs, photos, recordings, rasters, documents and settings, drawn from a seed.

A damage is plain data, so that a failure can be kept, shrunk and repeated.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import yaml
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from PIL import ExifTags, Image

from alight.settings.loading import all_keys, user_keys

NUMBERS = (
    "", "nan", "inf", "-inf", "0", "-0.0", "-1", "1", "1e-300", "1e300", "-1e300", "1e200", "1e9", "-1e9", "1e5", "0.5",
    "1e-9", "1e-6", "1e-5", "100", "-2000", "9" * 25,
    "0x10", "one", "\u00e9", "1e400", "[1]", "null", "true", "{a: 1}", "2026-13-45",
)  # fmt: skip
TIMES = ("shift", "scale", "jump", "reverse", "same")
SECONDS = (-3600, -30, -1, 0, 1, 30, 3600, 86400 * 365, -1_600_000_000)
KEYS = (*user_keys(), "tuning.hazards.noise_length", "tuning.terrain.cell", "tuning.hazards.tilt_sigma")
TUNING = tuple(k for k in all_keys() if k.startswith("tuning."))
SCENE = (
    "ground.size", "ground.cell", "ground.slope_deg", "ground.relief.1.height", "ground.relief.1.shortest",
    "ground.layers.1.radius", "ground.layers.6.per_hectare", "ground.layers.9.exponent", "light.haze", "light.clouds",
    "flight.height", "flight.duration", "flight.speed", "flight.gusts", "rig", "imaging", "sensors.imu.rate",
    "sensors.gps.rate", "lander.radius", "faults", "traffic", "origin.latitude", "origin.height", "rig.rate_hz",
    "rig.cameras.1.resolution", "rig.cameras.1.field_deg", "rig.cameras.1.tilt_deg", "flight.kind",
)  # fmt: skip
VALUES = (*NUMBERS, "[-1e9, 1e9]", "[nan, nan]", "[0, 0]", "[[0,0],[1,0],[0,1]]", "100000000", "1e26", "1e-4", "fine")


@dataclass(frozen=True)
class Damage:
    """One damage of an input."""

    kind: str  # name of a function of `DO`
    file: str  # relative to the input; for settings the key
    where: float  # position in the file, 0 to 1
    what: str

    def apply(self, folder: Path) -> None:
        """Apply the damage, if the file still allows it."""
        path = folder / self.file
        if self.kind in DO and path.is_file():
            DO[self.kind](path, self.where, self.what)


def _rows(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8", errors="replace").splitlines()


def _mark(text: str) -> str:
    """Return the separator of the fields of a table."""
    return "," if "," in text else " "


def _field(path: Path, where: float, what: str) -> None:
    rows = _rows(path)
    if len(rows) > 1:
        at = 1 + int(where * (len(rows) - 1)) % (len(rows) - 1)
        mark = _mark(rows[at])
        fields = rows[at].split(mark)
        fields[int(where * 7919) % len(fields)] = what
        rows[at] = mark.join(fields)
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def _column(path: Path, where: float, what: str) -> None:
    out = []
    for row in _rows(path):
        mark = _mark(row)
        fields = row.split(mark)
        if not row.startswith("#") and len(fields) > 2:
            fields[1 + int(where * 7919) % (len(fields) - 1)] = what
        out.append(mark.join(fields))
    path.write_text("\n".join(out) + "\n", encoding="utf-8")


def _times(path: Path, where: float, what: str) -> None:
    how, _, seconds = what.partition(" ")
    rows = [r.split(",", 1) for r in _rows(path)]
    stamped = [r for r in rows if len(r) == 2 and r[0].strip().isdigit()]
    if not stamped:
        return
    first, by = int(stamped[0][0]), int(seconds or 0) * 10**9
    late = int(where * len(stamped))
    for k, row in enumerate(stamped):
        t = int(row[0])
        new = {"shift": t + by, "scale": first + 10 * (t - first), "jump": t + by * (k >= late), "same": first}
        row[0] = str(max(new.get(how, t), 0))
    if how == "reverse":
        for row, t in zip(stamped, [r[0] for r in reversed(stamped)], strict=True):
            row[0] = t
    path.write_text("\n".join(",".join(r) for r in rows) + "\n", encoding="utf-8")


def _drop(path: Path, where: float, what: str) -> None:
    rows = _rows(path)
    keep = max(1, int(where * len(rows)))
    kept = {"tail": rows[:keep], "head": rows[:1] + rows[keep:], "most": rows[:2]}[what]
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")


def _bytes(path: Path, where: float, what: str) -> None:
    data = bytearray(path.read_bytes())
    at = int(where * len(data))
    if what == "cut":
        del data[at:]
    elif what == "zeros":
        data[at:] = bytes(len(data) - at)
    elif what == "empty":
        data.clear()
    elif data:
        rng = np.random.default_rng(at)
        for k in rng.integers(0, len(data), 20):
            data[k] = int(rng.integers(256))
    path.write_bytes(bytes(data))


def _remove(path: Path, where: float, what: str) -> None:
    path.unlink()


_NUMBER = re.compile(r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?")


def _renumbered(text: str, where: float, what: str) -> str:
    """Replace one number of a text."""
    spans = [m.span() for m in _NUMBER.finditer(text)]
    if not spans:
        return text
    a, b = spans[int(where * len(spans)) % len(spans)]
    return text[:a] + what + text[b:]


def _number(path: Path, where: float, what: str) -> None:
    """Replace one number in a YAML or JSON file."""
    text = path.read_text(encoding="utf-8", errors="replace")
    path.write_text(_renumbered(text, where, what), encoding="utf-8")


def _paths(tree: Any, before: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values of a document."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [p for k, v in items for p in ((*before, k), *_paths(v, (*before, k)))]


def _tree(path: Path, where: float, what: str) -> None:
    """Replace or delete one value of a JSON or YAML document; in a file of lines, of one line."""
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = text.split("\n") if path.suffix == ".jsonl" else [text]
    at = int(where * 7919) % max(1, len([x for x in lines if x]))
    with suppress(ValueError, yaml.YAMLError, KeyError, IndexError, TypeError):
        tree = json.loads(lines[at]) if path.suffix != ".yaml" else yaml.safe_load(lines[at].removeprefix("%YAML:1.0"))
        places = _paths(tree)
        *way, last = places[int(where * len(places))]
        inner = tree
        for part in way:
            inner = inner[part]
        if what == "gone":
            del inner[last]
        else:
            inner[last] = yaml.safe_load(what)
        lines[at] = json.dumps(tree, default=str)
        path.write_text("\n".join(lines), encoding="utf-8")


def _damaged(data: bytes, where: float, what: str) -> bytes:
    """Replace a number in a JSON text, also of a ROS message, or garble the bytes of another message of ROS."""
    if what == "garble" or not data:
        return bytes(b ^ (37 * (k % 11 == int(11 * where))) for k, b in enumerate(data))
    if data[:1] == b"{":
        return _renumbered(data.decode("utf-8", errors="replace"), where, what).encode()
    if data[8:9] == b"{":  # after the byte order and the length
        changed = _renumbered(data[8:-1].decode("utf-8", errors="replace"), where, what).encode()
        return data[:4] + struct.pack("<I", len(changed) + 1) + changed + b"\0"
    if where < 0.3:
        return data[:1] + bytes([data[1] ^ 1]) + data[2:]  # the other byte order
    at = 4 + int(where * len(data[:60]) / 4) * 4  # the stamp, or the length of a text or of an array
    return data[:at] + struct.pack("<I", int(where * 2**32)) + data[at + 4 :]


def _message(path: Path, where: float, what: str) -> None:
    """Damage one message of a recording, or its head."""
    with suppress(Exception):  # an error of the damaged file: it stays as it is
        records = list(StreamReader(path.open("rb")).records)
        about = [k for k, r in enumerate(records) if isinstance(r, Message | Metadata)]
        at = about[int(where * len(about))] if where > 0.2 else about[0]
        out = io.BytesIO()
        writer = Writer(out, use_chunking=False)
        writer.start("alight", "fuzz")
        for k, r in enumerate(records):
            hit = k == at
            if isinstance(r, Schema):
                writer.register_schema(r.name, r.encoding, r.data)
            elif isinstance(r, Channel):
                writer.register_channel(r.topic, r.message_encoding, r.schema_id)
            elif isinstance(r, Metadata):
                values = dict(r.metadata)
                if hit and "head" in values:
                    values["head"] = _damaged(values["head"].encode(), 5 * where, what).decode("utf-8", "replace")
                writer.add_metadata(r.name, values)
            elif isinstance(r, Message) and not (hit and what == "gone"):
                data = _damaged(r.data, 7919 * where % 1, what) if hit else r.data
                writer.add_message(r.channel_id, r.log_time, data, r.publish_time, r.sequence)
        writer.finish()
        path.write_bytes(out.getvalue())


_TAGS = (
    *((None, t) for t in (0x010F, 0x0110, 0x0112, 0x0132)),
    *((ExifTags.IFD.Exif, t) for t in (0x829A, 0x9003, 0x9291, 0x920A, 0xA002, 0xA003, 0xA20E, 0xA210, 0xA405, 0xA432)),
    *((ExifTags.IFD.GPSInfo, t) for t in (1, 2, 3, 4, 5, 6, 7, 29)),
)  # fmt: skip


def _exif(path: Path, where: float, what: str) -> None:
    """Give an EXIF tag another value of another type, or change bytes of EXIF."""
    if what == "garble":
        data = bytearray(path.read_bytes())
        if data:  # another damage may have emptied it
            start = data.find(b"Exif\0\0") + 6
            data[(start + int(where * 300)) % len(data)] = int(where * 7919) % 256
        path.write_bytes(bytes(data))
        return
    with suppress(Exception):  # pillow refuses to write some values
        image = Image.open(path)
        exif, xmp = image.getexif(), image.info.get("xmp", b"")
        directory, tag = _TAGS[int(where * len(_TAGS))]
        value: Any = (what, what.encode(), (what,) * 3, b"\xff\xfe" * 40)[int(where * 7919) % 4]
        with suppress(ValueError):
            value = (float(what), (float(what),) * 3, int(float(what)), value)[int(where * 104729) % 4]
        (exif if directory is None else exif.get_ifd(directory))[tag] = value
        image.save(path, "JPEG", exif=exif, xmp=xmp)


def _array(path: Path, where: float, what: str) -> None:
    """Give one array of a table another shape or type, or replace a number in it."""
    with suppress(Exception):  # an error of the damaged file: it stays as it is
        with np.load(path) as file:
            arrays = dict(file)
        name = sorted(arrays)[int(where * len(arrays))]
        old = arrays[name]
        number = float(what) if what.replace(".", "").lstrip("-").isdigit() else np.nan
        arrays[name] = (
            old[..., :-1] if old.ndim else old, old.astype(np.float16), np.full_like(old, number), old.T[None],
            np.zeros(0), np.array([what]), np.where(np.arange(old.size).reshape(old.shape) == 0, number, old),
        )[int(where * 7919) % 7]  # fmt: skip
        np.savez(path, **arrays)


def _cells(path: Path, where: float, what: str) -> None:
    """Set a part of a raster to one value."""
    try:
        with rasterio.open(path, "r+") as d:
            z = d.read(1)
            value = float(what or 0)
            z[: max(1, int(where * len(z)))] = value if abs(value) < 3e38 else np.nan
            d.write(z, 1)
    except Exception:  # an error of the damaged file: it stays as it is
        pass


def _place(path: Path, where: float, what: str) -> None:
    """Change cell size and corner of a raster."""
    try:
        with rasterio.open(path, "r+") as d:
            cell = float(what or 0)
            d.transform = rasterio.Affine(cell, 0, cell * where, 0, -cell, 1e6 * where)
    except Exception:  # an error of the damaged file: it stays as it is
        pass


def _bands(path: Path, where: float, what: str) -> None:
    """Change the number of bands, the type or the rows of a raster."""
    with suppress(Exception):  # an error of the damaged file: it stays as it is
        with rasterio.open(path) as d:
            bands, profile = d.read(), d.profile
        how = int(where * 5)
        bands = (bands[:1], np.concatenate([bands, bands]), bands.astype(np.int16), bands[:, ::2], bands[:, :1])[how]
        profile |= {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
        profile |= {"nodata": None, "driver": "GTiff", "tiled": False}
        with rasterio.open(path, "w", **profile) as d:
            d.write(bands)


DO: dict[str, Callable[[Path, float, str], None]] = {
    "field": _field, "column": _column, "times": _times, "drop": _drop, "bytes": _bytes, "remove": _remove,
    "number": _number, "tree": _tree, "cells": _cells, "place": _place, "bands": _bands, "message": _message,
    "exif": _exif, "array": _array,
}  # fmt: skip
_BY_SUFFIX: dict[str, tuple[str, ...]] = {
    ".csv": ("field", "field", "column", "column", "times", "times", "drop", "bytes", "remove"),
    ".tum": ("field", "column", "drop", "bytes", "remove"),
    ".yaml": ("number", "number", "number", "tree", "tree", "bytes", "remove"),
    ".json": ("number", "tree", "tree", "tree", "bytes", "remove"),
    ".jsonl": ("number", "tree", "tree", "tree", "drop", "bytes"),
    ".tif": ("cells", "cells", "place", "bands", "bytes"),
    ".mcap": ("message", "message", "message", "bytes"),
    ".JPG": ("exif", "exif", "bytes"),
    ".npz": ("array", "array", "bytes"),
}


def _what(draw: random.Random, kind: str) -> str:
    if kind == "times":
        return f"{draw.choice(TIMES)} {draw.choice(SECONDS)}"
    if kind == "drop":
        return draw.choice(("tail", "head", "most"))
    if kind == "bytes":
        return draw.choice(("cut", "zeros", "empty", "garble"))
    if kind in ("message", "exif", "tree") and draw.random() < 0.2:
        return "gone" if kind != "exif" else "garble"
    if kind == "message" and draw.random() < 0.2:
        return "garble"
    return draw.choice(NUMBERS)


def drawn(draw: random.Random, folder: Path, keys: str, only: str) -> list[Damage]:
    """Draw one to four damages of an input; also of `settings` or of a `scene`, if the command takes them."""
    files = sorted(p.relative_to(folder).as_posix() for p in (folder / only).rglob("*") if p.is_file())
    read = [f for f in files if Path(f).suffix in _BY_SUFFIX] or files
    found = []
    for _ in range(draw.choice((1, 1, 2, 3, 4))):
        if keys and draw.random() < 0.25:
            known = {"settings": TUNING if draw.random() < 0.2 else KEYS, "scene": SCENE}[keys]
            found.append(Damage("set", draw.choice(known), 0.0, draw.choice(VALUES)))
            continue
        file = draw.choice(read if draw.random() < 0.85 else files)
        kind = draw.choice(_BY_SUFFIX.get(Path(file).suffix, ("bytes",)))
        found.append(Damage(kind, file, draw.random(), _what(draw, kind)))
    return found
