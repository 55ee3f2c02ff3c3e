"""The figures of docs/lab/heights.md: error against frames, height and pose error, drawn from measured numbers.

python bench/heights_figures.py                   # all into docs/figures; numbers are kept between runs
python bench/heights_figures.py frames height     # some

"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import bench_heights_poses as poses
import numpy as np
from heights_ladder import Ladder, measure
from heights_table import kept

FOLDER = Path(__file__).parents[1] / "docs" / "figures"
RUNG = "meadow/40m/test-1"
FRAMES = (8, 10, 14, 20, 28, 40)
SCALES = (0.0, 0.25, 0.5, 1.0, 2.0)  # of 5 cm and 0.2 degrees
POSE_SEEDS = 2
LEAST_GIVEN = 50  # percent given out, of points: of fewer an error means nothing
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 360, 64, 176, 34, 48  # px
COLOURS = ("#1f5fa8", "#2a9d57", "#c0392b", "#e08a1e", "#7d5ba6", "#777777")
Points = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Axis:
    """One axis of a chart."""

    label: str
    ticks: Sequence[float]
    log: bool = True

    def at(self, value: float) -> float:
        """Position of a value: 0 at the first tick, 1 at the last."""
        f: Callable[[float], float] = math.log if self.log else float
        low, high = f(self.ticks[0]), f(self.ticks[-1])
        return (f(value) - low) / (high - low)


def chart(title: str, across: Axis, up: Axis, lines: dict[str, Points]) -> str:
    """A line chart as SVG; names stand at the ends of the lines."""
    w, h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def x(v: float) -> float:
        return round(LEFT + w * across.at(v), 1)

    def y(v: float) -> float:
        return round(TOP + h * (1 - up.at(v)), 1)

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="12"><rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        f'<text x="{LEFT}" y="20" font-size="14">{title}</text>',
        f'<text x="{LEFT + w / 2}" y="{HEIGHT - 10}" text-anchor="middle">{across.label}</text>',
        f'<text transform="translate(16 {TOP + h / 2}) rotate(-90)" text-anchor="middle">{up.label}</text>',
    ]
    for t in across.ticks:
        out.append(f'<path d="M{x(t)} {TOP}V{TOP + h}" stroke="#ddd"/>')
        out.append(f'<text x="{x(t)}" y="{TOP + h + 16}" text-anchor="middle">{t:g}</text>')
    for t in up.ticks:
        out.append(f'<path d="M{LEFT} {y(t)}H{LEFT + w}" stroke="#ddd"/>')
        out.append(f'<text x="{LEFT - 6}" y="{y(t) + 4}" text-anchor="end">{t:g}</text>')
    lines = {name: [p for p in points if math.isfinite(p[1])] for name, points in lines.items()}
    ends = spread([y(points[-1][1]) for points in lines.values()])
    for (name, points), colour, end in zip(lines.items(), COLOURS, ends, strict=False):
        path = " ".join(f"{x(a)},{y(b)}" for a, b in points)
        out.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        out += [f'<circle cx="{x(a)}" cy="{y(b)}" r="2.5" fill="{colour}"/>' for a, b in points]
        out.append(f'<text x="{x(points[-1][0]) + 8}" y="{end + 4}" fill="{colour}">{name}</text>')
    return "\n".join([*out, "</svg>\n"])


def spread(places: list[float], apart: float = 15.0) -> list[float]:
    """Places moved down until none is nearer than `apart` to another."""
    out, last = list(places), -math.inf
    for i in np.argsort(places):
        last = out[i] = max(out[i], last + apart)
    return out


def frames() -> str:
    """Error against the number of frames."""
    found = {n: measure(RUNG, n) for n in FRAMES}
    names = ("batch", "ring", "SGBM motion, median", "SGBM motion, widest")
    lines = {m: [(float(n), found[n][m]["open NMAD %"]) for n in FRAMES] for m in names}
    ticks = (0.03, 0.05, 0.1, 0.2, 0.5)
    title = "Open ground, true poses, 40 m: error against frames (2 % of the height apart)"
    return chart(title, Axis("frames", FRAMES), Axis("NMAD, % of height", ticks), lines)


def height() -> str:
    """Error against height."""
    rungs = Ladder()
    lines = {
        m: [(float(h), 0.01 * h * rungs.median(m, "open NMAD %", [h], 10)) for h in rungs.heights]
        for m in ("batch", "ring", "SGBM motion, median", "SGBM motion, widest", "SGBM rig", "SGBM rig x4")
    }
    ticks = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
    title = "Open ground, true poses, 10 frames: error against height"
    return chart(title, Axis("height above ground, m", rungs.heights), Axis("NMAD, m", ticks), lines)


def pose() -> str:
    """Error against the error of the poses."""

    def shape(scale: float, refine: bool) -> float:
        runs = [
            kept(f"poses {RUNG} x{scale} {seed} {refine}", lambda s=seed: poses.fly(RUNG, "white", s, refine, scale))  # type: ignore[misc]
            for seed in range(1, 1 + POSE_SEEDS)
        ]
        given = min(r["given"] for r in runs)
        return float(np.mean([r["shape"] for r in runs])) if given > LEAST_GIVEN else math.nan

    lines = {
        name: [(5.0 * s, shape(s, refine)) for s in SCALES]
        for name, refine in (("as they are", False), ("refined with the map", True))
    }
    title = "Open ground, 40 m, 20 frames: shape against the error of each pose"
    across = Axis("error of the position, cm; of the attitude, 0.04 degrees a cm", (0, 2, 4, 6, 8, 10), log=False)
    return chart(title, across, Axis("NMAD less a plane, % of height", (0.05, 0.1, 0.2, 0.5)), lines)


FIGURES: dict[str, Callable[[], str]] = {"frames": frames, "height": height, "pose": pose}


def main() -> None:
    """Draw the figures."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or FIGURES:
        path = FOLDER / f"heights-{name}.svg"
        path.write_text(FIGURES[name](), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
