"""The effect of each tuned constant: moved by 30 % both ways (a count by at least one) on flights of our own.

    python bench/constants.py                        # all; hours of CPU, kept between runs (out/bench-heights)
    python bench/constants.py parallax.sweep sites   # some groups
    python bench/constants.py --jobs 2 --write       # and write the effects (settings/tuning/effects.yaml)

The flights are small (320 x 240, 21 exposures). Motion and heights are measured by mapping them again, the judgement
of the ground on the maps of the unchanged constants. An effect is a change of a quantity, averaged over the flights,
over the change that counts (`COUNTS`); `same` says that not a bit of any result changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import get_context
from time import process_time
from typing import Any

import numpy as np
import yaml
from ground_domains import LEVELS, row_of
from ground_maps import Judgeable, finished, shifted
from ladder import rung
from tables import ROOT, kept

from alight.arrays import F64
from alight.evaluation.flight import FlightTruth
from alight.geometry import so3_log
from alight.pipeline import Pipeline, PipelineOptions
from alight.records import ElevationMap, Event, Motion
from alight.settings import Settings, load_settings
from alight.settings.loading import walk
from alight.settings.tuning import Tuning
from alight.spread import nmad
from alight_sim import SimulatedFlight
from alight_sim.flight import fly
from alight_sim.scene_world import build
from alight_sim.steered.flight import sized_rig

FLIGHTS = {  # rungs that take part in tuning, and how each is mapped
    "village/20m/tuning-406": "batch", "car_park/20m/tuning-407": "recursive", "meadow/30m/tuning-66": "batch",
    "gravel/40-8m/tuning-3-quick": "recursive", "lakes/20m/tuning-420": "recursive",
    "canal/12m/tuning-35": "recursive", "car_park/12m/tuning-419": "batch", "concrete/12m/tuning-404": "batch",
    "depot/12m/tuning-34": "recursive", "farmland/12m/tuning-405": "batch", "forest/12m/tuning-422": "recursive",
    "furrows/12m/tuning-63": "batch", "gravel/12m/tuning-1": "recursive", "lakes/12m/tuning-62": "batch",
    "marsh/12m/tuning-53": "recursive", "meadow/12m/tuning-400": "recursive", "pasture/12m/tuning-2": "batch",
    "quarry/12m/tuning-402": "recursive", "village/12m/tuning-418": "recursive",
}  # fmt: skip
FLOWN = 2  # of them are mapped again with each constant, the others are judged
EXPOSURES, SIZE = 21, (320, 240)
SHARE = 0.3  # by which a constant is moved
GROUND = ("terrain", "hazards", "sites")  # stages that are judged on kept maps
BAD = 0.01  # of the height above ground: a height that is further off is wrong
# the change of a quantity that counts; of those that begin with log: of its natural logarithm
COUNTS = {
    "log position": 0.05, "log path": 0.05, "log turn": 0.05, "log NEES": 0.1, "log CPU": 0.15, "known %": 1.0,
    "log NMAD": 0.05, "wrong %": 0.3, "within 95 %": 1.0, "found %": 1.0, "false %": 0.3, "true places %": 4.0,
}  # fmt: skip
TABLE = ROOT / "src" / "alight" / "settings" / "tuning" / "effects.yaml"
Quantities = dict[str, float]


@dataclass(frozen=True, eq=False)
class Case:
    """One flight, drawn, and its true ground."""

    name: str
    flight: SimulatedFlight
    events: list[Event]
    truth: FlightTruth
    height: float  # metres above the ground

    def fly(self, settings: Settings) -> tuple[Quantities, ElevationMap | None, F64, str]:
        """Map the flight; return its quantities, the map, the mean error of its path and a digest of its results."""
        lane = Pipeline(self.flight.rig, "flight", settings, PipelineOptions(imu=self.flight.imu_noise))
        begin = process_time()
        online = [m for e in self.events if (m := lane.feed(e)) is not None]
        end = finished(lane, settings)
        found = end.elevation
        took = process_time() - begin
        (out, _), (smoothed, drift) = self._motion(online), self._motion(end.motions)
        out |= {"log path": smoothed["log position"]}
        out |= self._heights(found, drift) | {"log CPU": math.log(took)}
        digest = hashlib.sha256(str(sorted((k, v) for k, v in out.items() if k != "log CPU")).encode())
        if found is not None:
            digest.update(found.height.tobytes() + found.sigma.tobytes() + found.flags.tobytes())
        return out, found, drift, digest.hexdigest()

    def _motion(self, motions: Sequence[Motion]) -> tuple[Quantities, F64]:
        """Errors of position and attitude."""
        true = [self.flight.pose(m.t_ns) for m in motions]
        off = np.array([m.world_from_body.translation - t.translation for m, t in zip(motions, true, strict=True)])
        turn = np.array(
            [so3_log(m.world_from_body.rotation @ t.rotation.T) for m, t in zip(motions, true, strict=True)]
        )
        nees = np.mean([e @ np.linalg.solve(m.covariance[:3, :3], e) for m, e in zip(motions, off, strict=True)])
        drift = np.asarray(off.mean(axis=0))
        spread = [float(np.log(np.linalg.norm((x - x.mean(axis=0)), axis=1).mean() + 1e-6)) for x in (off, turn)]
        return {"log position": spread[0], "log turn": spread[1], "log NEES": float(np.log(nees))}, drift

    def _heights(self, found: ElevationMap | None, drift: F64) -> Quantities:
        """Errors of the heights given out, less those of the path's mean and of the map's plane."""
        if found is None:
            return {"known %": 0.0}
        e, n = np.meshgrid(*found.grid.xy())
        true = self.truth.grid.nearest_at(self.truth.dem, e - drift[0], n - drift[1]) + drift[2]
        given = found.trusted & np.isfinite(true)
        off = level((found.height - true)[given], e[given], n[given])
        return {
            "known %": 100 * float(given.sum()) * found.grid.cell**2 / self.height**2,
            "log NMAD": math.log(nmad(off)),
            "wrong %": 100 * float((np.abs(off) > BAD * self.height).mean()),
            "within 95 %": 100 * float((np.abs(off) < 1.96 * found.sigma[given]).mean()),
        }

    def ground(self, settings: Settings, found: ElevationMap, drift: F64) -> tuple[Quantities, str]:
        """Judge the map; return the claims beside the truth, and a digest of the judgement."""
        row = row_of(Judgeable(self.name, found, shifted(self.truth, drift)), settings)
        claims, listed = row.claims, row.listed
        sure = claims.p >= LEVELS[0]
        out = {
            "found %": 100 * float((sure & claims.safe).sum() / max(claims.safe.sum(), 1)),
            "false %": 100 * float((sure & ~claims.near).sum() / max(sure.sum(), 1)),
            "true places %": 100 * float(np.mean([m.isupper() for m in listed])) if listed else 100.0,
        }
        return out, hashlib.sha256(claims.p.tobytes() + repr(listed).encode()).hexdigest()


def level(off: F64, east: F64, north: F64) -> F64:
    """Errors less their plane, (N,) metres, found again without those beyond three deviations."""
    a, use = np.c_[east, north, np.ones(len(off))], np.ones(len(off), bool)
    for _ in range(4):
        rest = off - a @ np.linalg.lstsq(a[use], off[use], rcond=None)[0]
        use = np.abs(rest - np.median(rest)) < 3 * nmad(rest)
    return np.asarray(rest)


@cache
def case(name: str) -> Case:
    """Draw a flight."""
    plan = rung(name).plan()
    duration = None if rung(name).end_height else (EXPOSURES - 1) / rung(name).rate_hz
    world = build(plan, rung(name).seed)
    flight = fly(world, rung(name).seed, duration, plan=plan.flight, rig=sized_rig(plan.rig.rig, SIZE, stereo=True))
    truth = FlightTruth(flight.truth.height, flight.truth.label, flight.truth.grid)
    return Case(name, flight, list(flight.events()), truth, float(rung(name).height))


def settings_of(name: str, change: str) -> Settings:
    """The settings of a flight with one constant changed."""
    return load_settings("", [f"parallax.method={FLIGHTS[name]}", *([f"tuning.{change}"] if change else [])])


@cache
def unchanged(name: str) -> tuple[Quantities, ElevationMap | None, F64, str]:
    """The map of a flight by the constants as they are."""
    return case(name).fly(settings_of(name, ""))


def measure(change: str) -> dict[str, Any]:
    """The quantities of each flight with one constant changed, and digests of its map and of the judgement."""
    out, ground = {}, not change or change.split(".")[0] in GROUND
    for name in list(FLIGHTS)[FLOWN if ground and change else 0 : None if ground else FLOWN]:
        settings, judged = settings_of(name, change), ""
        flown, found, drift, digest = unchanged(name) if ground else case(name).fly(settings)
        if ground and found is not None:
            claims, judged = case(name).ground(settings, found, drift)
            flown = flown | claims
        out[name] = {"quantities": flown, "map": digest, "ground": judged}
    return out


def moved(value: Any, up: bool) -> Any:
    """A value moved by `SHARE`: a count by at least one, a share below 1."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, tuple):
        return [moved(v, up) for v in value]
    if isinstance(value, int):
        return value + (1 if up else -1) * max(1, round(SHARE * value))
    return value * (1 + SHARE if up else 1 - SHARE)


def changes(key: str, value: Any) -> list[str]:
    """The two changes of a constant that its limits allow."""
    out = []
    for up in (False, True):
        for share in (moved(value, up), 1 - (1 - SHARE) * (1 - value) if isinstance(value, float) else value):
            change = f"{key}={json.dumps(share)}"
            try:
                load_settings("", [f"tuning.{change}"])
            except ValueError:
                continue
            out.append(change)
            break
    return [c for c in out if c != f"{key}={json.dumps(value)}"]


def effect(base: dict[str, Any], found: dict[str, Any]) -> Quantities:
    """The mean change of each quantity over the change that counts."""
    pairs = [(base[name]["quantities"], f["quantities"]) for name, f in found.items()]
    return {
        k: float(np.mean(off)) / scale
        for k, scale in COUNTS.items()
        if (off := [f[k] - b[k] for b, f in pairs if k in b and k in f])
    }


def kept_measure(change: str) -> dict[str, Any]:
    """Measure a change, or take it from the last run."""
    name = f"constants {change or 'unchanged'}"
    return kept(name, partial(measure, change), ("src", "bench"))  # type: ignore[no-any-return]


def row(key: str, value: Any, base: dict[str, Any], found: list[dict[str, Any]]) -> dict[str, Any]:
    """The largest effect of a constant, and whether a bit changed."""
    effects = [effect(base, f) for f in found]
    worst = sorted(((abs(v), k, v) for e in effects for k, v in e.items() if k != "log CPU"), reverse=True)
    cpu = max((abs(e.get("log CPU", 0.0)) for e in effects), default=0.0)
    part = "ground" if key.split(".")[0] in GROUND else "map"
    same = all(base[name][part] == flight[part] for f in found for name, flight in f.items())
    return {
        "key": key, "value": value, "effect": round(worst[0][0], 2) if worst else 0.0,
        "quantity": worst[0][1] if worst else "", "cpu": round(cpu, 2), "same": same,
    }  # fmt: skip


def main() -> None:
    """Print the effect of each constant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", help="beginnings of the names, such as parallax.sweep")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.name}")
    options = parser.parse_args()
    skipped = ("executive", "route", "bundle")
    keys = {k: f.default for k, f in walk(Tuning) if f.default is not None and not k.startswith(skipped)}
    keys = {k: v for k, v in keys.items() if not options.groups or k.startswith(tuple(options.groups))}
    wanted = {k: changes(k, v) for k, v in keys.items()}
    rows = []
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:  # threads of loops do not survive a fork
        base = pool.submit(kept_measure, "").result()
        jobs = {k: [pool.submit(kept_measure, c) for c in wanted[k]] for k in keys}
        for k, v in keys.items():
            r = row(k, v, base, [j.result() for j in jobs[k]])
            rows.append(r)
            mark = "same" if r["same"] else f"{r['effect']:.2f} {r['quantity']}"
            print(f"{k:44s} {v!s:>24s}  {mark:28s} CPU {r['cpu']:.2f}", flush=True)
    if options.write:
        known = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
        for r in rows:
            known[r["key"]] = known.get(r["key"], {}) | {
                "effect": r["effect"],
                "on": "" if r["same"] else r["quantity"],
            }
        TABLE.write_text(yaml.safe_dump(known, width=10_000))


if __name__ == "__main__":
    main()
