"""Measure `learned/detection.npz`: probability that heights or pixels show an obstacle (docs/lab/p-safe.md).

    PYTHONPATH=bench python training/detection.py                   # measure on tuning flights, and write the table
    PYTHONPATH=bench python training/detection.py --look FLIGHT...  # on other flights with truth, print only

An obstacle stands out of the true surface by more than the lander's tallest obstacle. It is found where the relief of
the heights, or the contrast of the picture, exceeds that of 98 of 100 places of truly quiet ground of the same flight.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from card import version, write_table
from ground_maps import HOWS, TUNING, judgeable
from ground_truth import GroundTruth

from alight.arrays import F32, F64, I64, Mask
from alight.hazards.evidence import patch_mean, picture_spots, power_of_bumps
from alight.raster import distance_to, ellipse, filled_surface, local_max
from alight.records import LANDABLE, Terrain
from alight.settings import Lander, Settings

SIZES = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0])  # widths over the sample or the pixel
BASE = 1.2  # metres, window of the opening: narrower things stand out of the ground
NEAR = 0.2  # metres by which an obstacle may be misplaced
FALSE = 0.98  # share of the even ground that lies below the limit of detection
QUIET = 0.08  # root mean square relief over the height of an obstacle, of truly quiet ground
RIM = 1.0  # metres from unknown ground within which heights are worse than elsewhere
WIDEST = 5.0  # times the limit, the widest obstacle that counts: a wider one shows in the roughness
EVEN, MOST = 500, 400  # least cells of even ground, most obstacles of a flight that count


@dataclass(frozen=True, eq=False)
class Obstacles:
    """The isolated obstacles of one flight, and the response of heights and picture to each."""

    height: F64  # (N,) metres
    width: F64  # (N,) metres at half their height
    sampling: F64  # (N,) metres
    pixel: F64  # (N,) metres
    contrast: F64  # (N,) root mean square contrast of the picture there, over the limit of detection
    by_heights: Mask  # (N,)
    by_pixels: Mask


def _root(power: F32) -> F32:
    return np.sqrt(np.maximum(power, 0))


def obstacles_of(name: str, how: str, scratch: Path, lander: Lander) -> Obstacles | None:
    """Find the obstacles in the truth of one flight, and the response of the map to each; None: there is no map."""
    j = judgeable(name, how, scratch)  # type: ignore[arg-type]
    if j is None:
        return None
    truth, e, grid = GroundTruth(j.truth, lander), j.elevation, j.truth.grid
    limit = lander.tallest_obstacle
    dem = np.nan_to_num(j.truth.dem, nan=float(np.nanmedian(j.truth.dem)))
    top = dem - cv2.morphologyEx(dem, cv2.MORPH_OPEN, ellipse(max(1, round(BASE / 2 / grid.cell))))
    open_ground = np.isin(j.truth.label, [int(k) for k in (*LANDABLE, Terrain.ROCK)])
    count, patches, _, centres = cv2.connectedComponentsWithStats((top > 0.5 * limit).astype(np.uint8))
    if count < 2:
        return None
    peak = np.zeros(count, np.float32)
    np.maximum.at(peak, patches.ravel(), top.ravel())
    half = np.bincount(patches[top > 0.5 * peak[patches]], minlength=count) * grid.cell**2
    rows, cols = np.rint(centres[:, 1]).astype(int), np.rint(centres[:, 0]).astype(int)
    use = (peak > limit) & (peak < 4 * limit) & open_ground[rows, cols]
    use[0] = False
    which = np.flatnonzero(use)
    which = np.random.default_rng(0).choice(which, min(MOST, len(which)), replace=False)
    east, north = grid.east + cols[which] * grid.cell, grid.north - rows[which] * grid.cell
    reach = max(1, round(NEAR / e.grid.cell))
    spots = patch_mean(picture_spots(e, limit).power, e.grid.cell, limit)
    bumps = power_of_bumps(filled_surface(e.height), e.grid.cell, limit)
    relief, spot = (local_max(_root(v), reach) for v in (bumps, spots))
    true = _root(power_of_bumps(dem, grid.cell, limit))
    quiet = local_max(true, max(1, round(2 * NEAR / grid.cell))) < QUIET
    inner = distance_to(~(e.trusted & j.seen)) * e.grid.cell > RIM
    even = truth.on(e.grid, quiet & truth.bears) & inner
    if even.sum() < EVEN:
        return None
    least = [float(np.quantile(v[even], FALSE)) for v in (relief, spot)]
    width = np.sqrt(4 * half[which] / np.pi)
    there = e.grid.nearest_at(e.trusted, east, north) & (width < WIDEST * limit)
    got = [e.grid.nearest_at(v, east, north)[there] for v in (relief, spot, e.sampling, e.picture_sampling)]
    return Obstacles(
        peak[which][there], width[there], got[2], got[3], got[1] / least[1],
        got[0] > least[0], got[1] > least[1],
    )  # fmt: skip


def share_found(size: F64, found: Mask) -> tuple[F64, I64]:
    """Share found in every bin of `SIZES`, and the number of obstacles; NaN where few."""
    at_, count = np.full(len(SIZES), np.nan), np.zeros(len(SIZES), np.int64)
    edges = np.concatenate([[0.0], np.sqrt(SIZES[:-1] * SIZES[1:]), [np.inf]])
    for k, (low, high) in enumerate(pairwise(edges)):
        here = (size > low) & (size <= high)
        count[k] = here.sum()
        if count[k] >= 30:
            at_[k] = found[here].mean()
    return at_, count


def report(all_of: Sequence[Obstacles]) -> list[str]:
    """Lines of a table: shares found by heights and by pixels, all and by contrast."""
    width, g, p = (np.concatenate([getattr(o, k) for o in all_of]) for k in ("width", "sampling", "pixel"))
    found_h, found_p = (np.concatenate([getattr(o, k) for o in all_of]) for k in ("by_heights", "by_pixels"))
    out = ["width over sample or pixel " + " ".join(f"{s:6.1f}" for s in SIZES)]
    for name, size, found in (
        ("heights", width / g, found_h),
        ("pixels", width / p, found_p),
        ("either, by pixel", width / p, found_h | found_p),
    ):
        share, count = share_found(size, found)
        out.append(f"{name:26s} " + " ".join(f"{100 * s:6.1f}" for s in share))
        out.append(f"{'':26s} " + " ".join(f"{c:6d}" for c in count))
    return out


def table_bytes(all_of: Sequence[Obstacles]) -> bytes:
    """Content of the file (.npz): sizes, and the share found by heights and by pixels at each."""
    width, g, p = (np.concatenate([getattr(o, k) for o in all_of]) for k in ("width", "sampling", "pixel"))
    out = io.BytesIO()
    shares = {}
    for k, size in (("heights", width / g), ("pixels", width / p)):
        share, _ = share_found(size, np.concatenate([getattr(o, f"by_{k}") for o in all_of]))
        known = np.isfinite(share)
        filled = np.interp(np.log(SIZES), np.log(SIZES[known]), share[known])
        shares[k] = np.maximum.accumulate(filled).astype(np.float32)
    np.savez_compressed(out, sizes=SIZES.astype(np.float32), **shares)
    return out.getvalue()


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--look", nargs="*", help="rungs of the ladder, or folders with truth")
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    options = parser.parse_args()
    found = [obstacles_of(n, how, options.scratch, Settings().lander) for n in options.look or TUNING for how in HOWS]
    kept = [o for o in found if o is not None]
    lines = report(kept)
    print("\n".join(lines))
    if not options.look:
        table = "\n".join(f"    {line}" for line in lines)
        write_table(
            "detection", table_bytes(kept), {"Fitted on": f"Simulated tuning flights. {version()}", "Metrics": table}
        )


if __name__ == "__main__":
    main()
