"""Cost of a keyframe in flight: CPU of the mapping lane, keyframe by keyframe, and StereoSGBM(64) after each.

    python bench/heights_keyframes.py                                   # the sample, a rung and a descent, full effort
    python bench/heights_keyframes.py --flights sample --efforts 0,1,2,3

A flight is one of ../shared/data (or ALIGHT_DATA), or a rung of the ladder. Its motion is estimated first and is not
timed. Keyframes before the ground is found, and the one that finds it, are left out: their cost is of another kind.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from heights_step import one_thread
from ladder import rung

from alight.pipeline.mapping.recursive_mapper import RecursiveMapper
from alight.pipeline.navigation import Navigation, navigation_lane
from alight.pipeline.timing import Timings
from alight.records import Rig
from alight.runner.opening import open_source
from alight.settings import load_settings
from alight_sim.log import write

DATA = Path(os.environ.get("ALIGHT_DATA", Path(__file__).parents[2] / "shared" / "data"))
FLIGHTS = "sample,village/40m/test-1,gravel/40-8m/test-1"
SETTINGS = load_settings("", ["parallax.method=ring"])
SIZE = 640, 480  # of the yardstick's pair


@cache
def navigated(name: str) -> tuple[Rig, list[Navigation]]:
    """The exposures of a flight with their motions, the input of the mapping lane."""
    with TemporaryDirectory() as scratch:
        folder = DATA / name
        if not folder.is_dir():
            folder = Path(scratch) / "flight"
            write(rung(name).fly(), folder)
        source = open_source(folder, SETTINGS)
        lane = navigation_lane(source.rig, source.kind, SETTINGS.stages(source.imu_noise), None, True)
        return source.rig, [n for e in source.events() if (n := lane.feed(e)) is not None]


def grey(navigation: Navigation) -> np.ndarray:
    """The first picture of an exposure in the size and grey of the yardstick."""
    image = navigation.frame.images[0]
    assert image is not None
    return cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image, SIZE)


def keyframes(name: str, effort: int) -> Iterator[tuple[float, float]]:
    """CPU seconds of each keyframe that improves the map, and of the yardstick right after it."""
    rig, navigations = navigated(name)
    mapper = RecursiveMapper(rig, SETTINGS.stages(), None, Timings(), False)
    matcher, pair = cv2.StereoSGBM_create(0, 64, 5), [grey(navigations[k]) for k in (0, 5)]
    for n in navigations:
        start = time.process_time()
        update = mapper.feed(n, effort)
        spent = time.process_time() - start
        if update is not None and update.steps == 1:
            start = time.process_time()
            matcher.compute(*pair)
            yield spent, time.process_time() - start


@one_thread()
def main() -> None:
    """Print a line a flight and effort: median, 95th percentile and mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", default=FLIGHTS)
    parser.add_argument("--efforts", default="0")
    options = parser.parse_args()
    print(f"{'flight, effort':34s}{'keyframes':>10s}{'median':>9s}{'p95':>9s}{'mean, ms':>10s}{'over SGBM':>24s}")
    for name in options.flights.split(","):
        list(keyframes(name, 0))  # compiles and warms
        for effort in map(int, options.efforts.split(",")):
            spent, theirs = np.array(list(keyframes(name, effort))).T
            found = np.array([np.median(spent), np.percentile(spent, 95), spent.mean()])
            ratios = found / np.median(theirs)
            print(
                f"{f'{name}, {effort}':34s}{len(spent):10d}" + "".join(f"{1e3 * v:9.0f}" for v in found)
                + "   " + "".join(f"{v:8.2f}" for v in ratios), flush=True,
            )  # fmt: skip


if __name__ == "__main__":
    main()
