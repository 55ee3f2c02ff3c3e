"""Wrong focal lengths found, and false alarms, in surveys drawn as points: python bench/bench_focal.py [SETS]."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from drawn_survey import Survey

RATIOS = 1.1, 1 / 1.1, 1.25, 0.8, 1 / 1.1, 0.5, 1.1, 2.5  # of the true focal length to the one used


def wrong(seed: int) -> Survey:
    """A survey whose focal length can be judged: at one height, at two, or with oblique photos."""
    rng = np.random.default_rng(seed)
    up = float(rng.uniform(50, 100))
    heights = (up,) if seed % 3 else (up, 1.3 * up)
    return Survey(seed, heights, rng.uniform(0, 2), oblique=0.5 * (seed % 5 == 0), gps=rng.uniform(1, 3))


def right(seed: int) -> Survey:
    """The same, or over relief of 30 m, or on a slope."""
    rng, flat = np.random.default_rng(seed), wrong(seed)
    return (
        flat if seed % 2 else
        Survey(seed, flat.heights, relief=30.0, gps=flat.gps) if seed % 4 else
        Survey(seed, flat.heights, flat.relief, slope=rng.uniform(-0.3, 0.3), gps=flat.gps)
    )  # fmt: skip


def main(sets: int) -> None:
    """Print a line for each mistake, and the counts."""
    found = alarms = 0
    for seed in range(sets):
        ratio = RATIOS[seed % len(RATIOS)]
        for survey, true in ((wrong(seed), ratio), (right(seed), 1.0)):
            check = survey.checked(true)
            found += bool(check.because) and true != 1.0
            alarms += bool(check.because) and true == 1.0
            if bool(check.because) != (true != 1.0):
                print(f"{survey}: {true:.2f}, {check}", flush=True)
    print(f"{found} of {sets} wrong focal lengths found, {alarms} false alarms in {sets} right ones")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
