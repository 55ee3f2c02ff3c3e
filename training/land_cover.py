"""Fit `learned/land_cover.npz`, a small net over the evidence of single cells, and `known_ground.npz`.

    PYTHONPATH=bench python training/land_cover.py

Half of the cells are drawn evenly, half so that every class of every flight has the same weight: common classes must be
distinguished from rare and small ones. Needs the extra `train` (scikit-learn). Maps are kept under --scratch, because
making them is most of the work.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from card import version, write_table
from ground_maps import TUNING, Judgeable, judgeable
from looks import TUNING as LOOKS
from looks import kept_looks
from scipy.ndimage import distance_transform_edt

from alight.arrays import F32, F64, I64, U8, Mask
from alight.elevation import on_cells_up_to
from alight.learned import KnownGround, Net
from alight.records import LANDABLE, ElevationMap, Flag, Terrain
from alight.settings import TerrainSettings
from alight.terrain import evidence
from alight.terrain.appearance import appearance, seen
from alight.terrain.relief import relief
from alight.terrain.water import wetness

HIDDEN, CLASSES = 48, 8
AS_THEY_COME, OF_A_CLASS = 3000, 400  # cells of a flight
LEAST = 50  # cells of a class in a flight that count
PENALTY = 2e-3  # of squared weights, at every step
ROUNDS, BATCH, RATE = 10, 1024, 1e-3  # draws of all cells, cells of a step, step of Adam
# log odds taken from short grass: as much as leaves no open ground worse off than before, flights left out
CAUTION = 0.25
KNOWN_SHARE = 0.95  # of the landable cells of families left out that count as known
SOFT = 0.05  # added to the variance of every term
SHIFT = 0.35  # spreads of a term, 1-sigma of the shift of a flight


@dataclass(frozen=True, eq=False)
class Rows:
    """Evidence of some cells, and their true classes."""

    names: tuple[str, ...]
    values: F32  # (N, terms)
    kind: I64  # (N,) class code - 1
    weight: F64  # (N,)
    flight: I64  # (N,)


def evidence_of(e: ElevationMap) -> dict[str, F32]:
    """The terms of one map, (R, C) each, by identifier."""
    colours = appearance(e)
    return dict(evidence.land_cover_terms(e, colours, relief(e, wetness(e, colours), TerrainSettings())))


def worst_class(j: Judgeable) -> U8:
    """(R, C): the class of every cell; a class that may not be landed on wins if any part of the cell has it."""
    label, grid = j.truth.label, j.truth.grid
    barred = ~np.isin(label, [int(k) for k in LANDABLE])
    reach = 0.5 * j.elevation.grid.cell / grid.cell
    if reach >= 0.7 and barred.any():
        away, at = distance_transform_edt(~barred, return_indices=True)
        label = np.where(away <= reach + 0.3, label[tuple(at)], label)
    return j.of(label)


def _drawn(kind: U8) -> tuple[I64, F64]:
    """Draw cells (N,) of a flight, without those of class 0; return their indices and their weights."""
    rng = np.random.default_rng(0)
    every = np.flatnonzero(kind)
    parts = [rng.choice(every, min(AS_THEY_COME, len(every)), replace=False)]
    weights = [np.full(len(parts[0]), 0.5 / len(parts[0]))]
    found = [c for k in Terrain if len(c := np.flatnonzero(kind == k)) >= LEAST]
    for cells in found:
        parts.append(rng.choice(cells, min(OF_A_CLASS, len(cells)), replace=False))
        weights.append(np.full(len(parts[-1]), 0.5 / len(found) / len(parts[-1])))
    return np.concatenate(parts), np.concatenate(weights)


def _seen_of(name: str, scratch: Path) -> Iterator[tuple[Judgeable, Mask]]:
    """The maps of a flight on the cells of the land cover, and the masks (R, C) of the cells that count."""
    if "/looks/" in name:
        maps = [(look.judgeable, look.about) for look in kept_looks(name, scratch)]
    else:
        j = judgeable(name, "batch", scratch)
        maps = [] if j is None else [(j, lambda grid: np.ones(grid.shape, np.bool_))]
    for j, about in maps:
        j = replace(j, elevation=on_cells_up_to(j.elevation, TerrainSettings().cell))
        e = j.elevation
        yield j, seen(e) & j.known & ((e.flags & np.uint16(Flag.UNSEEN)) == 0) & about(e.grid)


def _cells_of(name: str, scratch: Path) -> tuple[list[str], F32, U8] | None:
    """Evidence of the cells of a flight that count (N, terms) by name, and their classes (N,)."""
    names, values, kind = list[str](), [], []
    for j, counts in _seen_of(name, scratch):
        found = evidence_of(j.elevation)
        names = list(found)
        values.append(np.stack([v[counts] for v in found.values()], axis=1))
        kind.append(worst_class(j)[counts])
    return (names, np.concatenate(values), np.concatenate(kind)) if values else None


def rows_of(flights: Iterable[str], scratch: Path) -> list[Rows]:
    """Draw cells of every flight, or of the looks of a world; they are kept beside its map."""
    out = []
    for number, name in enumerate(flights):
        path = scratch / f"{name.replace('/', '_')}-cover.npz"
        if not path.exists():
            cells = _cells_of(name, scratch)
            if cells is None:
                continue
            names, values, kind = cells
            at, weight = _drawn(kind)
            np.savez(path, names=np.array(names), values=values[at], kind=kind[at], weight=weight)
        with np.load(path) as z:
            at_ = np.full(len(z["kind"]), number, np.int64)
            out.append(Rows(tuple(map(str, z["names"])), z["values"], z["kind"].astype(np.int64) - 1, z["weight"], at_))
    return out


def joined(parts: list[Rows]) -> Rows:
    """Join the cells of several flights."""
    values, kind, weight, flight = (
        np.concatenate([getattr(p, k) for p in parts]) for k in ("values", "kind", "weight", "flight")
    )
    return Rows(parts[0].names, values, kind, weight / weight.sum(), flight)


class Round(NamedTuple):
    """The cells of one round, whole batches of them."""

    cells: I64  # (N,) indices of cells
    shift: F32  # (flights, terms) spreads


def rounds_of(
    rng: np.random.Generator, weight: F64, flight: I64, terms: int, rounds: int, batch: int
) -> Iterator[Round]:
    """Draw the cells of each round.

    Args:
        rng: random numbers.
        weight: (N,) of the cells, sums to 1.
        flight: (N,) number of each cell's flight.
        terms: of a cell.
        rounds: number of rounds.
        batch: cells of a step; a round is a whole number of batches.
    """
    count = len(weight) // batch * batch
    for _ in range(rounds):
        cells = rng.choice(len(weight), count, p=weight)
        yield Round(cells, rng.normal(0, SHIFT, (int(flight.max()) + 1, terms)).astype(np.float32))


def fit_net(r: Rows, seed: int = 0) -> Net:
    """Fit a net to some cells: Adam over draws by weight, each round's evidence shifted anew.

    The shift simulates another camera, light and ground: without it a net overfits to the flights.
    """
    from sklearn.neural_network import MLPClassifier

    rng = np.random.default_rng(seed)
    usual = np.average(r.values, axis=0, weights=r.weight).astype(np.float32)
    spread = np.sqrt(np.average((r.values - usual) ** 2, axis=0, weights=r.weight)).astype(np.float32) + 1e-6
    z = (r.values - usual) / spread
    net = MLPClassifier(
        (HIDDEN,), alpha=PENALTY * BATCH, batch_size=BATCH, learning_rate_init=RATE, random_state=seed, shuffle=False
    )  # its penalty is divided by the cells of a step
    for cells, shift in rounds_of(rng, r.weight, r.flight, z.shape[1], ROUNDS, BATCH):
        x = (z[cells] + shift[r.flight[cells]]).clip(-Net.clip, Net.clip)
        net.partial_fit(np.asarray(x, np.float32), r.kind[cells], classes=np.arange(CLASSES))
    layers = [np.asarray(a, np.float32) for pair in zip(net.coefs_, net.intercepts_, strict=True) for a in pair]
    layers[-1][Terrain.SHORT_GRASS - 1] -= np.float32(CAUTION)
    return Net(r.names, usual, spread.astype(np.float32), *layers)


def rounded(net: Net) -> Net:
    """The net with the scales of its terms rounded to four digits, for its file."""
    usual, spread = (np.array([float(f"{v:.4g}") for v in a], np.float32) for a in (net.usual, net.spread))
    return replace(net, usual=usual, spread=spread)


def family_of(name: str) -> str:
    """The scene of a rung of the ladder."""
    return name.split("/")[0]


def known_ground(parts: list[Rows], families: list[str]) -> KnownGround:
    """Means of every class of every family of scenes, and the spread about them."""
    r = joined(parts)
    usual = np.average(r.values, axis=0, weights=r.weight).astype(np.float32)
    spread = np.sqrt(np.average((r.values - usual) ** 2, axis=0, weights=r.weight)).astype(np.float32) + np.float32(
        1e-6
    )
    z = ((r.values - usual) / spread).clip(-KnownGround.clip, KnownGround.clip)
    of = dict(zip([int(p.flight[0]) for p in parts], families, strict=True))
    kinds = np.array([f"{of[int(f)]} {k}" for f, k in zip(r.flight, r.kind, strict=True)])
    means, off = [], np.zeros_like(z)
    for name in np.unique(kinds):
        here = kinds == name
        if here.sum() >= LEAST:
            means.append(z[here].mean(axis=0))
            off[here] = z[here] - means[-1]
    covariance = np.cov(off.T) + SOFT * np.eye(z.shape[1])
    whitening = np.linalg.cholesky(np.linalg.inv(covariance))
    return KnownGround(r.names, usual, spread, np.array(means, np.float32), whitening.astype(np.float32), 1.0)


def with_limit(parts: list[Rows], names: list[str]) -> KnownGround:
    """The known ground of all families; 95 % of the landable cells of families left out lie within its limit."""
    families = [family_of(n) for n in names]
    found, weight = [], []
    for f in sorted(set(families)):
        rest = [k for k, g in enumerate(families) if g != f]
        if not rest:
            continue
        known = known_ground([parts[k] for k in rest], [families[k] for k in rest])
        own = joined([parts[k] for k, g in enumerate(families) if g == f])
        open_ = np.isin(own.kind + 1, [int(k) for k in LANDABLE])
        if open_.sum() >= LEAST:
            found.append(known.novelty(own.values[open_].astype(np.float32)))
            weight.append(np.full(len(found[-1]), 1 / len(found[-1])))
    d, w = np.concatenate(found), np.concatenate(weight)
    order = np.argsort(d)
    share = np.cumsum(w[order]) / w.sum()
    limit = float(d[order[np.searchsorted(share, KNOWN_SHARE)]])
    return replace(known_ground(parts, families), limit=limit)


def main() -> None:
    """Fit, and write the tables and their cards."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, default=Path("out/ground-maps"))
    names = (*TUNING, *LOOKS)
    parts = rows_of(names, parser.parse_args().scratch)
    near = sum("/looks/" in names[int(p.flight[0])] for p in parts)
    fitted = (
        f"Maps of {len(parts) - near} simulated tuning flights of our own simulator (`TUNING` in "
        "`bench/ground_maps.py`), batch maps with\nestimated poses, and looks from 4 to 10 m in "
        f"{near} worlds (`TUNING` in `training/looks.py`), recursive maps;\na cell carries a class that may not be "
        f"landed on if any of that class lies in it. {AS_THEY_COME} cells as they come and\n{OF_A_CLASS} of each class "
        f"are drawn a flight. {version()}"
    )
    measure = "Not measured yet. Command: `python bench/bench_terrain.py measure`."
    made = "`PYTHONPATH=bench python training/land_cover.py`"
    sections = {"Fitted on": fitted, "Made by": made}
    write_table("land_cover", rounded(fit_net(joined(parts))).to_bytes(), sections | {"Metrics": measure})
    known = with_limit(parts, [names[int(p.flight[0])] for p in parts])
    write_table("known_ground", known.to_bytes(), sections)


if __name__ == "__main__":
    main()
