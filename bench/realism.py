"""Realism of the simulator: the same estimator, settings and statistics on simulated, rendered and real recordings.

    python bench/realism.py                        # every built-in scene, flown like the sample flight and the photos
    python bench/realism.py --scenes demo,meadow   # some

The rendered sample flight and the photos lie beside the project (ALIGHT_DATA, or ../shared/data); without them the
simulated rows stand alone. Simulated flights are made twice: with the sample's rig at 30 m, and with the photos' lens
and spacing at 47 m, so that pictures are compared at the same ground sampling.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from matchers import estimator, sgbm, survival
from pictures import statistics
from subjects import Subject, flight, photos

import alight_sim as simulate
from alight.geometry import Camera, Pose
from alight.records import AlightError, Rig, RigCamera

DATA = Path(os.environ.get("ALIGHT_DATA", Path(__file__).parents[2] / "shared" / "data"))
OUT = Path("out/realism")
SEED = 1
PHOTO_LENS = Camera(
    1600, 1300, 1956.0, 1956.0, 788.5, 660.1, "radial-tangential", (-0.40097, 0.20014, 0.00109, 0.00012)
)
LOOK_DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
COLUMNS = (
    "given out, %", "off by more than 1 % of the height before any refusal, %", "off by more and given out, %",
    "texture ratio, median",
)  # fmt: skip
Row = Mapping[str, float]


def simulated(scene: str, like: str) -> Path:
    """The folder of a simulated flight, like the sample (30 m, stereo, 5 m/s) or the photos (47 m, one each 3 m)."""
    out = OUT / f"{scene}-{like}"
    if like == "sample":
        made = simulate.fly(scene, SEED, 6.0, height=30.0, speed=5.0, rate_hz=8.0)
    else:
        rig = Rig((RigCamera("cam0", PHOTO_LENS, Pose(LOOK_DOWN, np.zeros(3))),))
        made = simulate.fly(scene, SEED, 6.0, height=47.0, speed=6.12, rate_hz=2.0, rig=rig)
    simulate.write(made, out, overwrite=True)
    return out


def measure(subject: Subject) -> dict[str, Row]:
    """All tables' rows of one recording."""
    views = subject.views()
    points = subject.points(views, subject.above(views))
    some = [views[i].image for i in np.unique(np.linspace(0, len(views) - 1, 8).astype(int))]
    looks = statistics(some)
    spectrum = {k: v for k, v in looks.items() if k.endswith(" px") or k == "slope"}
    row, by_class, above = estimator(subject, points)
    ground = float(np.median(points.xyz[:, 2]))
    tracks = {f"{100 * s:g} % of height": survival(views, above, ground, s) for s in (0.02, 0.065, 0.13)}
    pair = sgbm(subject, points, views, above)
    return {
        "pictures": {k: v for k, v in looks.items() if k not in spectrum},
        "spectrum": spectrum,
        "estimator": row,
        "tracks": tracks,
    } | {
        f"{matcher}: {column}": {group: numbers[k] for group, numbers in failures.items() if k < len(numbers)}
        for matcher, failures in (("estimator", by_class), ("StereoSGBM", pair))
        for k, column in enumerate(COLUMNS)
    }


def show(title: str, rows: Mapping[str, Row]) -> None:
    """One table as Markdown, a column a quantity that any row has."""
    keys = list(dict.fromkeys(k for row in rows.values() for k in row))
    if not keys:
        return
    print(f"\n### {title}\n")
    print("| | " + " | ".join(keys) + " |\n| --- |" + " --- |" * len(keys))
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(_number(row.get(k, np.nan)) for k in keys) + " |", flush=True)


SHORT = {
    "accepted %": ("estimator", "accepted %"),
    "texture ratio P10": ("estimator", "texture P10"),
    "P50": ("estimator", "P50"),
    "open NMAD, % of height": ("estimator", "open NMAD %"),
    "wrong: dry %": (f"estimator: {COLUMNS[1]}", "dry"),
    "features on rough ground %": (f"estimator: {COLUMNS[1]}", "... rough"),
    "wrong, given out %": (f"estimator: {COLUMNS[2]}", "dry"),
    "StereoSGBM wrong: features %": (f"StereoSGBM: {COLUMNS[1]}", "features"),
    "tracks left after 13 % of height": ("tracks", "13 % of height"),
    "grey sd": ("pictures", "sd"),
    "gradient kurtosis": ("pictures", "kurtosis"),
    "flat pixels %": ("pictures", "flat %"),
    "noise": ("pictures", "noise"),
    "spectrum slope": ("spectrum", "slope"),
}


def short(tables: Mapping[str, Row]) -> Row:
    """The decisive numbers of all tables of one recording."""
    return {name: tables.get(table, {}).get(column, np.nan) for name, (table, column) in SHORT.items()}


def _number(v: float) -> str:
    return "" if np.isnan(v) else f"{v:.3g}" if abs(v) < 100 else f"{v:.0f}"


def recordings(scenes: Iterable[str], likes: Iterable[str]) -> dict[str, Callable[[], Subject]]:
    """The compared recordings by name; each is made when called."""
    out: dict[str, Callable[[], Subject]] = {}
    if (DATA / "sample").is_dir():
        out["SAMPLE"] = lambda: flight("sample", DATA / "sample")
    else:
        print(f"{DATA / 'sample'}: absent, so nothing is compared with it")
    if (DATA / "mirafiori").is_dir():
        out["PHOTOS"] = lambda: photos("photos", DATA / "mirafiori", OUT)
    else:
        print(f"{DATA / 'mirafiori'}: absent, so nothing is compared with it")
    for like in likes:
        for s in scenes:
            out[f"{s} as {like}"] = lambda s=s, like=like: flight(s, simulated(s, like))  # type: ignore[misc]
    return out


def main() -> None:
    """Print all tables."""
    logging.disable(logging.WARNING)
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", default=",".join(simulate.built_in()), help="names, with commas between")
    parser.add_argument("--keep", action="store_true", help="show the rows of earlier runs as well; references stay")
    parser.add_argument("--like", default="sample,photos", help="how the simulated flights are flown")
    asked = parser.parse_args()
    kept = OUT / "results.json"
    results: dict[str, dict[str, Row]] = json.loads(kept.read_text()) if asked.keep and kept.exists() else {}
    for name, make in recordings([s for s in asked.scenes.split(",") if s], asked.like.split(",")).items():
        if name.isupper() and name in results:
            continue
        try:
            results[name] = measure(make())
        except AlightError as e:
            print(f"{name}: {e}")
        OUT.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(results))
    show("in short", {name: short(r) for name, r in results.items()})
    for title in dict.fromkeys(t for r in results.values() for t in r):
        show(title, {name: r[title] for name, r in results.items() if title in r})


if __name__ == "__main__":
    main()
