"""Moving people and cars, drawn from 30 m down to 1 m: how many are found within half a second, and false alarms.

    python bench/bench_people.py [FAMILIES [SEEDS [WIDTH [HEIGHTS]]]]       # such as: car_park,gravel 1,2 640 30,15

Each short descent over a safe place is drawn three times: with a person or a car that comes into the picture, and
without anybody. The drawn sequences are kept in `out/bench-people`.
"""

from __future__ import annotations

import math
import pickle
import sys
from dataclasses import dataclass
from itertools import product

import numpy as np
from tables import ROOT, Row, at_least, show

from alight.arrays import F64, U8
from alight.geometry import Pose, so3_exp
from alight.records import Frame, Rig, View
from alight.tracks import MovingWatch
from alight.tracks.moving import SIDE, LevelPicture
from alight.trials.campaign.flying import lit_world
from alight.trials.campaign.plan import drawn_light
from alight.trials.campaign.worlds import campaign_world
from alight_sim.flight import START_NS
from alight_sim.oracle import OracleLander, safe_places
from alight_sim.point_mass import Wanted
from alight_sim.steered import SteeredFlight

HEIGHTS = "30,15,8,4,2,1"  # metres above the ground, in the middle of a sequence
KINDS = ("nobody", "person", "car")
FAMILIES, SEEDS, WIDTH = "plaza,park,stubble,heath,thaw", "31,32", "320"  # not looked at while the method was built
SECONDS = 4.0  # length of a sequence
WITHIN = 0.5  # s
POSITION, TURN = 0.004, 0.001  # 1-sigma of the drawn errors of poses: share of the height, rad


@dataclass(frozen=True)
class DrawnDescent:
    """Exposures of one camera, with poses as estimated, the true ground height, and the way of who comes."""

    rig: Rig
    frames: tuple[tuple[int, U8, Pose], ...]  # time in ns, picture, world_from_cam
    ground: float
    way: F64  # (N, 3) true position at each exposure: east, north, up; NaN: nobody
    true: tuple[Pose, ...]


def drawn(family: str, seed: int, height: float, kind: str, width: int) -> DrawnDescent:
    """Draw a sequence; the same arguments give the same bits, except for the person or car."""
    rng = np.random.default_rng([seed, round(height * 10), len(family), *family.encode()])
    world = lit_world(campaign_world(family).build(seed), drawn_light(rng))
    box = tuple(rng.uniform(-40, 0, 2))
    places = safe_places(world, (*box, box[0] + 40, box[1] + 40), OracleLander.of({"radius": 0.4}), headings=1)
    rows, cols = np.nonzero(places.safe)
    k = int(rng.integers(len(rows)))
    east, north = float(places.east[cols[k]]), float(places.north[rows[k]])
    speed = 0.5 if height < 10 else 1.0
    up = height + 0.5 * SECONDS * speed
    flight = SteeredFlight(
        world, seed, stereo=False, start=(east, north, max(up, height + 0.2)), heading=rng.uniform(0, 6.28),
        wind=(*rng.uniform(-4, 4, 2), 0.0), gusts=0.4, size=(width, 3 * width // 4),
    )  # fmt: skip
    ground = world.height_at(east, north)
    least = ground + 0.8 * min(height, 1.0) + flight.standing
    lens = flight.rig.cameras[0]
    reach = height * math.hypot(0.5 * lens.camera.width, 0.5 * lens.camera.height) / lens.camera.fu
    angle, aside = rng.uniform(0, 2 * math.pi), rng.uniform(-0.3, 0.3) * reach
    goes = np.array([math.cos(angle), math.sin(angle)])
    pace = rng.uniform(0.9, 1.8) if kind == "person" else rng.uniform(3.0, 7.0)
    frames, true, begun = [], [], False
    while flight.seconds < SECONDS + 1.0:
        if kind != "nobody" and not begun and flight.seconds > 0.9:
            begun, side = True, np.array([-goes[1], goes[0]]) * aside
            begin = np.array([east, north]) + side - goes * min(reach, 1.5 + 1.2 * pace + 0.5 * reach)
            end = begin + goes * 60.0
            (flight.walk_in if kind == "person" else flight.park)(*end, start=tuple(begin), speed=pace)
        target = np.array([east, north, max(flight.true_pose.translation[2] - speed, least)])
        wanted = Wanted(target, np.zeros(3), speed=1.0, sink=speed)
        for event in flight.step(0.05, wanted):
            if isinstance(event, Frame) and event.images[0] is not None:
                pose = flight.poses(np.array([event.t_ns]))[0] @ lens.body_from_cam
                true.append(pose)
                error = rng.normal(0, POSITION, 3) * height
                shaken = Pose(so3_exp(rng.normal(0, TURN, 3)) @ pose.rotation, pose.translation + error)
                frames.append((event.t_ns, event.images[0], shaken))
    times = np.array([(t - START_NS) * 1e-9 for t, _, _ in frames])
    way = np.full((len(frames), 3), np.nan)
    if flight.bodies:
        at = times >= flight.bodies[0].since
        way[at] = flight.bodies[0].place_at(times)[at]
    return DrawnDescent(flight.rig, tuple(frames), ground, way, tuple(true))


def kept(family: str, seed: int, height: float, kind: str, width: int) -> DrawnDescent:
    """Return a sequence that was drawn before, or draw it."""
    path = ROOT / "out" / "bench-people" / f"{family}-{seed}-{height:g}-{kind}-{width}.pickle"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(drawn(family, seed, height, kind, width)))
    return pickle.loads(path.read_bytes())


def judged(q: DrawnDescent) -> tuple[bool, float, int]:
    """Return whether somebody comes near, the delay until he is found in s, and exposures with a false alarm.

    Near is what the watch looks at: the part of a picture that lies within about 11 m of the point below the vehicle.
    """
    watch, lens = MovingWatch(), q.rig.cameras[0].camera
    begun, delay, false = None, math.inf, 0
    for (t_ns, image, pose), true, way in zip(q.frames, q.true, q.way, strict=True):
        view = View(t_ns, 0, image, lens, pose)
        found, level = watch.feed(view, q.ground), LevelPicture.of(view, q.ground)
        away = np.abs(way[:2] - pose.translation[:2]).max() * level.focal / level.depth
        pixel = lens.project(true.inverse.apply(way[None]))[0] if np.isfinite(way[0]) else np.full(2, np.nan)
        if bool((pixel > 4).all() and (pixel < [lens.width - 5, lens.height - 5]).all() and away < SIDE / 2):
            begun = t_ns if begun is None else begun
            if found and math.isinf(delay):
                delay = (t_ns - begun) * 1e-9
        elif begun is None and np.isnan(way[0]):
            false += bool(found)
    return begun is not None, delay, false


def main() -> None:
    families, seeds, width, heights = (*sys.argv[1:], *(FAMILIES, SEEDS, WIDTH, HEIGHTS)[len(sys.argv) - 1 :])
    rows, seconds, false = list[Row](), 0.0, 0
    for height in map(float, heights.split(",")):
        delays = dict[str, list[float]](person=[], car=[])
        for family, seed, kind in product(families.split(","), seeds.split(","), KINDS):
            q = kept(family, int(seed), height, kind, int(width))
            comes, delay, alarms = judged(q)
            false += alarms
            if kind == "nobody":
                seconds += 1e-9 * (q.frames[-1][0] - q.frames[0][0])
            elif comes:
                delays[kind].append(delay)
        for kind, found in delays.items():
            share = 100 * float(np.mean(np.array(found) <= WITHIN)) if found else math.nan
            rows.append(Row(f"{height:g} m, {kind}: found within {WITHIN} s of {len(found)}, %", share, at_least(95.0)))
    rows.append(Row(f"exposures with a false alarm, a minute of {seconds:.0f} s", 60 * false / seconds, 0.05))
    show(*rows, title="people and cars")


if __name__ == "__main__":
    main()
