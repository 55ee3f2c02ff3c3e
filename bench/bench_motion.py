"""Ego-motion against its requirements: one table, each number with its `must` and `aim` beside it.

    python bench/bench_motion.py                        all of it
    python bench/bench_motion.py nees outage speed      some parts: nees batch outage lost lost-pictures sample speed

`nees`, `batch`, `outage` and `lost` fly without images; the others need the recordings in ../shared/data (or
$ALIGHT_DATA) and report when they are absent.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from gps_lost import part_lost, part_lost_pictures
from motion_flights import part_sample, part_speed
from motion_scenarios import OUTAGE
from point_flight import NOISE, PointFlight, error, nees, run
from tables import Row, at_least, show

from alight.records import InputError


def part_nees(_: argparse.Namespace) -> None:
    """NEES of the pose over 50 seeded flights, one in five without IMU."""
    flights = [PointFlight(seed=s, seconds=8.0, count=80, imu=s % 5 != 0) for s in range(50)]
    found = np.array([[nees(m, f.truth(m.t_ns)) for m in run(f.events)[1]] for f in flights])
    low, high = chi2.ppf([0.025, 0.975], 6 * len(flights)) / len(flights)
    mean = found.mean(axis=0)
    share = 100 * float(np.mean((mean > low) & (mean < high)))
    show(
        Row("NEES of pose in the 95 % band, 50 flights of 8 s, %", share, at_least(90), at_least(95)),
        Row("... its mean over flights and time (6 expected)", float(found.mean())),
    )


def part_batch(_: argparse.Namespace) -> None:
    """The filter against the batch smoother (ours, motion/smoother/smoother.py) on the same measurements."""
    online, batch = [], []
    for seed in range(16):
        f = PointFlight(seed=seed, seconds=8.0)
        estimator, motions = run(f.events, NOISE.model_copy(update={"smooth": True}))
        truth = [f.truth(m.t_ns) for m in motions]
        online.append([error(m, t)[0] for m, t in zip(motions, truth, strict=True)])
        batch.append([error(m, t)[0] for m, t in zip(estimator.refined().motions, truth, strict=True)])

    def ratio(part: slice) -> float:
        a, b = (np.sqrt(np.mean(np.array(x)[:, -10:, part] ** 2)) for x in (online, batch))
        return float(a / b)

    show(
        Row("position RMSE over the batch's, last second of 16 flights", ratio(slice(0, 3)), 1.5, 1.2),
        Row("attitude RMSE over the batch's, last second", ratio(slice(3, 6)), 1.5, 1.2),
    )


def part_outage(_: argparse.Namespace) -> None:
    """Twelve flights without GPS/INS for 30 s at 5 m/s: drift of position and heading."""
    found = [OUTAGE.fly(seed) for seed in range(12)]
    drift = 100 * float(np.sqrt(np.mean([o.drift() ** 2 for o in found])))
    turned = 1e3 * float(np.sqrt(np.mean([o.heading(OUTAGE.begin) ** 2 for o in found])))
    show(
        Row("drift over 30 s at 5 m/s, RMS, % of the way", drift, 1.5, 0.5),
        Row("... heading error when GPS/INS fell silent, mrad (1 mrad is 0.1 %)", turned),
    )


PARTS = {
    "nees": part_nees,
    "batch": part_batch,
    "outage": part_outage,
    "lost": part_lost,
    "lost-pictures": part_lost_pictures,
    "sample": part_sample,
    "speed": part_speed,
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=" ".join(PARTS) + "; without any: all")
    parser.add_argument("--seeds", type=int, default=12, help="flights of points of the part `lost`")
    parser.add_argument(
        "--flights", type=Path, nargs="*", default=[], help="more recordings for the part `lost-pictures`"
    )
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):  # `choices` refuses to be given none
        parser.error(f"no part is called {', '.join(sorted(unknown))}; choose from {', '.join(PARTS)}")
    logging.basicConfig(level=logging.ERROR)
    for part in options.parts or PARTS:
        show(title=part)
        try:
            PARTS[part](options)
        except InputError as e:
            print(f"{part}: {e}")


if __name__ == "__main__":
    main()
