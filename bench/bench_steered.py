"""The cost of a steered flight: a landing of two minutes, five stereo exposures of 320x240 a second.

    python bench/bench_steered.py [scene ...]

CPU seconds of the simulator alone, and as a ratio to StereoSGBM (64 disparities) of the same pairs, which holds on
another machine and beside busy neighbours.
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from alight.records import Frame
from alight_sim.steered import SteeredFlight, Wanted

SURVEY, HEIGHT, SPEED, SINK = 80.0, 40.0, 3.0, 1.1  # s, m, m/s, m/s: forth and back, then down to the ground
SETTLE = 3.0  # s


def wanted(seconds: float) -> Wanted:
    """Set-points of the flight."""
    if seconds < SURVEY:
        east = SPEED if int(seconds / 20.0) % 2 == 0 else -SPEED
        return Wanted(velocity=np.array([east, 0.3 * SPEED, 0.0]))
    return Wanted(velocity=np.array([0.0, 0.0, -SINK if seconds > SURVEY + SETTLE else 0.0]))


def main() -> None:
    """Print one line a scene."""
    for scene in sys.argv[1:] or ["demo", "meadow", "village"]:
        start = time.process_time()
        flight = SteeredFlight(scene, 1, start=(-10.0, -30.0, HEIGHT), wind=(3.0, 1.0, 0.0))
        pairs, matched = 0, 0.0
        matcher = cv2.StereoSGBM.create(0, 64, 5)
        while flight.seconds < 120.0 and not flight.landed:
            for event in flight.step(0.1, wanted(flight.seconds)):
                if isinstance(event, Frame):
                    pairs += 1
                    if pairs % 20 == 0:
                        before = time.process_time()
                        matcher.compute(*(image for image in event.images if image is not None))
                        matched += 20.0 * (time.process_time() - before)
        used = time.process_time() - start - matched / 20.0
        print(
            f"{scene}: {used:.1f} s of CPU for {pairs} pairs in {flight.seconds:.0f} s, {1e3 * used / pairs:.0f} ms a "
            f"pair with all else, {used / matched:.1f} times StereoSGBM(64); landed: {flight.landed}"
        )


if __name__ == "__main__":
    main()
