"""Wrong heights that the heights stage does not flag where none can be measured: no texture, moving light, water.

True poses. The heights stage alone is judged; beside it is the result after the terrain stage, which recognises water
by its appearance. The scenes lie in `bench/scenes`, one for each danger; on the sample flight and on the ladder's
lakes, the same is measured on the water there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from heights_matchers import mapped
from heights_points import OPEN, Mask
from heights_table import Row, kept
from ladder import MOST_SEEDS, rung
from numpy.typing import NDArray
from true_views import exposures

import alight_sim as simulate
from alight.arrays import F32
from alight.geometry import Grid
from alight.pipeline import without_water
from alight.pipeline.judging import land_cover
from alight.records import ElevationMap, Flag, Terrain, View
from alight.settings import TerrainSettings

SCENES = Path(__file__).parent / "scenes"
WRONG, DEEP = 0.25, 0.5  # metres: a height that must be flagged; the same on water whose bed shows
# scenes: whether they are judged on their water (or on open ground), and from where on a height is wrong
ASKED = {
    "low_texture": (False, WRONG), "moving_shadow": (False, WRONG), "new_water": (True, WRONG),
    "clear_water": (True, DEEP),
}  # fmt: skip
METHODS = ("batch", "ring")
OF_GIVEN, OF_KIND, WITH_TERRAIN = "of all given out", "of its own cells", "of all given out after the terrain stage"
Numbers = dict[str, float]


@dataclass(frozen=True, eq=False)
class Ground:
    """True ground of a flight."""

    height: F32  # (R, C) metres above the origin
    label: NDArray[np.uint8]
    grid: Grid

    def at(self, grid: Grid) -> tuple[F32, NDArray[np.uint8]]:
        """Heights, bilinear, NaN outside, and classes on another grid."""
        e, n = np.meshgrid(*grid.xy())
        row, col = (i.astype(np.float32) for i in self.grid.index(e, n))
        edge = {"borderMode": cv2.BORDER_CONSTANT}
        height = cv2.remap(self.height.astype(np.float32), col, row, cv2.INTER_LINEAR, borderValue=np.nan, **edge)
        return height, cv2.remap(self.label, col, row, cv2.INTER_NEAREST, borderValue=0, **edge)


def mapped_by_all(shots: list[list[View]], method: str) -> ElevationMap:
    """The map from both cameras."""
    found = mapped(shots, method, 16)
    assert found is not None
    return found


def through(found: ElevationMap, ground: Ground, limit: float, water: bool) -> Numbers:
    """Percent of cells with an error above `limit` that are not flagged; on water alone, or on open ground."""
    height, label = ground.at(found.grid)
    seen = np.isfinite(height) & ((found.flags & np.uint16(Flag.UNSEEN)) == 0)
    kind = label == Terrain.WATER if water else np.isin(label, OPEN)
    given = seen & found.trusted
    off = kind & (np.abs(found.height - height) > limit)
    wrong, dry = given & off, seen & without_water(found, land_cover(found, TerrainSettings(), None)).trusted
    return {
        OF_GIVEN: _share(wrong, given),
        OF_KIND: _share(wrong, seen & kind),
        "given out": _share(given & kind, seen & kind),
        WITH_TERRAIN: _share(dry & off, dry),
    }


def _share(part: Mask, whole: Mask) -> float:
    return 100 * float(part.sum()) / max(float(whole.sum()), 1.0)


def _judged(flight: simulate.SimulatedFlight, water: bool, limit: float) -> dict[str, Numbers]:
    """Numbers of one flight by both methods."""
    shots = list(exposures(flight))
    truth = flight.truth
    ground = Ground(np.asarray(truth.height, np.float32), truth.label, truth.grid)
    return {m: through(mapped_by_all(shots, m), ground, limit, water) for m in METHODS}


def scene(name: str, seed: int) -> dict[str, Numbers]:
    """Numbers of one of the scenes."""
    return _judged(simulate.fly(SCENES / f"{name}.yaml", seed), *ASKED[name])


def lakes(name: str) -> dict[str, Numbers]:
    """Numbers of the water of a rung of the ladder."""
    return _judged(rung(name).fly(), True, DEEP)


def rows(seeds: str) -> list[Row]:
    """Rows of every scene and of the lakes, the mean over the seeds."""
    flights = {n: [kept(f"{n} {s}", partial(scene, n, int(s))) for s in seeds.split(",")] for n in ASKED}
    kind = "test" if int(seeds.split(",")[0]) > MOST_SEEDS else "tuning"
    flights["lakes"] = [kept(f"{n} water", partial(lakes, n)) for n in (f"lakes/{h}m/{kind}-1" for h in (20, 50))]
    out = []
    for which, found in flights.items():
        limit = ASKED[which][1] if which in ASKED else DEEP
        judged = OF_GIVEN if limit == DEEP else OF_KIND
        for m in METHODS:
            mean = {k: float(np.mean([f[m][k] for f in found])) for k in found[0][m]}
            asked = (1.0, 0.1)  # water whose bed shows is flagged by the terrain stage: the output of a run is judged
            at_once, after = ((), asked) if limit == DEEP else (asked, ())
            out.append(Row(f"off > {limit} m and not flagged, % {judged}: {which}, {m}", mean[judged], *at_once))
            other = OF_KIND if judged == OF_GIVEN else OF_GIVEN
            out.append(Row(f"... % {other}", mean[other]))
            out.append(Row(f"... % {WITH_TERRAIN}", mean[WITH_TERRAIN], *after))
            out.append(Row(f"... given out, % {OF_KIND}", mean["given out"]))
    return out
