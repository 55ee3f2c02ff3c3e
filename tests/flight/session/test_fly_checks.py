"""The checks before a flight: each finds its fault, and no fault where there is none."""

from __future__ import annotations

import math
from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from length import long
from made_up_ground import Ground
from pilot_rig import PilotRig, seldom
from session_rig import Clock

from alight.checks.result import CheckResult, Judged, bad
from alight.flight.autopilot import StreamRate
from alight.flight.live.speed import Speed, measure_speed
from alight.flight.session import checks
from alight.flight.session import preflight as p
from alight.flight.session.flight import fly_vehicle
from alight.flight.session.inputs import PictureWatch
from alight.flight.session.request import FlightRequest, FlightStatus
from alight.geometry import Pose
from alight.records import Frame, InputError, Motion, MotionState
from alight.settings import Settings
from alight_sim import default_rig

GOOD, BAD, WARNING, UNKNOWN = Judged.GOOD, Judged.BAD, Judged.WARNING, Judged.UNKNOWN


def rig(**more: Any) -> PilotRig:
    """The streams are checked as well: their messages must come as often as they are asked for."""
    return PilotRig(Ground({}).seen, step=0.05, **more)


def hovering(seconds: float = 6.0, silent: frozenset[str] = frozenset()) -> PilotRig:
    r = rig()
    r.sim.vehicle.body.wind_world[0] = 1.0  # exactly 0 is unknown
    r.sim.reports.silent |= silent
    r.up_and_flying(20.0)
    r.sim.reports.sticks[2] = 1500  # a throttle that is down is a warning
    r.run(seconds)
    return r


def vehicle_checks(r: PilotRig, missing: str = "", take_off: bool = False, dry: bool = False) -> dict[str, CheckResult]:
    found = p.judge_vehicle(r.vehicle, missing, Settings(), take_off, dry, False)
    return {c.name: c for c in found}


def test_all_is_well_in_the_air() -> None:
    r = hovering()
    assert {c.verdict for c in vehicle_checks(r).values()} == {GOOD}
    link = p.judge_link("udp:x", r.ours.messages, r.vehicle, "")
    assert [c.verdict for c in link] == [GOOD, GOOD]
    assert "ArduPilot" in link[1].evidence


def test_a_copter_that_does_not_estimate_the_wind_may_be_flown() -> None:
    """The autopilot accepts the request for WIND, but sends none."""
    found = vehicle_checks(hovering(silent=frozenset({"WIND"})))
    assert found["wind"].verdict is UNKNOWN
    assert "EK3_DRAG" in found["wind"].evidence
    assert found["streams"].verdict is WARNING


def test_checks_before_arming_that_are_off_are_told() -> None:
    r = rig()
    r.sim.checks = False
    r.run(10.0)
    found = vehicle_checks(r, take_off=True)["ready"]
    assert found.verdict is WARNING
    assert "ARMING_CHECK" in found.mend


def test_each_fault_is_found() -> None:
    r = hovering()
    r.sim.healthy = False
    r.sim.vehicle.battery = 1.0 - 1100.0 / 1200.0
    r.sim.vehicle.wind_world = np.array([12.0, 0.0, 0.0])
    r.run(4.0)
    found = vehicle_checks(r, missing="the autopilot's GPS has no 3D fix")
    assert {n for n, c in found.items() if c.verdict is BAD} == {"position", "battery", "wind"}
    assert all(c.mend for c in found.values() if c.verdict is BAD)
    assert "no 3D fix" in found["position"].evidence


@pytest.mark.parametrize("link", [{"delay": 0.55}, {"delay": 0.1, "jitter": 0.7}])
def test_positions_that_are_late_are_told(link: dict[str, float]) -> None:
    r = rig(link=link)
    r.up_and_flying(20.0)
    r.run(6.0)
    found = vehicle_checks(r)["position"]
    assert found.verdict is WARNING
    assert "s old" in found.evidence


def test_positions_that_are_rare_are_told() -> None:
    r = hovering()
    seldom(r, 1.0)
    r.run(4.0)
    assert vehicle_checks(r)["position"].verdict is WARNING


def test_a_stream_that_dries_up_is_named() -> None:
    r = hovering()
    r.sim.reports.request = lambda message, interval: False  # type: ignore[method-assign]
    for message in ("GLOBAL_POSITION_INT", "WIND"):
        del r.sim.reports.intervals[message]
    r.run(8.0)
    streams = vehicle_checks(r)["streams"]
    assert streams.verdict is BAD
    assert "GLOBAL_POSITION_INT" in streams.evidence


def test_a_stream_that_somebody_else_slows_down_is_requested_again_and_named() -> None:
    """MAVProxy asks for all streams at 4 Hz, time and again; what we ask for is obeyed until then."""
    r = rig(rates={"HIGHRES_IMU": 50.0})
    r.up_and_flying(20.0)
    r.run(6.0)
    assert not r.vehicle.stream_rates["HIGHRES_IMU"].slow  # 20 a second come: a message a step of this rig
    reports, slowed = r.sim.reports, {"ATTITUDE_QUATERNION": 0.25, "HIGHRES_IMU": 0.25}
    reports.intervals |= slowed
    r.run(4.0)
    assert reports.intervals["HIGHRES_IMU"] == pytest.approx(1 / 50)
    assert reports.intervals["ATTITUDE_QUATERNION"] == pytest.approx(1 / 20)
    request, since = reports.request, r.t
    reports.request = lambda message, interval: request(message, 250_000.0)  # type: ignore[method-assign]
    reports.intervals |= slowed
    r.run(40.0)
    sent = [(t, m) for t, m in r.wire if t > since and m.get_type() == "COMMAND_LONG"]
    times = [t for t, m in sent if m.command == 511 and m.param1 == 105]
    assert 3 <= len(times) <= 5  # at growing intervals
    assert times[-1] - times[-2] > 10.0
    imu = p.judge_imu(r.vehicle, 50.0)
    assert imu.verdict is BAD
    assert "HIGHRES_IMU: 4.0 a second, 50 wanted" in imu.evidence
    streams = vehicle_checks(r)["streams"]
    assert streams.verdict is WARNING
    assert "ATTITUDE_QUATERNION: 4.0 a second, 20 wanted" in streams.evidence
    assert "MAVProxy" in streams.mend


@pytest.mark.parametrize(("rate", "verdict"), [(24.0, BAD), (27.0, GOOD)])
def test_samples_that_come_too_seldom_to_be_used_are_told(rate: float, verdict: Judged) -> None:
    """Half of the 50 that are wanted is no reason to ask again, but no motion is made of fewer than 25."""
    vehicle: Any = SimpleNamespace(missing_streams=[], stream_rates={"HIGHRES_IMU": StreamRate(rate, 50.0)})
    assert p.judge_imu(vehicle, 50.0).verdict is verdict


def test_a_flight_without_imu_is_told_what_it_costs() -> None:
    r = rig(rates={"HIGHRES_IMU": 50.0})
    r.sim.reports.silent |= {"HIGHRES_IMU", "RAW_IMU"}
    r.up_and_flying(20.0)
    r.run(6.0)
    assert p.judge_imu(r.vehicle, 50.0).verdict is BAD
    assert vehicle_checks(r)["streams"].verdict is GOOD
    none = p.judge_imu(r.vehicle, 0.0)
    assert none.verdict is WARNING
    assert "no height was measured" in none.evidence
    assert p.judge_imu(r.vehicle, 10.0).verdict is BAD


def test_pictures_of_an_earlier_flight_are_not_used() -> None:
    """They come all at once, and a gap between them would look like a jump of the camera's clock."""
    s, watch = 1_000_000_000, PictureWatch()
    now = 1_000 * s
    ages = 60 * s, 59 * s, 40 * s, s // 10, 3 * s  # the last is for the clocks to judge
    pictures = [Frame(now - age, (np.full((2, 2), k, np.uint8),), "x") for k, age in enumerate(ages)]
    assert [watch.fresh(p, now) is not None for p in pictures] == [False, False, False, True, True]
    assert watch.frames == 5
    assert watch.rate(now) == pytest.approx(2 / 3)


def test_a_vehicle_on_the_ground_needs_a_take_off() -> None:
    r = rig()
    r.run(10.0)
    assert vehicle_checks(r)["in the air"].verdict is BAD
    assert "--take-off" in vehicle_checks(r)["in the air"].mend
    assert vehicle_checks(r, dry=True)["in the air"].verdict is WARNING
    assert vehicle_checks(r, take_off=True)["ready"].verdict is GOOD
    r.sim.healthy = False
    r.run(3.0)
    assert vehicle_checks(r, take_off=True)["ready"].verdict is BAD
    assert vehicle_checks(hovering(), take_off=True)["on the ground"].verdict is BAD


def test_silence_and_strangers_are_told_apart() -> None:
    assert "nothing has come over udp:x" in p.judge_link("udp:x", 0, None, "")[0].evidence
    assert "is signed with the key: 9 unsigned" in p.judge_link("udp:x", 0, None, "", "9 unsigned")[0].evidence
    assert "no heartbeat" in p.judge_link("udp:x", 5, None, "")[1].evidence
    assert "not supported" in p.judge_link("udp:x", 5, None, "system 3: this autopilot is not supported")[1].evidence
    r = hovering()
    r.down.loss = 1.0
    r.run(6.0)
    assert p.judge_link("udp:x", 5, r.vehicle, "")[1].verdict is BAD


@pytest.mark.parametrize(
    ("frames", "rate", "delay", "frozen", "verdict"),
    [
        (30, 10.0, 0.05, 0, GOOD),
        (30, 3.0, 0.05, 0, WARNING),
        (0, 0.0, math.nan, 0, BAD),
        (30, 1.0, 0.05, 0, BAD),
        (30, 10.0, 3e6, 0, BAD),  # of another clock
        (30, 10.0, -5.0, 0, BAD),  # in the future
        (30, 10.0, math.nan, 0, BAD),
        (30, 10.0, 0.05, 9, BAD),
    ],
)
def test_cameras(frames: int, rate: float, delay: float, frozen: int, verdict: Judged) -> None:
    assert p.judge_cameras(frames, rate, delay, frozen).verdict is verdict


@pytest.mark.parametrize(
    ("state", "age", "verdict"),
    [
        (MotionState.GOOD, 0.2, GOOD),
        (MotionState.DEGRADED, 0.2, WARNING),
        (MotionState.INITIALISING, 0.2, BAD),
        (MotionState.LOST, 0.2, BAD),
        (MotionState.GOOD, 2.0, BAD),
    ],
)
def test_motion(state: MotionState, age: float, verdict: Judged) -> None:
    motion = Motion(0, Pose(), (), np.eye(6), state=state, why="a reason")
    assert p.judge_motion(motion, age).verdict is verdict
    assert p.judge_motion(None, age).verdict is BAD


def test_the_machine(tmp_path: Path) -> None:
    rig = default_rig()
    assert [c.verdict for c in p.judge_machine(True, tmp_path, rig, 5.0, 1.0, True)] == [GOOD, GOOD]
    cold, disk = p.judge_machine(False, tmp_path, rig, 5.0, 1e9, True)
    assert (cold.verdict, disk.verdict) == (BAD, WARNING)
    assert "alight warmup" in cold.mend


@pytest.mark.parametrize(
    ("speed", "verdict", "words"),
    [
        (Speed(0.08, 0.2, 0.9), GOOD, "a verdict takes 0.90 s of 2.50 s"),
        (Speed(0.08, 0.2, 4.7), WARNING, "a verdict takes 4.70 s of 2.50 s"),
        (Speed(0.3, 0.2, 0.9), WARNING, "a frame takes 0.30 s of 0.25 s"),
        (Speed(0.08, math.nan, math.nan), WARNING, "no verdict in 20 s"),
    ],
)
def test_a_computer_that_is_too_slow_is_warned_of(speed: Speed, verdict: Judged, words: str) -> None:
    found = p.judge_speed(speed, 5.0)
    assert found.verdict is verdict
    assert words in found.evidence


@pytest.mark.parametrize(
    ("located", "measured", "seconds", "words"),
    [
        (True, 3.0, 3.0, "a verdict takes 0.90 s of 2.50 s"),
        (True, math.inf, 5.0, "its speed was not measured in 5 s"),
        (False, 3.0, 5.0, "a verdict takes 0.90 s of 2.50 s"),
    ],
)
def test_the_speed_and_the_vehicle_are_waited_for_and_neither_for_ever(
    located: bool, measured: float, seconds: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    r, speed, lines = rig(), Future[Speed](), list[str]()
    r.ready()
    monkeypatch.setattr(checks, "time", Clock(r))
    monkeypatch.setattr(checks, "PATIENCE", 5.0)
    known = SimpleNamespace(missing="")
    feed: Any = SimpleNamespace(lock=nullcontext(), autopilot=r.ours, located=located, events_of=known)
    found = checks.FlightChecks(FlightRequest("udp:x", "camera:0", Path("out"), Settings()), feed, [])
    begin = r.t

    def on_status(status: FlightStatus) -> None:
        lines.extend(c.evidence for c in status.checks if c.name == "computer")
        if r.t > begin + measured and not speed.done():
            speed.set_result(Speed(0.08, 0.2, 0.9))

    assert found.wait_for_vehicle(speed, on_status, lines.append) is located
    assert r.t - begin == pytest.approx(seconds, abs=0.2)
    assert lines[0] == "its speed is being measured"
    assert words in next(c.evidence for c in found.found if c.name == "computer")


@pytest.mark.parametrize(("lasts", "seconds"), [(True, 0.0), (False, 5.0)])
def test_only_what_may_change_is_waited_for(lasts: bool, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    r = rig()
    r.ready()
    monkeypatch.setattr(checks, "time", Clock(r))
    monkeypatch.setattr(checks, "PATIENCE", 5.0)
    feed: Any = SimpleNamespace(autopilot=r.ours)
    found = checks.FlightChecks(FlightRequest("udp:x", "camera:0", Path("out"), Settings()), feed, [])
    begin = r.t
    assert not found.repeat(lambda: [bad("fence", "it leaves no room", "move it", lasts)], lambda: None)
    assert r.t - begin == pytest.approx(seconds, abs=0.2)


def test_a_parameter_that_must_be_set_ends_the_wait_for_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its value is read once, so that 90 s of waiting would change nothing."""
    r, speed = rig(), Future[Speed]()
    r.sim.memory.parameters["FS_EKF_ACTION"] = 0
    monkeypatch.setattr(checks, "time", Clock(r))
    known = SimpleNamespace(missing="", local=None)
    feed: Any = SimpleNamespace(lock=nullcontext(), autopilot=r.ours, located=False, events_of=known)
    found = checks.FlightChecks(FlightRequest("udp:x", "camera:0", Path("out"), Settings()), feed, [])
    begin = r.t
    assert not found.wait_for_vehicle(speed, lambda status: None, lambda line: None)
    assert r.t - begin < 20.0
    assert {c.name: c.verdict for c in found.found}["FS_EKF_ACTION"] is BAD


@long
def test_the_speed_of_this_computer_is_measured() -> None:
    """The lanes work over drawn ground; on a busy machine there may be no time for a step of the map or a verdict."""
    speed = measure_speed(default_rig(), Settings(), 5.0)
    assert speed.frame > 0.0
    assert not speed.verdict < speed.frame


def test_a_search_that_would_begin_low_is_told_of(tmp_path: Path) -> None:
    """Before the first verdict the surroundings are unknown: once it flew 13 m aside, 2 m above the ground."""
    request = FlightRequest("udp:127.0.0.1:0", str(tmp_path), tmp_path / "out", Settings(), take_off=20.0)
    with pytest.raises(InputError, match="search_height"):
        fly_vehicle(request)
    assert not (tmp_path / "out").exists()
    low = rig()
    low.up_and_flying(8.0)
    low.run(6.0)
    found = vehicle_checks(low)["in the air"]
    assert found.verdict is WARNING
    assert "8 m above home" in found.evidence


def test_a_dry_run_takes_nothing_off(tmp_path: Path) -> None:
    request = FlightRequest("udp:127.0.0.1:0", str(tmp_path), tmp_path / "out", Settings(), dry_run=True, take_off=9.0)
    with pytest.raises(InputError, match="--take-off"):
        fly_vehicle(request)


def test_nothing_is_landed_blind(tmp_path: Path) -> None:
    settings = Settings.model_validate({"executive": {"look_again": False}})
    with pytest.raises(InputError, match="look_again"):
        fly_vehicle(FlightRequest("udp:127.0.0.1:0", str(tmp_path), tmp_path / "out", settings))
    assert not (tmp_path / "out").exists()
