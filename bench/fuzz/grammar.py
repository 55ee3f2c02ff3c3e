"""The grammar of damage: what happens to flight logs, photos, rasters, settings, and how each is drawn from a seed.

A damage is plain data, so that a failure can be kept, shrunk and done again.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio

NUMBERS = (
    "", "nan", "inf", "-inf", "0", "-0.0", "-1", "1", "1e-300", "1e300", "-1e300", "1e200", "1e9", "-1e9", "1e5", "0.5",
    "1e-9", "1e-6", "1e-5", "100", "-2000", "9" * 25,
    "0x10", "one", "\u00e9", "1e400", "[1]", "null", "true", "{a: 1}", "2026-13-45",
)  # fmt: skip
TIMES = ("shift", "scale", "jump", "reverse", "same")
SECONDS = (-3600, -30, -1, 0, 1, 30, 3600, 86400 * 365, -1_600_000_000)
KEYS = (
    "lander.radius", "lander.max_slope", "lander.max_roughness", "lander.feet", "lander.foot_radius", "lander.skids",
    "lander.rotor_radius", "lander.headings", "lander.belly_clearance", "lander.max_step", "parallax.cell",
    "parallax.height_range", "parallax.store_mb", "parallax.method", "elevation.max_sigma", "elevation.most_cells",
    "hazards.p_safe", "hazards.alpha", "hazards.beta", "hazards.usual_sigma", "sites.count", "sites.margin",
    "sites.separation", "sites.distance_weight", "sites.every", "sources.skip", "sources.every", "motion.method",
    "motion.filter.time_offset", "motion.filter.time_offset_sigma", "motion.filter.mounting_sigma",
    "motion.given_position_sigma", "motion.given_attitude_sigma", "route.approach_height", "route.clearance",
    "route.cruise_speed", "route.descent_speed", "terrain.enabled", "terrain.model",
    "tuning.hazards.noise_length", "tuning.terrain.cell", "tuning.hazards.tilt_sigma",
)  # fmt: skip
VALUES = (*NUMBERS, "[-1e9, 1e9]", "[nan, nan]", "[0, 0]", "[[0,0],[1,0],[0,1]]", "100000000", "1e26", "1e-4", "ring")


@dataclass(frozen=True)
class Damage:
    """One thing that happens to an input."""

    kind: str  # name of a function of `DO`
    file: str  # relative to the input; for settings the key
    where: float  # 0 to 1, of the file
    what: str

    def apply(self, folder: Path) -> None:
        """Do it, as far as the file still allows it."""
        path = folder / self.file
        if self.kind in DO and path.is_file():
            DO[self.kind](path, self.where, self.what)


def _rows(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8", errors="replace").splitlines()


def _field(path: Path, where: float, what: str) -> None:
    rows = _rows(path)
    if len(rows) > 1:
        at = 1 + int(where * (len(rows) - 1)) % (len(rows) - 1)
        fields = rows[at].split(",")
        fields[int(where * 7919) % len(fields)] = what
        rows[at] = ",".join(fields)
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def _column(path: Path, where: float, what: str) -> None:
    out = []
    for row in _rows(path):
        fields = row.split(",")
        if not row.startswith("#") and len(fields) > 2:
            fields[1 + int(where * 7919) % (len(fields) - 1)] = what
        out.append(",".join(fields))
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


def _number(path: Path, where: float, what: str) -> None:
    """Another number in a YAML file."""
    text = path.read_text(encoding="utf-8", errors="replace")
    spans, start = [], None
    for k, c in enumerate(text + " "):
        if c in "0123456789.-+e" and (start is not None or c in "0123456789.-"):
            start = k if start is None else start
        elif start is not None:
            spans.append((start, k))
            start = None
    if spans:
        a, b = spans[int(where * len(spans)) % len(spans)]
        path.write_text(text[:a] + what + text[b:], encoding="utf-8")


def _cells(path: Path, where: float, what: str) -> None:
    """A part of a raster holds one value."""
    try:
        with rasterio.open(path, "r+") as d:
            z = d.read(1)
            value = float(what or 0)
            z[: max(1, int(where * len(z)))] = value if abs(value) < 3e38 else np.nan
            d.write(z, 1)
    except Exception:  # whatever the damaged file leads to: it stays as it is
        pass


def _place(path: Path, where: float, what: str) -> None:
    """Another cell size and corner."""
    try:
        with rasterio.open(path, "r+") as d:
            cell = float(what or 0)
            d.transform = rasterio.Affine(cell, 0, cell * where, 0, -cell, 1e6 * where)
    except Exception:  # whatever the damaged file leads to: it stays as it is
        pass


DO: dict[str, Callable[[Path, float, str], None]] = {
    "field": _field, "column": _column, "times": _times, "drop": _drop, "bytes": _bytes, "remove": _remove,
    "number": _number, "cells": _cells, "place": _place,
}  # fmt: skip
_BY_SUFFIX: dict[str, tuple[str, ...]] = {
    ".csv": ("field", "field", "column", "column", "times", "times", "drop", "bytes", "remove"),
    ".yaml": ("number", "number", "number", "number", "bytes", "remove"),
    ".tif": ("cells", "cells", "place", "bytes"),
}


def _what(draw: random.Random, kind: str) -> str:
    if kind == "times":
        return f"{draw.choice(TIMES)} {draw.choice(SECONDS)}"
    if kind == "drop":
        return draw.choice(("tail", "head", "most"))
    if kind == "bytes":
        return draw.choice(("cut", "zeros", "empty", "garble"))
    return draw.choice(NUMBERS)


def drawn(draw: random.Random, folder: Path) -> list[Damage]:
    """One to four damages of an input, settings among them."""
    files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())
    tables = [f for f in files if f.endswith((".csv", ".yaml", ".tif"))] or files
    found = []
    for _ in range(draw.choice((1, 1, 2, 3, 4))):
        if draw.random() < 0.25:
            found.append(Damage("set", draw.choice(KEYS), 0.0, draw.choice(VALUES)))
            continue
        file = draw.choice(tables if draw.random() < 0.85 else files)
        kind = draw.choice(_BY_SUFFIX.get(Path(file).suffix, ("bytes",)))
        found.append(Damage(kind, file, draw.random(), _what(draw, kind)))
    return found
