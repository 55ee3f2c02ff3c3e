"""Coverage of the heights by the claimed interval: relative sigma and common tilt together, from estimated poses.

    python bench/bench_coverage.py                       # every flight, batch and ring: half an hour of CPU
    python bench/bench_coverage.py --flights sample --methods batch --kept out/coverage

Runs `alight run` on the flights with truth in ../shared/data (or ALIGHT_DATA), evaluates each run, and prints the share
of ground cells within 1.96 sigma after one constant offset: that of the estimated path, and that of the heights
themselves (east, north, up). A run that is in `--kept` already is evaluated again and not run again.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from tables import DATA, Row, show

from alight.evaluation import evaluate
from alight.outputs import write_run
from alight.outputs.folder import is_run
from alight.runner.replay import Find, find
from alight.settings import load_settings

FLIGHTS = {"sample": "sample", **{n: f"rendered/{n}" for n in ("gravelpit", "scree", "shore")}}
METHODS = ("batch", "ring")
WITHIN = 92.0, 98.0  # % of the ground cells
COLUMNS = {
    "within 1.96 sigma, %": "relative",
    "within 1.96 sigma and common tilt, %": "with tilt",
    "NMAD, m": "NMAD, m",
}
REGISTERED = {", registered": "path", ", registered by its heights": "heights"}


def run(flight: Path, method: str, out: Path) -> None:
    """Run one flight, unless `out` holds a run already."""
    if not is_run(out):
        result = find(flight, out, Find(load_settings("", [f"parallax.method={method}"])))
        write_run(result, out)


def rows_of(flight: Path, out: Path, name: str) -> list[Row]:
    """Rows of the coverage of one run, from its evaluation."""
    values = evaluate(out, flight).values
    rows = []
    for suffix, by in REGISTERED.items():
        for column, short in COLUMNS.items():
            value = values.get(f"ground {column}{suffix}")
            judged = short == "with tilt" and by == "heights"
            if isinstance(value, float):
                rows.append(Row(f"{name}, constant of the {by}: {short}", value, WITHIN if judged else None))
    return rows


def main() -> None:
    """Run, evaluate, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", default=",".join(FLIGHTS), help="some of: %(default)s")
    parser.add_argument("--methods", default=",".join(METHODS), help="some of: %(default)s")
    parser.add_argument("--kept", type=Path, help="folder for the runs; without it they are thrown away")
    options = parser.parse_args()
    with TemporaryDirectory() as made:
        for flight in options.flights.split(","):
            folder = DATA / FLIGHTS[flight]
            if not folder.is_dir():
                print(f"{folder}: absent, left out; set ALIGHT_DATA to the folder of recordings")
                continue
            for method in options.methods.split(","):
                out = (options.kept or Path(made)) / f"{flight}-{method}"
                run(folder, method, out)
                show(*rows_of(folder, out, f"{flight}, {method}"))


if __name__ == "__main__":
    main()
