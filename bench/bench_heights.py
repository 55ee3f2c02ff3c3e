"""Heights against all their requirements: one table, a row a quantity, with must and aim beside the measured value.

    python bench/bench_heights.py                                        # all of it, about an hour of CPU
    python bench/bench_heights.py --rows sgbm,coverage --rungs meadow/40m/test-1
    python bench/bench_heights.py --rows unflagged --seeds 1001

Quantities that were measured with the same source before are not measured again (out/bench-heights). Recordings are in
../shared/data or $ALIGHT_DATA.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import importlib
import warnings
from collections.abc import Callable

import heights_ladder as ladder
import heights_recordings as recordings
import heights_step
import heights_unflagged as unflagged
from heights_table import Row, head
from matchers import SGBM, SGBM_CHECKS

Rows = Callable[[argparse.Namespace, ladder.Ladder], list[Row]]


def others(module: str) -> list[Row]:
    """The rows of another bench module."""
    return list(importlib.import_module(module).rows())


GROUPS: dict[str, Rows] = {
    "step": lambda options, rungs: heights_step.rows(),
    "sample": lambda options, rungs: recordings.sample_rows(),
    "photos": lambda options, rungs: recordings.photo_rows(),
    "unflagged": lambda options, rungs: unflagged.rows(options.seeds),
    "accuracy": lambda options, rungs: ladder.accuracy(rungs),
    "exponent": lambda options, rungs: ladder.exponent(rungs),
    "sgbm": lambda options, rungs: ladder.sgbm(rungs),
    "edges": lambda options, rungs: ladder.edges(rungs),
    "coverage": lambda options, rungs: ladder.coverage(rungs),
    "poses": lambda options, rungs: others("bench_heights_poses"),
    "memory": lambda options, rungs: others("bench_heights_memory"),
}


def main() -> None:
    """Print the table, group by group, and all of it again at the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(GROUPS), help=f"some of {', '.join(GROUPS)}")
    parser.add_argument("--rungs", default="", help="of the ladder, by name, with commas between")
    parser.add_argument("--seeds", default="1001", help="of the scenes of `unflagged`")
    options = parser.parse_args()
    warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)
    print(f"StereoSGBM: {SGBM}; what it is sure of: {SGBM_CHECKS}")
    rungs = ladder.Ladder([n for n in options.rungs.split(",") if n])
    table: dict[str, list[Row]] = {}
    for name in options.rows.split(","):
        table[name] = GROUPS[name](options, rungs)
        print("\n".join([head(name), *(r.line() for r in table[name])]), flush=True)
    print("\n\nThe whole table")
    for name, rows in table.items():
        print("\n".join([head(name), *(r.line() for r in rows)]))


if __name__ == "__main__":
    main()
