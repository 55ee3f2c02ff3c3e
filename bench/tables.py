"""Rows of a table of quantities beside their `must` and `aim` limits, recordings, and numbers kept between runs."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for each other cost eight times the work here

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources import Source

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("ALIGHT_DATA", ROOT.parent / "shared" / "data"))
KEPT = ROOT / "out" / "bench-heights"
# sources on which a kept number depends: after a change it is measured again
SOURCES = (
    "src/alight/geometry", "src/alight/raster.py", "src/alight/parallax", "src/alight/pipeline", "src/alight_sim",
    "src/alight/elevation", "src/alight/settings", "bench",
)  # fmt: skip
WIDTH = 78
Limit = float | tuple[float, float] | None


@dataclass(frozen=True)
class Row:
    """One quantity. Limits are numbers or (low, high); a number is the most allowed."""

    name: str
    value: float
    must: Limit = None
    aim: Limit = None

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
        limits = f"{limit_text(self.must):>10s}{limit_text(self.aim):>10s}"
        return f"{self.name:{WIDTH}s}{limits}{self.value:10.3f}  {self.verdict}"


def at_least(low: float) -> tuple[float, float]:
    """The limit of a quantity that is good when it is large."""
    return low, math.inf


def meets(value: float, limit: Limit) -> bool:
    """Return whether a value is within a limit."""
    if limit is None:
        return True
    return limit[0] <= value <= limit[1] if isinstance(limit, tuple) else value <= limit


def limit_text(limit: Limit) -> str:
    """A limit as it stands in a table."""
    if limit is None:
        return ""
    if isinstance(limit, tuple):
        return f">= {limit[0]:.4g}" if math.isinf(limit[1]) else f"{limit[0]:.4g}-{limit[1]:.4g}"
    return f"<= {limit:.4g}"


def show(*rows: Row, title: str = "") -> None:
    """Print rows, below a heading where there is a title."""
    if title:
        print(f"\n{title:{WIDTH}s}{'must':>10s}{'aim':>10s}{'got':>10s}")
    for row in rows:
        print(row.line(), flush=True)


def recording(folder: Path, settings: Settings) -> Source | None:
    """Open a recording; print a line if it is absent."""
    if not folder.is_dir():
        print(f"{folder}: absent, left out; set ALIGHT_DATA to the folder of recordings")
        return None
    return open_source(folder, settings)


@cache
def source_hash(sources: tuple[str, ...]) -> str:
    """Digest of the source that a number depends on."""
    digest = hashlib.sha256()
    for name in sources:
        for file in [ROOT / name, *sorted((ROOT / name).rglob("*"))]:
            if file.suffix in (".py", ".yaml") and file.is_file():
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def kept(name: str, work: Callable[[], Any], sources: tuple[str, ...] = SOURCES) -> Any:
    """Result of `work`, from the last run if the source is the same; numbers and words only."""
    path = KEPT / source_hash(sources) / (name.replace("/", "-").replace(" ", "_") + ".json")
    if path.exists():
        return json.loads(path.read_text())
    found = json.loads(json.dumps(work()))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found))
    return found
