"""Wires: spans found, sites left under them, good ground lost, CPU (docs/method/wires.md).

PYTHONPATH=bench python bench/bench_wires.py                      # tuning flights
PYTHONPATH=bench python bench/bench_wires.py --kind test
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from ground_truth import Bool, GroundTruth
from ladder import Kind
from wire_flights import WireFlight, drawn, kept

from alight.elevation import on_cells_up_to
from alight.geometry import Grid
from alight.hazards.wires import under_wires
from alight.parallax.wires.find import find_wires
from alight.records import Wire
from alight.settings import Lander, Settings
from alight_sim.spans import TrueSpans

UNDER = 1.5  # metres, reach of the lander
FAR = 3.0  # metres from a wire, from which ground is to be kept
ENOUGH = 1.0  # m^2 of good ground under a span that counts
BINS = (0.0, 0.2, 0.4, 0.8, 1.6, 99.0)  # pixels across a wire


@dataclass(frozen=True)
class SpanRow:
    """One span with good ground under it."""

    pixels: float  # its diameter, in pixels of the view that is nearest above
    left: float  # m^2 of good ground under it that are not refused
    good: float  # m^2 of good ground under it
    line: str


@dataclass(frozen=True)
class FlightRow:
    """Numbers of one flight."""

    name: str
    spans: tuple[SpanRow, ...]
    far: float  # m^2 of good ground far from wires
    lost: float  # of which refused
    seconds: float
    wires: tuple[Wire, ...]

    @property
    def line(self) -> str:
        """The numbers in words."""
        share = 100 * self.lost / max(self.far, 1e-9)
        return (
            f"{self.name:32s} {len(self.wires)} wires, good far {self.far:6.0f} m2 lost {share:5.1f} %, "
            f"CPU {self.seconds:.3f} s"
        )


def refused_by(wires: Sequence[Wire], grid: Grid, reach: float) -> Bool:
    """Cells where a wire refuses a touchdown."""
    return under_wires(wires, grid, Lander(radius=reach))


def row_of(f: WireFlight) -> FlightRow:
    """Find the wires of one flight and compare them with the truth."""
    lander = Settings().lander
    e = on_cells_up_to(f.seen.elevation, lander.judging_cell)
    start = time.process_time()
    wires = find_wires(f.seen.views, e)
    seconds = time.process_time() - start
    truth = GroundTruth(f.truth, lander)
    good = truth.on(e.grid, truth.safe) & e.trusted
    refused = refused_by(wires, e.grid, UNDER)
    area, far, spans = e.grid.cell**2, np.ones(e.grid.shape, bool), []
    plane = float(np.nanmedian(e.height))
    for k in range(len(f.spans)):
        one = TrueSpans(f.spans.table[k : k + 1])
        far &= ~one.over(e.grid, FAR)
        under = good & one.over(e.grid, UNDER)
        up = float(one.at(np.zeros(1, np.intp), np.array([0.5]))[0, 2]) - plane
        pixels = float(one.diameter[0]) * f.seen.views[0].camera.fu / max(f.height - up, 0.5)
        left = area * float((under & ~refused).sum())
        if area * under.sum() < ENOUGH or up < 3.5:
            continue
        line = f"d {one.diameter[0]:.3f} up {up:4.1f} px {pixels:.2f} colour {one.colour[0, 0]:.2f} {_angle(f, one)}"
        spans.append(SpanRow(pixels, left, area * float(under.sum()), line))
    far &= good
    return FlightRow(f.name, tuple(spans), area * far.sum(), area * (far & refused).sum(), seconds, wires)


def _angle(f: WireFlight, one: TrueSpans) -> str:
    way, path = (one.end - one.start)[0, :2], (f.seen.views[-1].centre - f.seen.views[0].centre)[:2]
    cosine = abs(way @ path) / max(np.linalg.norm(way) * np.linalg.norm(path), 1e-9)
    return f"{np.degrees(np.arccos(min(cosine, 1.0))):.0f} deg off the path"


def summary(rows: Sequence[FlightRow]) -> list[str]:
    """Requirements over all flights, in words."""
    spans = [s for r in rows for s in r.spans]
    out = []
    for low, high in zip(BINS, BINS[1:], strict=False):
        some = [s for s in spans if low <= s.pixels < high]
        kept, any_ = sum(s.left >= ENOUGH for s in some), sum(s.left > 0 for s in some)
        out.append(f"spans of {low:g} to {high:g} pixels: {len(some)}, with good ground left {any_}, 1 m2 of it {kept}")
    far, lost = sum(r.far for r in rows), sum(r.lost for r in rows)
    out.append(
        f"spans with good ground: {len(spans)}; any of it left "
        f"{100 * np.mean([s.left > 0 for s in spans] or [0]):.1f} %, "
        f"1 m2 {100 * np.mean([s.left >= ENOUGH for s in spans] or [0]):.1f} %; good ground far from wires lost "
        f"{100 * lost / max(far, 1e-9):.2f} % of {far:.0f} m2; CPU {np.median([r.seconds for r in rows]):.3f} s"
    )
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=get_args(Kind), default="tuning")
    parser.add_argument("--count", type=int, default=28)
    parser.add_argument("--scratch", type=Path, default=Path("out/wires"))
    parser.add_argument("--kept", action="store_true", help="all flights that were flown before, and no others")
    options, rows = parser.parse_args(), []
    flights = kept(options.kind, options.scratch) if options.kept else drawn(options.kind, options.count, options.scratch)
    for f in flights:
        if f is None:
            continue
        rows.append(row_of(f))
        print(rows[-1].line, flush=True)
        for s in rows[-1].spans:
            print(f"    {s.line}: {s.good:.1f} m2, left {s.left:.1f}{'  LEFT' if s.left > 0 else ''}")
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
