"""Checks before a landing begins, each with its evidence and a remedy."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from alight.checks.result import CheckResult, bad, good, unknown, warning
from alight.flight.autopilot import RemoteVehicle, StreamRate, judged_parameters, on_plane
from alight.flight.executive.bounds import Bounds
from alight.flight.live.sight import SightNavigation
from alight.flight.live.speed import LASTS, Speed
from alight.geometry import LocalFrame
from alight.geometry.zones import EVERYWHERE, Region
from alight.records import (
    FIX_3D,
    NO_ZONES,
    InputError,
    Landed,
    Motion,
    MotionState,
    Rig,
    Telemetry,
    Zones,
    ZonesOnPlane,
)
from alight.settings import Settings

LEAST_RATE, GOOD_RATE = 2.0, 4.0  # exposures per second
MOST_AGE = 1.0  # s between an exposure and its arrival
OLD_PLACE = 0.5  # s, age of the autopilot's position above which the link or the rate is too slow
MOST_SIGMA = 0.02  # s, uncertainty of the autopilot's clock
LEAST_IMU = 25.0  # samples per second; an interval of more than 0.05 s is a gap
FASTER = "use a faster link, or one without a ground station that requests less (MAVProxy: set streamrate -1)"
INERTIAL = ("HIGHRES_IMU", "RAW_IMU")
NEEDED = ("ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT", "GPS_RAW_INT")  # messages without which no landing begins


def judge_link(
    name: str, messages: int, vehicle: RemoteVehicle | None, refused: str, dropped: str = ""
) -> list[CheckResult]:
    """Check the link, and the autopilot at its other end.

    Args:
        name, messages: name of the link, and the number of messages received over it.
        vehicle: the vehicle found; None: no vehicle.
        refused: reason why a sender was not accepted as the vehicle; empty: no sender was refused.
        dropped: numbers of dropped messages, in words; empty: none was dropped.
    """
    if not messages and dropped:
        mend = "give the autopilot the passphrase in the key's file; after a crash of this program wait five seconds"
        return [bad("link", f"no message over {name} is signed with the key: {dropped}", mend)]
    if not messages:
        mend = "see that the autopilot sends MAVLink there: port, baud rate, address"
        return [bad("link", f"nothing has come over {name}", mend)]
    link = good("link", f"{messages} messages over {name}" + (f"; dropped: {dropped}" if dropped else ""))
    if vehicle is None:
        what = refused or "messages come, but no heartbeat of an autopilot"
        return [link, bad("autopilot", what, "fly ArduPilot's Copter or PX4's multicopter (docs/autopilot.md)")]
    if not vehicle.alive:
        return [link, bad("autopilot", "its heartbeat has stopped", "see why; a landing needs it all the time")]
    mode = vehicle.telemetry.mode_name or "not known"
    return [link, good("autopilot", f"{vehicle.firmware.name}, system {vehicle.system}, mode {mode}")]


def judge_vehicle(
    vehicle: RemoteVehicle, missing: str, settings: Settings, take_off: bool, dry: bool, home_given: bool
) -> list[CheckResult]:
    """Check the autopilot by its telemetry: clock, streams, position, home, battery, wind, and whether it flies.

    Args:
        settings: settings of the landing, for the limits of battery, wind and height.
        missing: reason why the vehicle gives no GPS/INS; empty: it gives GPS/INS.
        take_off, dry, home_given: whether the landing begins with a take-off, is a dry run, and has a given home.
    """
    now = vehicle.telemetry
    return [
        _clock(vehicle), _streams(vehicle.missing_streams, vehicle.stream_rates), _estimator(vehicle, missing),
        _home(now, home_given),
        _battery(now, settings.executive.least_battery), _wind(now, settings.executive.most_wind),
        _place(now, take_off, dry, 2.0 * settings.executive.commit_height), *judge_throttle(vehicle),
    ]  # fmt: skip


def judge_throttle(vehicle: RemoteVehicle) -> list[CheckResult]:
    """Check the pilot's throttle stick if the motors run."""
    if not vehicle.telemetry.armed:
        return []
    if vehicle.throttle_low:
        why = "its stick is down: after a takeover the vehicle would sink"
        return [warning("throttle", why, "put the stick in the middle now; later its move is a takeover")]
    return [good("throttle", "its stick is not down")]


def _clock(vehicle: RemoteVehicle) -> CheckResult:
    if not vehicle.clock.known:
        return bad("clock", "no answer to TIMESYNC yet", "see that messages of this computer reach the autopilot")
    if vehicle.clock.sigma > MOST_SIGMA:
        late = f"the autopilot's clock is known to {1e3 * vehicle.clock.sigma:.0f} ms"
        return warning("clock", late, "use a faster link: motion and pictures are tied by it")
    return good("clock", f"the autopilot's clock is known to {1e3 * vehicle.clock.sigma:.1f} ms")


def _streams(missing: Sequence[str], rates: Mapping[str, StreamRate]) -> CheckResult:
    if needed := [n for n in missing if n in NEEDED]:
        return bad(
            "streams",
            f"{', '.join(needed)} do not come",
            "see that the link has room: 3 kB a second, 10 with IMU samples",
        )
    if others := [n for n in missing if n not in INERTIAL]:
        return warning("streams", f"{', '.join(others)} do not come", "what they report counts as fine")
    if rare := {name: rate for name, rate in rates.items() if rate.slow and name not in INERTIAL}:
        return warning("streams", _rates(rare), FASTER)
    return good("streams", "all come" if not missing else "all others come")


def _rates(rates: Mapping[str, StreamRate]) -> str:
    return ", ".join(f"{name}: {r.measured:.1f} a second, {r.wanted:.0f} wanted" for name, r in rates.items())


def judge_imu(vehicle: RemoteVehicle, wanted: float) -> CheckResult:
    """Check that IMU samples are requested and come often enough to be used; `wanted` is the requested rate, Hz."""
    if wanted <= 0.0:
        why = "none is requested: where this was tried, no height was measured"
        return warning("IMU", why, "leave out --imu 0")
    if wanted < LEAST_IMU:
        mend = f"give --imu {LEAST_IMU:.0f} or more"
        return bad("IMU", f"{wanted:.0f} samples a second are requested", mend, lasts=True)
    if missing := [n for n in vehicle.missing_streams if n in INERTIAL]:
        why = f"{', '.join(missing)}: no sample has come for some seconds"
        return bad("IMU", why, "see that the link has room for them; without any no height is measured")
    rates = {name: rate for name, rate in vehicle.stream_rates.items() if name in INERTIAL}
    if any(r.measured < LEAST_IMU for r in rates.values()):
        return bad("IMU", _rates(rates), FASTER)
    if any(r.slow for r in rates.values()):
        return warning("IMU", _rates(rates), FASTER)
    return good("IMU", "samples come")


def judge_parameters(vehicle: RemoteVehicle, odometry: bool = False) -> list[CheckResult]:
    """Check the stored parameters, and begin to read what the autopilot stores if that was not begun.

    There is a result for each parameter with a value that is not accepted, and one for all. `odometry`: whether it is
    sent, so that its parameters matter.
    """
    data, table = vehicle.onboard, judged_parameters(vehicle.firmware.name, odometry)
    data.begin([*table, *vehicle.firmware.fence_parameters])
    if not data.parameters_over:
        return [bad("parameters", "they are being read", "wait")]
    read = {p: data.parameters[name] for name, p in table.items() if name in data.parameters}
    differ = [p for p, value in read.items() if not p.is_accepted(value)]
    words = [(p, f"it is {read[p]:g}: {p.why}") for p in differ]
    found = [bad(p.name, w, p.remedy, lasts=True) if p.needed else warning(p.name, w, p.remedy) for p, w in words]
    number = f"{len(read)} read, {len(differ)} to set otherwise"
    if missing := [name for name in table if name not in data.parameters]:
        return [*found, unknown("parameters", f"{number}; no answer for {', '.join(missing)}: look at them yourself")]
    return [*found, good("parameters", number)]


def judge_fence(vehicle: RemoteVehicle, settings: Settings) -> list[CheckResult]:
    """Check that the fence and the rally points were read, and how much of the search area the fence leaves."""
    fence, rally, place = vehicle.onboard.fence, vehicle.onboard.rally, vehicle.telemetry.place
    if not (fence.over and rally.over):
        return [bad("fence", "it is being read", "wait")]
    points = "rally points cannot be had" if rally.items is None else f"{len(rally.items)} rally points"
    if fence.items is None and fence.count:
        why = f"the autopilot announces one (items: {fence.count}), and it cannot be had: {fence.failed}"
        return [bad("fence", why, "mend the link and begin again, or upload the fence again", lasts=True)]
    if fence.items is None:
        act = "its own fence still acts; see the link, or keep the search far from it"
        return [warning("fence", f"it cannot be had ({fence.failed}); {points}", act)]
    if not fence.items:
        return [good("fence", f"the autopilot has none; {points}")]
    if place is None or not vehicle.telemetry.has_position:
        return [bad("fence", "no position yet, so it cannot be judged", "wait")]
    local = LocalFrame(round(place.latitude, 5), round(place.longitude, 5), 0.0)  # to a metre, as checks are repeated
    try:
        region = vehicle.fence_of(local)
    except InputError as e:
        return [bad("fence", str(e), "mend it in the ground station, and upload it again", lasts=True)]
    bounds, at, side = _bounds(settings, region), on_plane(local, place), settings.executive.search_side
    share, names = bounds.share(side), ", ".join(z.name for z in region.zones)
    if not bounds.has_disc(at) or share == 0.0:
        why = f"the search area is outside, or the vehicle's disc has no room in it: {bounds.limit(at)}"
        return [bad("fence", why, "fly to where there is room, or move the fence", lasts=True)]
    left = f"{names}; {100 * share:.0f} % of the search area are inside; {points}"
    return [good("fence", left) if share > 0.5 else warning("fence", left, "search elsewhere, or set a smaller margin")]


@lru_cache(maxsize=4)  # checks are repeated
def _bounds(
    settings: Settings,
    fence: Region = EVERYWHERE,
    zones: ZonesOnPlane = NO_ZONES,
    start: tuple[float, ...] = (0.0, 0.0),
) -> Bounds:
    return Bounds(settings.stages(), fence, np.array(start), zones)


@lru_cache(maxsize=1)  # checks are repeated
def _in_world(zones: Zones, local: LocalFrame) -> ZonesOnPlane:
    return zones.in_world(local)


def judge_zones(
    vehicle: RemoteVehicle, zones: Zones, local: LocalFrame | None, settings: Settings
) -> CheckResult:  # fmt: skip
    """Check that the vehicle hovers below the floor of no zone, and how much of the search area the zones leave.

    `local`: the world frame of the flight; None: not known yet.
    """
    place = vehicle.telemetry.place
    if place is None or local is None:
        return bad("zones", "no position yet, so they cannot be judged", "wait")
    try:
        near = _in_world(zones, local)
    except InputError as e:
        return bad("zones", str(e), "mend the file", lasts=True)
    at, above, disc = on_plane(local, place), place.above_home, settings.lander.reach
    if within := [z for z in near.limits(above, at) if not z.keeps_in and z.depth(at[None])[0] > -disc]:
        why = f"it hovers {above:.0f} m above home, below the floor of {within[0].name}"
        return bad("zones", why, "fly out of the zone, or climb above its floor")
    share = _bounds(settings, zones=near, start=tuple(np.round(at).tolist())).share(settings.executive.search_side)
    left = f"{near.note}; {100 * share:.0f} % of the search area are left"
    if share == 0.0:
        return bad("zones", left, "fly to where there is room, or change the zones")
    doubts = "; ".join(near.warnings) or ("search elsewhere, or change the zones" if share <= 0.5 else "")
    return warning("zones", left, doubts) if doubts else good("zones", left)


def _estimator(vehicle: RemoteVehicle, missing: str) -> CheckResult:
    now = vehicle.telemetry
    if missing or not now.has_position or now.gps.fix < FIX_3D:
        why = missing or "the autopilot's estimator has no absolute position"
        return bad("position", why, "wait for GPS under an open sky, or mend what is named")
    if now.gps.horizontal > 5.0:
        return warning("position", f"GPS is known to {now.gps.horizontal:.1f} m", "wait for more satellites")
    if (oldest := vehicle.oldest_place) > OLD_PLACE:
        mend = "GLOBAL_POSITION_INT ten times a second, over a link with less delay; after 1.5 s the vehicle holds"
        return warning("position", f"the newest is up to {oldest:.1f} s old", mend)
    sigma = "not reported" if math.isnan(now.gps.horizontal) else f"{now.gps.horizontal:.1f} m"
    return good("position", f"{now.gps.satellites} satellites, 1-sigma {sigma}")


def _home(now: Telemetry, given: bool) -> CheckResult:
    if now.home is None:
        why = "the autopilot reports none" + ("; yours is used for route.plan" if given else "")
        return warning("home", why, "it is set at arming; a return leads there")
    return good("home", f"{now.home.latitude:.6f} {now.home.longitude:.6f}, {now.home.altitude_msl:.0f} m MSL")


def _battery(now: Telemetry, least: float) -> CheckResult:
    share = now.battery.share
    if math.isnan(share):
        return unknown("battery", "the autopilot does not report what is left: watch it yourself")
    if share < least:
        return bad("battery", f"{100 * share:.0f} %, a landing is given up below {100 * least:.0f} %", "charge it")
    if share < least + 0.1:
        return warning("battery", f"{100 * share:.0f} %, given up below {100 * least:.0f} %", "charge it")
    return good("battery", f"{100 * share:.0f} %")


def _wind(now: Telemetry, most: float) -> CheckResult:
    speed = math.hypot(*now.wind_world[:2])
    if math.isnan(speed):
        return unknown("wind", "the autopilot does not report it (ArduPilot: EK3_DRAG_...): judge it yourself")
    if speed > most:
        return bad("wind", f"{speed:.1f} m/s, limit {most:.1f}", "wait, or set executive.most_wind if the vehicle can")
    return good("wind", f"{speed:.1f} m/s, limit {most:.1f}")


def _place(now: Telemetry, take_off: bool, dry: bool, least: float) -> CheckResult:
    """Check that the vehicle may be armed for a take-off, or flies at least `least` metres above home.

    Args:
        take_off, dry: see `judge_vehicle`; in a dry run, a vehicle on the ground gives only a warning.
    """
    above = "" if now.place is None else f", {now.place.above_home:.0f} m above home"
    if now.landed is Landed.GROUND or not now.armed:
        if take_off and now.ready and now.checks_off:
            return warning(
                "ready", "the autopilot's own checks before arming are off", "switch them on (ARMING_CHECK 1)"
            )
        if take_off and now.ready:
            return good("ready", "on the ground, and may be armed")
        if take_off:
            read = "read its messages; its ground station shows it, and PX4 may want one (NAV_DLL_ACT)"
            return bad("ready", "the autopilot may not be armed", read)
        if dry:
            return warning("in the air", "it stands on the ground", "orders are shown for a vehicle in the air")
        return bad("in the air", "it stands on the ground", "take off and hover, or give --take-off 30")
    if take_off:
        return bad("on the ground", f"it flies{above}", "leave out --take-off")
    if now.place is not None and now.place.above_home < least:
        why = f"it flies{above}: the search begins at that height, before a map shows what stands there"
        return warning("in the air", why, "climb clear of everything about, unless home lies higher than that")
    return good("in the air", f"it flies{above}")


def judge_cameras(frames: int, rate: float, delay: float, frozen: int) -> CheckResult:
    """Check that new pictures come, often enough, and are stamped by the right clock.

    Args:
        frames: number of exposures so far.
        rate: exposures per second.
        delay: seconds from the newest stamp to its arrival.
        frozen: number of consecutive exposures that repeat the previous one.
    """
    if not frames:
        return bad("pictures", "not one has come", "see that the camera gives pictures, or that the folder is filled")
    seen = f"{rate:.1f} exposures a second, {delay:.2f} s old when they come"
    if frozen > 3:
        return bad("pictures", f"the last {frozen} are the same, bit for bit", "start the camera again")
    if not abs(delay) < MOST_AGE:
        return bad("pictures", seen, "stamps must be of this machine's steady clock, and pictures come within 1 s")
    if rate < LEAST_RATE:
        return bad("pictures", seen, f"at least {LEAST_RATE:.0f} a second are needed; less light, slow disk or link?")
    if rate < GOOD_RATE:
        return warning("pictures", seen, f"{GOOD_RATE:.0f} a second or more are better")
    return good("pictures", seen)


def judge_machine(warm: bool, out: Path, rig: Rig, rate: float, seconds: float, record: bool) -> list[CheckResult]:
    """Check that the loops are compiled (`warm`), and that the folder `out` has room for the recording (if `record`).

    The recording has exposures of the cameras of `rig` at `rate` per second, for `seconds` seconds.
    """
    mend = "run 'alight warmup' once; it takes minutes"
    loops = good("loops", "compiled") if warm else bad("loops", "not compiled on this machine yet", mend)
    free = shutil.disk_usage(out).free * 1e-6
    size = sum(c.camera.width * c.camera.height for c in rig.cameras) * 3e-6
    need = size * rate * seconds * 1.5 if record else 0.0
    if free < 200.0:
        disk = bad("disk", f"{free:.0f} MB are free in {out}", "free some space, or choose another folder with --out")
    elif free < need:
        disk = warning(
            "disk", f"{free:.0f} MB are free, the recording may need {need:.0f}", "give --no-record, or less"
        )
    else:
        disk = good("disk", f"{free:.0f} MB are free, the recording may need {need:.0f}")
    return [loops, disk]


def judge_speed(speed: Speed, unjudged: float) -> CheckResult:
    """Check that the lanes are fast enough on this computer.

    Args:
        speed: times of the lanes, measured before the flight.
        unjudged: age of the newest verdict beyond which a landing ends, if verdicts were fast before, s.
    """
    limits = Speed(1.0 / GOOD_RATE, 1.0 / GOOD_RATE, unjudged / 2.0)  # two verdicts are one after the other
    facts = [
        f"no {name} in {LASTS:.0f} s" if math.isnan(took) else f"a {name} takes {took:.2f} s of {most:.2f} s"
        for name, took, most in zip(("frame", "step of the map", "verdict"), speed, limits, strict=True)
    ]
    if all(took <= most for took, most in zip(speed, limits, strict=True)):
        return good("computer", ", ".join(facts))
    mend = "end other programs, or set a larger parallax.cell: looks and the landing wait for verdicts"
    return warning("computer", ", ".join(facts), mend)


def judge_odometry(sight: SightNavigation) -> CheckResult:
    """Check that odometry is sent, often enough and in time, and compare it with GPS."""
    if (rate := sight.rate) == 0.0:
        return bad("odometry", "none is sent yet", "see that the motion is known, and the clock of the autopilot")
    late = 1e3 * float(np.percentile(tuple(sight.delays), 95))
    seen = f"{rate:.1f} a second, sent {late:.0f} ms after the exposure (95 %), {sight.deviation}"
    if rate < GOOD_RATE:  # ArduPilot's least; PX4 drops a source that is silent for 0.2 s
        return bad("odometry", seen, f"at least {GOOD_RATE:.0f} a second are needed: use a faster camera")
    if rate < 2.5 * GOOD_RATE or late > 100.0:
        return warning("odometry", seen, "10 a second and 100 ms or better are wanted: a faster camera or computer")
    return good("odometry", seen)


def judge_motion(motion: Motion | None, age: float) -> CheckResult:
    """Check that the motion is known; `age` is its age in seconds."""
    if motion is None or age > MOST_AGE:
        return bad("motion", "none is known yet", "see that pictures show ground, and that the calibration fits")
    if motion.state in (MotionState.LOST, MotionState.INITIALISING):
        return bad("motion", motion.why or motion.state.name.lower(), "wait, or run 'alight check' on a recording")
    if motion.state is MotionState.DEGRADED:
        return warning("motion", motion.why, "run 'alight check' on a recording of this rig")
    sigma = math.sqrt(max(float(motion.covariance[:3, :3].diagonal().max()), 0.0))
    return good("motion", f"{motion.tracks} features, {age:.2f} s old, place known to {sigma:.1f} m")
