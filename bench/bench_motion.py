"""Ego-motion against its requirements: one table, each number with its `must` and `aim` beside it.

    python bench/bench_motion.py                        all of it
    python bench/bench_motion.py nees damage speed      some parts: nees batch damage sample ladder photos speed evo
    python bench/bench_motion.py ladder --scenes meadow,village --heights 20,50 --seeds 3

`nees`, `batch` and `damage` fly without images; `sample` and `photos` need the recordings in ../shared/data (or
$ALIGHT_DATA) and report when they are absent.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads that wait for each other cost eight times the work here

import argparse
import logging
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import ladder
from motion_common import DATA, SECOND, Row, errors, fly, interpolated, recording, relative_px, ring_px, say
from motion_ladder import part_ladder
from motion_scenarios import ALL, DEGRADED, GOOD, OUTAGE, Outcome
from motion_speed import part_speed
from point_flight import NOISE, PointFlight, best, error, nees, run

from alight.geometry import Pose, so3_log
from alight.motion import MotionFilter
from alight.records import Frame, InputError, Motion, MotionState, NavSample
from alight.runner.opening import open_source
from alight.settings import Settings, load_settings
from alight.sources import Source
from alight.tracks import Tracker

# -- flights without images ----------------------------------------------------------------------------------------


def part_nees(_: argparse.Namespace) -> None:
    """NEES of the pose over 50 seeded flights, one in five without IMU."""
    flights = [PointFlight(seed=s, seconds=8.0, count=80, imu=s % 5 != 0) for s in range(50)]
    found = np.array([[nees(m, f.truth(m.t_ns)) for m in run(f.events)[1]] for f in flights])
    low, high = chi2.ppf([0.025, 0.975], 6 * len(flights)) / len(flights)
    mean = found.mean(axis=0)
    share = 100 * float(np.mean((mean > low) & (mean < high)))
    say(
        Row("NEES of pose in the 95 % band, 50 flights of 8 s", share, 90, 95, "%", least=True),
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

    def ratio(part: slice, when: slice) -> float:
        a, b = (np.sqrt(np.mean(np.array(x)[:, when, part] ** 2)) for x in (online, batch))
        return float(a / b)

    last, whole = slice(-10, None), slice(20, None)
    say(
        Row("position RMSE over the batch's, last second of 16 flights", ratio(slice(0, 3), last), 1.5, 1.2),
        Row("attitude RMSE over the batch's, last second", ratio(slice(3, 6), last), 1.5, 1.2),
        Row("position, from the second second on (the batch knows the future)", ratio(slice(0, 3), whole)),
        Row("attitude, from the second second on (the batch knows the future)", ratio(slice(3, 6), whole)),
    )


def _healthy(o: Outcome) -> bool:
    """Return whether the states are those expected of a damage, as in the docstrings of tests/test_motion_damage.py."""
    s = o.scenario
    if s.name.startswith(("GPS", "lens")):
        late = 2.5 if s is OUTAGE else 0.6
        during = o.states(s.begin + late, s.end) == {DEGRADED}
        return during and o.states(s.end + 1.0, s.length) <= {GOOD} and o.share(GOOD, 1.0, s.begin) > 0.95
    return o.share(GOOD, 1.0, s.length) > 0.95


def part_damage(_: argparse.Namespace) -> None:
    """Named damage, three flights each, the outage twelve: health states, error after it in its sigma, drift."""
    for scenario in ALL:
        found = [scenario.fly(seed) for seed in range(12 if scenario is OUTAGE else 3)]
        after = min(scenario.end + 5.0, scenario.length - 1.0)
        right = sum(map(_healthy, found))
        say(
            Row(f"{scenario.name}: states right, of {len(found)} flights", right, len(found), len(found), least=True),
            Row("... largest error 5 s after, in its sigma", max(o.normalised(after) for o in found), 4.5),
        )
        if scenario is OUTAGE:
            drift = 100 * float(np.sqrt(np.mean([o.drift() ** 2 for o in found])))
            turned = 1e3 * float(np.sqrt(np.mean([o.heading(scenario.begin) ** 2 for o in found])))
            say(
                Row("... drift over 30 s at 5 m/s, RMS", drift, 1.5, 0.5, "%"),
                Row("... heading error when GPS/INS fell silent (1 mrad is 0.1 %)", turned, unit="mrad"),
            )
    say(*_point_ladder())


def _point_ladder() -> list[Row]:
    """The ladder without images: drifting GPS (1 m) and INS (0.5 degrees); beside it GPS/INS off after 2 s."""
    out = []
    for height in (20, 50, 100, 150):
        kept, alone = [], []
        for seed in range(3):
            f = PointFlight(seed=seed, seconds=12.0, height=height, speed=0.1 * height)
            kept.append(run(f.events)[1])
            cut = [e for e in f.events if not isinstance(e, NavSample) or f.seconds_of(e) < 2.0]
            motions = run(cut)[1]
            off = (
                error(motions[-1], f.truth(motions[-1].t_ns))[0][:3]
                - error(motions[20], f.truth(motions[20].t_ns))[0][:3]
            )
            alone.append(100 * float(np.linalg.norm(off)) / (f.speed * 10.0))
        complete = 100 * float(np.mean([all(m.state is not MotionState.LOST for m in ms) for ms in kept]))
        out.append(Row(f"ladder {height} m, points: flights without `lost`", complete, 100, 100, "%", least=True))
        out.append(
            Row("... GPS/INS off after 2 s: drift of the way", float(np.sqrt(np.mean(np.square(alone)))), unit="%")
        )
    return out


# -- flights with images -------------------------------------------------------------------------------------------


def part_sample(_: argparse.Namespace) -> None:
    """The rendered sample flight, 30 m."""
    source = recording(DATA / "sample", Settings())
    if source is None:
        return
    truth, flown = interpolated(source), fly(source, Settings())
    px, length = ring_px(flown, truth, 30.0)
    say(Row(f"sample flight: consistency of the ring over {length:.2f} s", px, 0.35, 0.15, "px"))
    for name, motions in (("filter", flown.online), ("batch", flown.smoothed)):
        p, r, n = errors(motions, truth)
        pairs = [(a, b) for a in motions for b in motions if 0 <= b.t_ns - a.t_ns - SECOND < SECOND // 100]
        each = np.sqrt(np.mean([relative_px(a, b, truth, flown.rig, 30.0) for a, b in pairs]))
        say(
            Row(f"... {name}: poses given out one by one, over 1 s", float(each), unit="px"),
            Row("... position RMSE, its mean removed", float(np.linalg.norm(p.std(axis=0))), unit="m"),
            Row("... tilt, mean", 1e3 * float(np.linalg.norm(r.mean(axis=0)[:2])), unit="mrad"),
            Row("... NEES (6 expected)", n),
        )


def part_photos(_: argparse.Namespace) -> None:
    """Photos 3 m apart through the filter, with the lens of the reference's poses."""
    from mirafiori_reference import body_poses, camchain

    folder = DATA / "mirafiori"
    with tempfile.TemporaryDirectory() as scratch:
        if not folder.is_dir():
            recording(folder, Settings())
            return
        z, lens = np.load(folder / "sfm_reference.npz"), Path(scratch) / "lens.yaml"
        lens.write_text(camchain(z["image_wh"], z["camera_params"]))
        for name, sensors in (("with gimbal", True), ("without any attitude", False)):
            source = open_source(folder / "images", load_settings("", [f"sources.calibration={lens}"]))
            reference = body_poses(source, folder)
            motions = _photos(source, sensors)
            if not motions:
                print(f"photos {name}: no motion")
                continue
            body_from_cam = source.rig.cameras[0].body_from_cam
            cams = [(m.world_from_cams[0], reference[m.t_ns] @ body_from_cam) for m in motions]
            centre = np.array([a.translation - b.translation for a, b in cams])
            turn = np.array([so3_log(a.rotation @ b.rotation.T) for a, b in cams])
            say(
                Row(f"photos {name}: placed, of 32", len(motions), 32 if sensors else None, least=True),
                Row("... camera centres, RMS", float(np.sqrt((centre**2).sum(axis=1).mean())), 0.10, 0.05, "m"),
                Row("... attitude, RMS", float(np.degrees(np.sqrt((turn**2).sum(axis=1).mean()))), 0.15, 0.05, "deg"),
            )
    print("    the map: `alight run` over them with --set motion.method=filter, then `alight evaluate`")


def _photos(source: Source, attitude: bool) -> list[Motion]:
    settings = Settings().stages()
    tracker, estimator = Tracker(source.rig, settings.tracks), MotionFilter(source.rig, settings.motion.filter)
    for e in source.events():
        if isinstance(e, NavSample):
            estimator.feed_nav(e if attitude else replace(e, world_from_body=None, sigma_attitude=None))
        elif isinstance(e, Frame):
            predictor = estimator.predictor()
            expected = None if predictor is None else predictor.cameras(e.t_ns, tracker.last_ns, estimator.imu)
            estimator.feed_tracks(tracker.feed(e, expected))
    return list(estimator.refined().motions)


# -- outside tools -------------------------------------------------------------------------------------------------


def part_evo(_: argparse.Namespace) -> None:
    """APE and RPE of the sample flight by evo, called as a program."""
    ape = shutil.which("evo_ape") or str(Path(sys.executable).parent / "evo_ape")
    if not Path(ape).exists():
        print("evo is not installed: pip install evo")
        return
    source = recording(DATA / "sample", Settings())
    if source is None:
        return
    truth, flown = interpolated(source), fly(source, Settings())
    with tempfile.TemporaryDirectory() as scratch:
        for name, motions in (("filter", flown.online), ("batch", flown.smoothed)):
            files = [Path(scratch) / "truth.tum", Path(scratch) / f"{name}.tum"]
            _tum(files[0], [(m.t_ns, truth(m.t_ns)) for m in motions])
            _tum(files[1], [(m.t_ns, Pose(m.world_from_body.rotation, best(m)[0])) for m in motions])
            for tool, options in (("ape", []), ("rpe", ["--delta", "10", "--delta_unit", "f", "--all_pairs"])):
                program = ape.replace("evo_ape", f"evo_{tool}")
                done = subprocess.run(
                    [program, "tum", *map(str, files), *options], capture_output=True, text=True, check=True
                )
                rmse = next(line.split()[1] for line in done.stdout.splitlines() if line.split()[:1] == ["rmse"])
                say(
                    Row(
                        f"evo_{tool} of the {name}, RMSE" + (" over 1 s" if tool == "rpe" else ""),
                        float(rmse),
                        unit="m",
                    )
                )


def _tum(path: Path, poses: Sequence[tuple[int, Pose]]) -> None:
    lines = []
    for t, pose in poses:
        w, x, y, z = pose.quaternion
        lines.append(f"{t // SECOND}.{t % SECOND:09d} " + " ".join(f"{v:.9f}" for v in (*pose.translation, x, y, z, w)))
    path.write_text("\n".join(lines) + "\n")


PARTS = {
    "nees": part_nees,
    "batch": part_batch,
    "damage": part_damage,
    "sample": part_sample,
    "photos": part_photos,
    "speed": part_speed,
    "evo": part_evo,
    "ladder": part_ladder,
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=" ".join(PARTS) + "; without any: all")
    parser.add_argument("--scenes", default=",".join(ladder.SCENES), help="of the ladder, with commas between")
    parser.add_argument("--heights", default="20,50,100,150", help="of the ladder, metres")
    parser.add_argument("--seeds", type=int, default=1, help="of the ladder, flights of each scene and height")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):  # `choices` refuses to be given none
        parser.error(f"no part is called {', '.join(sorted(unknown))}; choose from {', '.join(PARTS)}")
    logging.basicConfig(level=logging.ERROR)
    print(f"{'':66s}{'measured':>10s} {'':6s}{'must':>10s}{'aim':>10s}")
    for part in options.parts or PARTS:
        try:
            PARTS[part](options)
        except InputError as e:
            print(f"{part}: {e}")


if __name__ == "__main__":
    main()
