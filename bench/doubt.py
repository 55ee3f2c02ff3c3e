"""Fit the doubt of `alight.parallax.trust` (docs/method.md, eq. 15) on simulated flights with true poses.

    python bench/doubt.py                      # three tuning flights, prints the coefficients and what they are worth

A cell is wrong when it is off by more than four parallax pixels. The logarithms of the evidence are the terms of a
logistic regression; each flight weighs the same. Real photos and the sample flight are not used: they check the result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alight import simulate
from alight.parallax import Images, match, trust
from alight.pipeline.terrain_lane import TerrainLane, footprint
from alight.records import F64, Frame, Terrain, View
from alight.settings import Settings

FLIGHTS = ((1, 27.0), (2, 27.0), (3, 60.0))  # seed, metres above ground: the tuning seeds
WRONG_PX = 4.0
MARGIN = 24


def views_of(flight: simulate.SimulatedFlight, step: float) -> list[View]:
    """Keyframes with true poses, `step` metres apart."""
    t, poses = flight.truth_trajectory
    at = {int(k): p for k, p in zip(t, poses, strict=True)}
    out: list[View] = []
    last = None
    for event in flight.events():
        if isinstance(event, Frame) and (last is None or np.linalg.norm(at[event.t_ns].translation - last) > step):
            last = at[event.t_ns].translation
            for i, (cam, image) in enumerate(zip(flight.rig.cameras, event.images, strict=True)):
                if image is not None:
                    out.append(View(event.t_ns, i, image, cam.camera, at[event.t_ns] @ cam.body_from_cam))
    return out


def collect(seed: int, height: float) -> tuple[F64, NDArray[np.bool_]]:
    """Logarithms of the evidence (N, terms) and whether each cell is wrong (N,), without water."""
    flight = simulate.fly("demo", seed, height=height)
    views = views_of(flight, 0.02 * height)
    lane = TerrainLane(Settings())
    if not lane.learn(views) or lane.elevation is None or lane.ground is None:
        raise SystemExit(lane.reason)
    kept: list[tuple[dict[str, NDArray[np.float32]], NDArray[np.float32]]] = []
    original = trust.evidence

    def spy(fit, seen, sigma, per_px):  # type: ignore[no-untyped-def]
        terms = original(fit, seen, sigma, per_px)
        kept.append((terms, per_px))
        return terms

    trust.evidence = spy
    images = Images(views, lane.elevation.cell, lane.ground)
    ground = np.concatenate([footprint(v, lane.ground) for v in views])
    rows, wrong = [], []
    for key in lane.elevation.cover((ground[:, 0].min(), ground[:, 0].max()), (ground[:, 1].min(), ground[:, 1].max())):
        grid = lane.elevation.tile_grid(key, MARGIN)
        found = match(images, grid, *lane._range(grid, float(views[0].centre[2])), lane.settings.parallax)
        if found is None:
            continue
        terms, per_px = kept[-1]
        e, n = np.meshgrid(*grid.xy())
        truth = flight.truth
        r, c = (np.rint(i).astype(int) for i in truth.grid.index(e, n))
        inside = (r >= 0) & (r < truth.grid.rows) & (c >= 0) & (c < truth.grid.cols)
        r, c = r.clip(0, truth.grid.rows - 1), c.clip(0, truth.grid.cols - 1)
        use = inside & np.isfinite(found.height) & (found.views >= 2) & (truth.label[r, c] != Terrain.WATER)
        inner = np.zeros_like(use)
        inner[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
        use &= inner
        rows.append(np.log(np.stack([terms[k] for k in trust.DOUBT if k != "one"], axis=-1)[use]))
        wrong.append((np.abs(found.height - truth.height[r, c]) > WRONG_PX * per_px)[use])
    trust.evidence = original
    return np.concatenate(rows).astype(np.float64), np.concatenate(wrong)


def logistic(X: F64, y: NDArray[np.bool_], weight: F64) -> F64:
    """Coefficients, the constant last, by Newton's method."""
    X = np.c_[X, np.ones(len(X))]
    b = np.zeros(X.shape[1])
    for _ in range(40):
        p = 1 / (1 + np.exp(-X @ b))
        w = weight * p * (1 - p) + 1e-12
        b += np.linalg.solve(X.T @ (X * w[:, None]) + 1e-6 * np.eye(len(b)), X.T @ (weight * (y - p)))
    return b


def main() -> None:
    """Fit and print."""
    flights = [collect(*f) for f in FLIGHTS]
    weight = np.concatenate([np.full(len(y), 1 / len(y)) for _, y in flights])
    b = logistic(np.concatenate([x for x, _ in flights]), np.concatenate([y for _, y in flights]), weight)
    print("DOUBT =", {k: round(float(v), 2) for k, v in zip(trust.DOUBT, b, strict=True)})
    for (seed, height), (X, y) in zip(FLIGHTS, flights, strict=True):
        p = 1 / (1 + np.exp(-(np.c_[X, np.ones(len(X))] @ b)))
        kept = p < trust.MAX_DOUBT
        print(f"seed {seed} at {height:.0f} m: {len(y)} cells, {100 * y.mean():.2f} % wrong")
        print(
            f"  given out {100 * kept.mean():.1f} %; given out and wrong {100 * (y & kept).mean():.2f} % of all cells"
        )


if __name__ == "__main__":
    main()
