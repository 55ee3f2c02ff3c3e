"""Wrong heights that the heights stage does not flag where none can be measured: no texture, moving light, water.

True poses. The heights stage alone is judged; beside it is the result after the terrain stage, which recognises water
by its appearance. The scenes lie in `bench/scenes`, one for each danger; on the ladder's lakes, the same is measured
on the water there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from heights_points import METHODS, OPEN, mapped
from ladder import exposures, rung
from tables import Row, kept

import alight_sim as simulate
from alight.arrays import Mask
from alight.pipeline import without_water
from alight.pipeline.judging import find_land_cover
from alight.records import ElevationMap, Flag, Terrain
from alight.settings import TerrainSettings
from alight_sim import SceneTruth

SCENES = Path(__file__).parent / "scenes"
WRONG, DEEP = 0.25, 0.5  # metres: a height that must be flagged; the same on water whose bed shows
# scenes: whether they are judged on their water (or on open ground), and from where on a height is wrong
ASKED = {
    "low_texture": (False, WRONG), "moving_shadow": (False, WRONG), "new_water": (True, WRONG),
    "clear_water": (True, DEEP),
}  # fmt: skip
LAKES = "lakes/20m/test-1", "lakes/50m/test-1"
OF_GIVEN, OF_KIND, WITH_TERRAIN = "of all given out", "of its own cells", "of all given out after the terrain stage"
Numbers = dict[str, float]


def through(found: ElevationMap, truth: SceneTruth, limit: float, water: bool) -> Numbers:
    """Percent of cells with an error above `limit` that are not flagged; on water alone, or on open ground."""
    height, label = (truth.grid.nearest_on(found.grid, a) for a in (truth.height.astype(np.float32), truth.label))
    seen = np.isfinite(height) & ((found.flags & np.uint16(Flag.UNSEEN)) == 0)
    kind = label == Terrain.WATER if water else np.isin(label, OPEN)
    given = seen & found.trusted
    off = kind & (np.abs(found.height - height) > limit)
    wrong, dry = given & off, seen & without_water(found, find_land_cover(found, TerrainSettings(), None)).trusted
    return {
        OF_GIVEN: _share(wrong, given),
        OF_KIND: _share(wrong, seen & kind),
        WITH_TERRAIN: _share(dry & off, dry),
    }


def _share(part: Mask, whole: Mask) -> float:
    return 100 * float(part.sum()) / max(float(whole.sum()), 1.0)


def _judged(make: Callable[[], simulate.SimulatedFlight], water: bool, limit: float) -> dict[str, Numbers]:
    """Numbers of one flight by both methods."""
    flight = make()
    shots = list(exposures(flight))
    out = {}
    for method in METHODS:
        found = mapped(shots, method, 16)
        assert found is not None
        out[method] = through(found, flight.truth, limit, water)
    return out


def rows(seeds: str) -> list[Row]:
    """Rows of every scene and of the lakes, the mean over the seeds."""
    flights: dict[str, list[dict[str, Numbers]]] = {}
    for which, asked in ASKED.items():
        make = {s: partial(simulate.fly, SCENES / f"{which}.yaml", int(s)) for s in seeds.split(",")}
        flights[which] = [kept(f"{which} {s}", partial(_judged, m, *asked)) for s, m in make.items()]
    flights["lakes"] = [kept(f"{n} water", partial(_judged, rung(n).fly, True, DEEP)) for n in LAKES]
    out = []
    for which, found in flights.items():
        limit = ASKED[which][1] if which in ASKED else DEEP
        judged = OF_GIVEN if limit == DEEP else OF_KIND
        for m in METHODS:
            mean = {k: float(np.mean([f[m][k] for f in found])) for k in found[0][m]}
            asked = (1.0, 0.1)  # water whose bed shows is flagged by the terrain stage: the output of a run is judged
            at_once, after = ((), asked) if limit == DEEP else (asked, ())
            out.append(Row(f"off > {limit} m and not flagged, % {judged}: {which}, {m}", mean[judged], *at_once))
            out.append(Row(f"... % {WITH_TERRAIN}", mean[WITH_TERRAIN], *after))
    return out
