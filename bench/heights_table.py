"""Rows of a table of quantities with their `must` and `aim` limits, and numbers that are kept between runs."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "out" / "bench-heights"
# sources on which a measured number depends: after a change it is measured again
SOURCES = (
    "src/alight/geometry", "src/alight/raster", "src/alight/parallax", "src/alight/pipeline", "src/alight_sim",
    "src/alight/elevation", "src/alight/settings", "bench/scenes", "bench/matchers.py", "bench/subjects.py",
    "bench/heights_points.py", "bench/heights_matchers.py", "bench/heights_ladder.py",
    "bench/heights_unflagged.py", "bench/heights_recordings.py", "bench/bench_heights_poses.py",
    "bench/bench_heights_memory.py", "training/outlier_probability.py",
)  # fmt: skip
WIDTH = 78


@dataclass(frozen=True)
class Row:
    """One quantity. Limits are numbers or (low, high); a number is the most allowed."""

    name: str
    value: float
    must: float | tuple[float, float] | None = None
    aim: float | tuple[float, float] | None = None

    @property
    def verdict(self) -> str:
        """`aim`, `must` or `MISS`; empty without a limit."""
        if self.must is None:
            return ""
        if math.isnan(self.value):
            return "not measured"
        if not meets(self.value, self.must):
            return "MISS"
        return "aim" if self.aim is not None and meets(self.value, self.aim) else "must"

    def line(self) -> str:
        """One line of the table."""
        return f"{self.name:{WIDTH}s}{said(self.must):>10s}{said(self.aim):>10s}{self.value:10.3f}  {self.verdict}"


def meets(value: float, limit: float | tuple[float, float] | None) -> bool:
    """Return whether a value is within a limit."""
    if limit is None:
        return True
    return limit[0] <= value <= limit[1] if isinstance(limit, tuple) else value <= limit


def said(limit: float | tuple[float, float] | None) -> str:
    """A limit in words."""
    if limit is None:
        return ""
    if isinstance(limit, tuple):
        return f">= {limit[0]:.4g}" if math.isinf(limit[1]) else f"{limit[0]:.4g}-{limit[1]:.4g}"
    return f"<= {limit:.4g}"


def head(title: str) -> str:
    """The heading line above rows."""
    return f"\n{title:{WIDTH}s}{'must':>10s}{'aim':>10s}{'got':>10s}"


@cache
def source_hash() -> str:
    """Digest of the source that a number depends on."""
    digest = hashlib.sha256()
    for name in SOURCES:
        path = ROOT / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix in (".py", ".yaml") and file.is_file():
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def kept(name: str, work: Callable[[], Any]) -> Any:
    """Result of `work`, from the last run if the source is the same; numbers and words only."""
    path = KEPT / source_hash() / (name.replace("/", "-").replace(" ", "_") + ".json")
    if path.exists():
        return json.loads(path.read_text())
    found = json.loads(json.dumps(work()))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found))
    return found
