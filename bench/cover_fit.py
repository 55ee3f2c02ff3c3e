"""Fits what covers the ground: a small net over the evidence of single cells, from flights with truth.

Half of its cells are drawn as they come, half so that every class of every flight weighs alike: what is common has to
be told from what is rare and small. Every flight's evidence is shifted anew each time round, as another camera, light
and ground might shift it: without that the net learns the flights by heart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from ground_maps import Judgeable, judgeable
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from alight.learned.layers import CLIP, pack_layer
from alight.records import F32, F64, LANDABLE, U8, ElevationMap, Flag, Terrain
from alight.settings import TerrainSettings
from alight.terrain import evidence
from alight.terrain.appearance import appearance, seen
from alight.terrain.relief import relief
from alight.terrain.water import wetness

HIDDEN, CLASSES = 48, 8
AS_THEY_COME, OF_A_CLASS = 8000, 800  # cells of a flight
LEAST = 50  # cells of a class in a flight that count
SHIFT = 0.35  # of a term's spread, 1-sigma of what a flight's evidence is shifted by
PENALTY = 2e-3  # of squared weights
# log odds taken from short grass: as much as leaves no open ground worse off than before, flights left out
CAUTION = 0.25
SCENES = (
    {"meadow"}, {"village", "yard"}, {"desert", "snow"}, {"lakes", "tall_grass"}, {"farmland", "forest"},
    {"car_park", "concrete", "quarry"},
)  # fmt: skip  # those that are left out together
Integers = NDArray[np.int64]
Batch = tuple[Integers, F32, float]  # cells, what the terms of each are shifted by, and the rate of the step


@dataclass(frozen=True, eq=False)
class Rows:
    """Evidence of some cells, and what is there."""

    names: tuple[str, ...]
    values: F32  # (N, terms)
    kind: Integers  # (N,) class code - 1
    weight: F64  # (N,)
    flight: Integers  # (N,)


@dataclass(frozen=True, eq=False)
class Net:
    """One hidden layer."""

    names: tuple[str, ...]
    usual: F32
    spread: F32
    layers: tuple[F32, ...]  # (in + 1, out) each, the bias last


def evidence_of(e: ElevationMap) -> dict[str, F32]:
    """The terms of one map."""
    look = appearance(e)
    return dict(evidence.cover_terms(e, look, relief(e, wetness(e, look), TerrainSettings())))


def worst_class(j: Judgeable) -> U8:
    """(R, C): the class of every cell; that of what may not be landed on where any of it is in the cell."""
    label, grid = j.truth.label, j.truth.grid
    barred = ~np.isin(label, [int(k) for k in LANDABLE])
    reach = 0.5 * j.elevation.grid.cell / grid.cell
    if reach >= 0.7 and barred.any():
        away, at = distance_transform_edt(~barred, return_indices=True)
        label = np.where(away <= reach + 0.3, label[tuple(at)], label)
    return j.of(label)


def _drawn(j: Judgeable) -> tuple[Integers, U8, F64]:
    """Some cells of a map, their classes, and their weights."""
    rng, kind = np.random.default_rng(0), worst_class(j).ravel()
    flags = j.elevation.flags & np.uint16(Flag.UNSEEN)
    ok = (seen(j.elevation) & j.known & (flags == 0)).ravel() & (kind > 0)
    every = np.flatnonzero(ok)
    parts = [rng.choice(every, min(AS_THEY_COME, len(every)), replace=False)]
    weights = [np.full(len(parts[0]), 0.5 / len(parts[0]))]
    found = [c for k in Terrain if len(c := np.flatnonzero(ok & (kind == k))) >= LEAST]
    for cells in found:
        parts.append(rng.choice(cells, min(OF_A_CLASS, len(cells)), replace=False))
        weights.append(np.full(len(parts[-1]), 0.5 / len(found) / len(parts[-1])))
    at = np.concatenate(parts)
    return at, kind[at], np.concatenate(weights)


def rows(flights: Iterable[str], scratch: Path) -> list[Rows]:
    """Some cells of every flight; kept beside its map."""
    out = []
    for number, name in enumerate(flights):
        path = scratch / f"{name.replace('/', '_')}-cover.npz"
        if not path.exists():
            j = judgeable(name, "batch", scratch)
            if j is None:
                continue
            at, kind, weight = _drawn(j)
            found = evidence_of(j.elevation)
            values = np.stack([v.ravel()[at] for v in found.values()], axis=1)
            np.savez(path, names=np.array(list(found)), values=values, kind=kind, weight=weight)
        with np.load(path) as z:
            at_ = np.full(len(z["kind"]), number, np.int64)
            out.append(Rows(tuple(map(str, z["names"])), z["values"], z["kind"].astype(np.int64) - 1, z["weight"], at_))
    return out


def joined(parts: list[Rows]) -> Rows:
    """The cells of several flights."""
    values, kind, weight, flight = (
        np.concatenate([getattr(p, k) for p in parts]) for k in ("values", "kind", "weight", "flight")
    )
    return Rows(parts[0].names, values, kind, weight / weight.sum(), flight)


@dataclass(frozen=True)
class Schedule:
    """How often cells are drawn, how many at once, and how far the first step goes."""

    rounds: int
    batch: int
    rate: float

    def batches(self, rng: np.random.Generator, weight: F64, flight: Integers, terms: int) -> Iterator[Batch]:
        """Cells drawn by weight (N,), by what the flight (N,) of each is shifted this time round, and the rate."""
        steps = len(weight) // self.batch
        for step in range(self.rounds * steps):
            if step % steps == 0:
                drawn = rng.choice(len(weight), steps * self.batch, p=weight)
                shift = rng.normal(0, SHIFT, (int(flight.max()) + 1, terms)).astype(np.float32)
            i = drawn[step % steps * self.batch :][: self.batch]
            yield i, shift[flight[i]], self.rate * 0.5 * (1 + np.cos(np.pi * step / (self.rounds * steps)))


SCHEDULE = Schedule(rounds=16, batch=1024, rate=3e-3)


@dataclass(eq=False)
class Adam:
    """Steps down the slopes of a loss, each weight by its own size of slope."""

    layers: list[F32]  # changed in place
    taken: int = 0
    mean: list[F32] = field(default_factory=list)
    power: list[F32] = field(default_factory=list)

    def step(self, slopes: list[F32], rate: float) -> None:
        """One step."""
        if not self.taken:
            self.mean, self.power = ([np.zeros_like(w) for w in self.layers] for _ in range(2))
        self.taken += 1
        for w, g, mean, power in zip(self.layers, slopes, self.mean, self.power, strict=True):
            mean += np.float32(0.1) * (g - mean)
            power += np.float32(0.001) * (g * g - power)
            size = np.sqrt(power / (1 - 0.999**self.taken)) + 1e-8
            w -= np.asarray(rate * mean / (1 - 0.9**self.taken) / size, np.float32)


def _slopes(layers: list[F32], x: F32, kind: Integers) -> list[F32]:
    """Of the mean loss: cross entropy over a softmax."""
    inner = x @ layers[0][:-1] + layers[0][-1]
    hidden = np.maximum(inner, 0)
    odds = hidden @ layers[1][:-1] + layers[1][-1]
    off = np.exp(odds - odds.max(axis=1, keepdims=True))
    off /= off.sum(axis=1, keepdims=True)
    off[np.arange(len(kind)), kind] -= 1
    off /= np.float32(len(kind))
    back = (off @ layers[1][:-1].T) * (inner > 0)
    pairs = ((x, back, layers[0]), (hidden, off, layers[1]))
    return [np.vstack([a.T @ b + np.float32(PENALTY) * w[:-1], b.sum(axis=0)[None]]) for a, b, w in pairs]


def train(r: Rows, seed: int = 0) -> Net:
    """Adam over cells drawn by weight; the rate falls as a cosine."""
    rng = np.random.default_rng(seed)
    usual = np.average(r.values, axis=0, weights=r.weight).astype(np.float32)
    spread = np.sqrt(np.average((r.values - usual) ** 2, axis=0, weights=r.weight)).astype(np.float32) + 1e-6
    sizes = (r.values.shape[1], HIDDEN, CLASSES)
    layers = [
        np.vstack([rng.normal(0, np.sqrt(2 / a), (a, b)), np.zeros((1, b))]).astype(np.float32)
        for a, b in pairwise(sizes)
    ]
    adam = Adam(layers)
    for i, shift, rate in SCHEDULE.batches(rng, r.weight, r.flight, sizes[0]):
        x = ((r.values[i] - usual) / spread + shift).clip(-CLIP, CLIP)
        adam.step(_slopes(layers, np.asarray(x, np.float32), r.kind[i]), rate)
    layers[-1][-1, Terrain.SHORT_GRASS - 1] -= np.float32(CAUTION)
    return Net(r.names, usual, spread, tuple(layers))


def module(net: Net, count: int) -> str:
    """The text of `alight/terrain/weights.py`."""
    said = f"Weights of the evidence, from {count} simulated tuning flights: `bench_terrain.py fit`."
    return "\n".join([f'"""{said}"""', "", *text_of(net)])


def text_of(net: Net) -> list[str]:
    """The lines of a module that hold a net."""
    out = ["# term: usual value, and spread", "TERMS: dict[str, tuple[float, float]] = {"]
    out += [f'    "{n}": ({u:.4g}, {s:.4g}),' for n, u, s in zip(net.names, net.usual, net.spread, strict=True)]
    out += ["}", "", "# of each layer: inputs, outputs, and their weights, the bias last, as base 85 of 16 bit floats"]
    out += ["LAYERS: tuple[tuple[int, int, str], ...] = ("]
    for rows_, cols, text in packed(net):
        lines = [text[i : i + 104] for i in range(0, len(text), 104)]
        out += ["    (", f"        {rows_},", f"        {cols},", *(f"        {line!r}" for line in lines), "    ),"]
    return [*out, ")"]


def packed(net: Net) -> tuple[tuple[int, int, str], ...]:
    """The layers as the product reads them."""
    return tuple(pack_layer(w) for w in net.layers)


@contextmanager
def instead(net: Net) -> Iterator[None]:
    """Classify by another net for a while."""
    before = {k: getattr(evidence, k) for k in ("TERMS", "LAYERS")}
    terms = {n: (float(u), float(s)) for n, u, s in zip(net.names, net.usual, net.spread, strict=True)}
    vars(evidence).update(TERMS=terms, LAYERS=packed(net))
    try:
        yield
    finally:
        vars(evidence).update(before)
