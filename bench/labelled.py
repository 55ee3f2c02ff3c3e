"""A run against labels drawn by eye: its claims on hazards, and the share of the open ground that it claims.

    python bench/labelled.py out/mirafiori bench/labels/mirafiori.json --json out/labelled.json

Hazards: the share of their cells that the run claims safe; a touchdown there is centred on the hazard. Open ground: the
share of its cells that the run claims safe, and that it does not refuse, of those where the whole footprint lies on
open ground. Sites: the labels at their centre, and the hazards that their footprint reaches.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from label_file import HAZARDS, OPEN, ROUGH, Labels, read_labels
from label_projection import LabelledMap, labelled_map

from alight.arrays import F32, Mask
from alight.outputs.reading import Run, read_run
from alight.raster import disc_any

CLAIM, HALF = 0.95, 0.5  # P(safe): called safe; more likely safe than not
DRAWN = 0.3  # metres, accuracy of a drawn edge: a footprint that reaches a hazard by less does not count
DOUBT = "doubt"  # the reason of a cell that is not refused, but not sure enough either


@dataclass(frozen=True)
class KindRow:
    """Results of a run on the cells of one kind of ground. Shares are None where there is no cell."""

    cells: int
    claimed: float | None  # share with P(safe) of at least CLAIM
    half: float | None  # share with P(safe) of at least HALF
    candidate: float | None  # share that nothing refuses
    known: float | None  # share with a height


@dataclass(frozen=True)
class SiteRow:
    """Labels at a site."""

    rank: int
    kind: str  # site | candidate
    p_safe: float
    on: tuple[str, ...]  # kinds of ground at its centre
    reaches: tuple[str, ...]  # hazards that its footprint reaches by more than DRAWN


@dataclass(frozen=True)
class Comparison:
    """A run against labels. Rows of kinds without a cell are left out."""

    hazards: Mapping[str, KindRow]
    beside: KindRow  # cells that are no hazard, whose footprint reaches one by more than DRAWN
    rough: KindRow
    open_ground: Mapping[str, KindRow]  # cells whose whole footprint lies on open ground; `all` of any kind
    sites: tuple[SiteRow, ...]
    contradicted: int  # cells that are open ground in one photo, a hazard in another
    unused_photos: tuple[str, ...]


def not_refused(run: Run) -> Mask:
    """Cells that nothing refuses: by reasons.tif where the run wrote one, else P(safe) above 0; (R, C)."""
    path = run.folder / "reasons.tif"
    if not path.exists():
        return safe_of(run) > 0
    with rasterio.open(path) as d:
        reasons, tags = d.read(1), d.tags(1)
    doubt = sum(1 << int(k[4:]) for k, v in tags.items() if k.startswith("bit_") and v.split(":")[0].strip() == DOUBT)
    return np.asarray((reasons & ~reasons.dtype.type(doubt)) == 0)


def safe_of(run: Run) -> F32:
    """P(safe) of every cell, 0 where it was not judged, (R, C).

    Raises:
        ValueError: the run has no safe.tif.
    """
    if run.safe is None:
        raise ValueError(f"{run.folder}: the run has no safe.tif")
    return np.nan_to_num(run.safe, nan=0.0)


def compare(run: Run, labels: Labels) -> Comparison:
    """Compare a run with labels.

    Raises:
        ValueError: see `labelled_map`; or the run has no safe.tif.
    """
    truth = labelled_map(run, labels)
    safe, candidate = safe_of(run), not_refused(run)
    known = np.zeros(safe.shape, bool) if run.height is None else np.isfinite(run.height)

    def row(where: Mask) -> KindRow:
        n = int(where.sum())
        shares = [
            round(float(m[where].mean()), 5) if n else None for m in (safe >= CLAIM, safe >= HALF, candidate, known)
        ]
        return KindRow(n, *shares)

    radius, cell = float(run.info["settings"]["lander"]["radius"]), truth.grid.cell
    near = disc_any(truth.hazard, max(radius - DRAWN, cell), cell)
    fits = truth.open_ground & ~disc_any(~truth.open_ground, radius, cell)
    hazards = {k: row(truth.kinds[k] & ~truth.unsure) for k in HAZARDS} | {"all": row(truth.hazard)}
    opened = {k: row(truth.kinds[k] & fits) for k in OPEN} | {"all": row(fits)}
    return Comparison(
        hazards={k: r for k, r in hazards.items() if r.cells},
        beside=row(near & ~truth.hazard & ~truth.unsure),
        rough=row(truth.rough),
        open_ground={k: r for k, r in opened.items() if r.cells},
        sites=tuple(_sites(run, truth, max(radius - DRAWN, cell))),
        contradicted=int((truth.any_of(OPEN) & truth.hazard).sum()),
        unused_photos=truth.unused,
    )


def _sites(run: Run, truth: LabelledMap, reach: float) -> list[SiteRow]:
    """Sites and candidates of sites.geojson, with the labels about them."""
    path = run.folder / "sites.geojson"
    features = json.loads(path.read_text(encoding="utf-8"))["features"] if path.exists() else []
    return [_site(f["properties"], truth, reach) for f in features]


def _site(p: Mapping[str, Any], truth: LabelledMap, reach: float) -> SiteRow:
    east, north = truth.grid.xy()
    row, col = int(np.abs(north - p["north_m"]).argmin()), int(np.abs(east - p["east_m"]).argmin())
    disc = np.hypot(east[None, :] - p["east_m"], north[:, None] - p["north_m"]) <= reach
    on = tuple(k for k, m in truth.kinds.items() if m[row, col])
    reaches = tuple(k for k in HAZARDS if (truth.kinds[k] & disc & ~truth.unsure).any())
    return SiteRow(p["rank"], p.get("kind", "site"), p["p_safe"], on, reaches)


def table(c: Comparison) -> str:
    """The comparison as a table in Markdown."""
    rows = {f"hazard: {k}": r for k, r in c.hazards.items()}
    rows |= {"beside a hazard": c.beside, ROUGH: c.rough}
    rows |= {f"open: {k}": r for k, r in c.open_ground.items()}
    lines = [
        f"| ground | cells | P(safe) >= {CLAIM:g}, % | P(safe) >= {HALF:g}, % | not refused, % | height known, % |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, r in rows.items():
        shares = ("" if s is None else f"{100 * s:.2f}" for s in (r.claimed, r.half, r.candidate, r.known))
        lines.append(f"| {name} | {r.cells} | {' | '.join(shares)} |")
    lines += ["", "| rank | kind | P(safe) | stands on | footprint reaches |", "| --- | --- | --- | --- | --- |"]
    for s in c.sites:
        on, reaches = ", ".join(s.on) or "no label", ", ".join(s.reaches) or "no hazard"
        lines.append(f"| {s.rank} | {s.kind} | {s.p_safe:.3f} | {on} | {reaches} |")
    lines += ["", f"Open ground in one photo, hazard in another: {c.contradicted} cells."]
    if c.unused_photos:
        lines.append(f"Not placed by the run, labels not used: {', '.join(c.unused_photos)}.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of a run over photos")
    parser.add_argument("labels", type=Path, help="file of labels")
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    args = parser.parse_args()
    found = compare(read_run(args.run), read_labels(args.labels))
    print(table(found))
    if args.json:
        args.json.write_text(json.dumps(asdict(found), indent=1) + "\n")


if __name__ == "__main__":
    main()
