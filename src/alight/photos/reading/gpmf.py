"""GPS of GoPro cameras, from a film's telemetry track in GPMF format (github.com/gopro/gpmf-parser)."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from alight.arrays import F64, Mask
from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow
from alight.records import FIX_3D

WORST_DOP = 10.0  # dilution of precision; above it, positions are off by tens of metres
_NUMBERS = {"b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8", "j": ">i8",
            "J": ">u8"}  # fmt: skip


def read_gpmf(payloads: Sequence[tuple[float, bytes]], source: str) -> FilmTelemetry:
    """Read the GPS5 or GPS9 samples from the (seconds, payload) pairs of a track, in order of time.

    The last payload is assumed to last 1 s. Samples without a 3D fix or with a large dilution of precision are omitted.
    """
    ends = [*(t for t, _ in payloads[1:]), payloads[-1][0] + 1.0] if payloads else []
    rows, poor = list[TelemetryRow](), 0
    for (begin, payload), end in zip(payloads, ends, strict=True):
        for samples, good in _samples(payload):
            poor += int((~good).sum())
            rows += [
                TelemetryRow(begin + k / len(samples) * (end - begin),
                             dict(zip(("latitude", "longitude", "abs_alt"), map(float, row[:3]), strict=True)))
                for k, row in enumerate(samples) if good[k]
            ]  # fmt: skip
    return FilmTelemetry.of(rows, source, f"{poor} of {poor + len(rows)} places left out: a poor fix" if poor else "")


def _samples(payload: bytes) -> Iterator[tuple[F64, Mask]]:
    """Yield the (N, 5 or 9) samples of each GPS stream, and an (N,) mask of samples with a good fix."""
    for key, _, device in _elements(payload):
        for name, _, stream in _elements(device) if key == "DEVC" else ():
            tags = {k: (kind, data) for k, kind, data in _elements(stream)} if name == "STRM" else {}
            gps = next((k for k in ("GPS9", "GPS5") if k in tags), None)
            if gps is None:
                continue
            kind, data = tags[gps]
            count = int(gps[-1])
            kinds = tags["TYPE"][1].decode("latin1") if kind == "?" and "TYPE" in tags else kind * count
            if len(kinds) != count or not set(kinds) <= set(_NUMBERS):
                continue
            row = np.dtype([(str(k), _NUMBERS[c]) for k, c in enumerate(kinds)])
            table = np.frombuffer(data[: len(data) // row.itemsize * row.itemsize], row)
            values = np.stack([table[n].astype(np.float64) for n in row.names or ()], axis=-1)
            values = values / np.where((scale := _numbers(tags, "SCAL", count)) == 0, 1.0, scale)
            if gps == "GPS9":
                fix, dop = values[:, 8], values[:, 7]
            else:
                fix, dop = (np.resize(_numbers(tags, n, 1), len(values)) for n in ("GPSF", "GPSP"))
                dop = dop / 100.0
            yield values, np.asarray((fix >= FIX_3D) & (dop <= WORST_DOP))


def _numbers(tags: dict[str, tuple[str, bytes]], key: str, count: int) -> F64:
    """Return the `count` numbers of the element `key`, repeated if there are fewer; zeros if it is not among `tags`."""
    kind, data = tags.get(key, ("b", b"\0"))
    row = np.dtype(_NUMBERS.get(kind, "u1"))
    whole = data[: len(data) // row.itemsize * row.itemsize]
    return np.resize(np.frombuffer(whole, row).astype(np.float64), count)


def _elements(data: bytes) -> Iterator[tuple[str, str, bytes]]:
    r"""Yield (key, type, content) of each element; content of type `\0` is a sequence of elements."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, repeat = struct.unpack_from(">4scBH", data, at)
        if not key.strip(b"\0"):
            return
        yield key.decode("latin1"), kind.decode("latin1"), data[at + 8 : at + 8 + size * repeat]
        at += 8 + (size * repeat + 3) // 4 * 4
