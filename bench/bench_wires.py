"""Wires: spans found, sites left under them, good ground lost, CPU (docs/method/wires.md).

PYTHONPATH=bench python bench/bench_wires.py                      # tuning flights
PYTHONPATH=bench python bench/bench_wires.py --kind test
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
from ground_truth import Bool, GroundTruth
from ladder import Kind
from wire_flights import WireFlight, drawn, kept

from alight import hazards
from alight.hazards.wires import no_wire, under_wires
from alight.parallax.wires.find import find_wires
from alight.pipeline.judging import as_judged, find_land_cover
from alight.records import ElevationMap, View, Wire, is_site
from alight.settings import Settings
from alight_sim.spans import TrueSpans

UNDER = 1.5  # metres, reach of the lander
FAR = 3.0  # metres from a wire, from which ground is to be kept
LOWEST_SPAN = 3.5  # metres above ground, of the spans that count
ENOUGH = 1.0  # m^2 of good ground under a span that counts
BINS = (0.0, 0.2, 0.4, 0.8, 1.6, 99.0)  # pixels across a wire


@dataclass(frozen=True, eq=False)
class JudgedFlight:
    """What a flight is asked about: its views, its map as it is judged, and where it is good."""

    name: str
    height: float  # metres, of the flight above ground
    views: tuple[View, ...]
    elevation: ElevationMap
    good: Bool  # (R, C) safe in truth, and mapped
    claimed: Bool  # (R, C) P(safe) is that of a site if no wire is looked for
    spans: TrueSpans

    @classmethod
    def of(cls, f: WireFlight) -> JudgedFlight:
        """Judge a flight without wires."""
        settings = Settings().stages()
        e = as_judged(f.seen, settings.lander)
        cover = find_land_cover(e, settings.terrain, None)
        found = hazards.assess(e, cover, settings.lander, settings.hazards, f.seen.missing)
        truth = GroundTruth(f.truth, settings.lander)
        good = truth.on(e.grid, truth.safe) & e.trusted
        claimed = is_site(found.p_safe, settings.hazards.p_safe)
        return cls(f.name, f.height, f.seen.views, e, good, claimed, f.spans)


@dataclass(frozen=True)
class SpanRow:
    """One span with good ground under it."""

    pixels: float  # its diameter, in pixels of the view that is nearest above
    good: float  # m^2 of good ground under it
    left: float  # m^2 of which are neither refused nor in doubt
    sites: float  # m^2 of which are, beside, sites by their P(safe)
    line: str


@dataclass(frozen=True)
class FlightRow:
    """Numbers of one flight."""

    name: str
    spans: tuple[SpanRow, ...]
    far: float  # m^2 of good ground far from wires
    lost: float  # of which refused or in doubt
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


def row_of(f: JudgedFlight) -> FlightRow:
    """Find the wires of one flight and compare them with the truth."""
    start = time.process_time()
    wires = find_wires(f.views, f.elevation)
    seconds = time.process_time() - start
    grid = f.elevation.grid
    lander = Settings().lander
    refused = under_wires(wires, grid, lander) | (no_wire(wires, grid, lander) < 1)
    area, far, spans = grid.cell**2, np.ones(grid.shape, bool), []
    plane = float(np.nanmedian(f.elevation.height))
    for k in range(len(f.spans)):
        one = TrueSpans(f.spans.table[k : k + 1])
        far &= ~one.over(grid, FAR)
        under = f.good & one.over(grid, UNDER)
        up = float(one.at(np.zeros(1, np.intp), np.array([0.5]))[0, 2]) - plane
        pixels = float(one.diameter[0]) * f.views[0].camera.fu / max(f.height - up, 0.5)
        left = under & ~refused
        if area * under.sum() < ENOUGH or up < LOWEST_SPAN:
            continue
        line = f"d {one.diameter[0]:.3f} up {up:4.1f} px {pixels:.2f} colour {one.colour[0, 0]:.2f} {_angle(f, one)}"
        spans.append(SpanRow(pixels, *(area * float(m.sum()) for m in (under, left, left & f.claimed)), line))
    far &= f.good
    return FlightRow(f.name, tuple(spans), area * far.sum(), area * (far & refused).sum(), seconds, wires)


def _angle(f: JudgedFlight, one: TrueSpans) -> str:
    way, path = (one.end - one.start)[0, :2], (f.views[-1].centre - f.views[0].centre)[:2]
    cosine = abs(way @ path) / max(np.linalg.norm(way) * np.linalg.norm(path), 1e-9)
    return f"{np.degrees(np.arccos(min(cosine, 1.0))):.0f} deg off the path"


def summary(rows: Sequence[FlightRow]) -> list[str]:
    """Requirements over all flights, in words."""
    spans, out = [s for r in rows for s in r.spans], []
    for low, high in pairwise(BINS):
        some = [s for s in spans if low <= s.pixels < high]
        kept, sites = sum(s.left >= ENOUGH for s in some), sum(s.sites > 0 for s in some)
        out.append(f"spans of {low:g} to {high:g} pixels: {len(some)}; 1 m2 of good ground left {kept}, a site {sites}")
    for words, some in (("with wires", [r for r in rows if r.spans]), ("without", [r for r in rows if not r.spans])):
        far, lost = sum(r.far for r in some), sum(r.lost for r in some)
        out.append(
            f"flights {words}: good ground far from wires lost {100 * lost / max(far, 1e-9):.2f} % of {far:.0f} m2"
        )
    out.append(
        f"spans with good ground: {len(spans)}; 1 m2 of it left "
        f"{100 * np.mean([s.left >= ENOUGH for s in spans] or [0]):.1f} %, "
        f"a site {100 * np.mean([s.sites > 0 for s in spans] or [0]):.1f} %; "
        f"CPU {np.median([r.seconds for r in rows]):.3f} s"
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
    flights = (
        kept(options.kind, options.scratch) if options.kept else drawn(options.kind, options.count, options.scratch)
    )
    for f in flights:
        if f is None:
            continue
        rows.append(row_of(JudgedFlight.of(f)))
        print(rows[-1].line, flush=True)
        for s in rows[-1].spans:
            print(f"    {s.line}: {s.good:.1f} m2, left {s.left:.1f}, sites {s.sites:.1f}{'  LEFT' * (s.left > 0)}")
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
