"""Orders over a bad link: commands, streams, reboots, a pilot who takes over."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import BOTH
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import EstimateTie, Setpoint
from alight.flight.autopilot.firmware import ArduPilotFirmware
from alight.records import FlightMode, ImuSample, NoticeKind
from alight_sim.autopilot.dialects import Doing

BAD = {"loss": 0.3, "delay": 0.05, "jitter": 0.1, "double": 0.2}


@BOTH
def test_it_is_ready_when_the_autopilot_says_so(dialect: str) -> None:
    rig = Rig(dialect)
    rig.run(2.5)
    assert not rig.telemetry.ready
    refused = rig.answered(rig.vehicle.arm())
    assert not refused.ok
    assert "not in a state" in refused.text
    rig.run(2)
    assert rig.telemetry.ready
    rig.sim.healthy = False
    rig.run(2)
    assert not rig.telemetry.ready


def test_it_is_ready_where_the_user_has_switched_off_the_checks() -> None:
    """With ARMING_CHECK = 0 the vehicle is ready: the pre-arm bit is present, and neither enabled nor healthy."""
    rig = Rig()
    rig.sim.checks = False
    rig.run(8)
    assert rig.telemetry.checks_off
    assert rig.telemetry.ready
    assert rig.answered(rig.vehicle.arm()).ok


def test_px4_gets_setpoints_before_the_order_to_fly_guided() -> None:
    """PX4 looks for set-points twice a second, and refuses the guided mode until it has seen some."""
    rig = Rig("px4").ready()
    assert rig.answered(rig.vehicle.set_mode(FlightMode.GUIDED)).ok
    rig.run(1.5)
    assert rig.sim.logic.doing is Doing.GUIDED
    assert not [n for n in rig.of(NoticeKind.COMMAND) if not n.ok]


def test_nothing_is_streamed_unasked() -> None:
    rig = Rig(step=0.1)
    rig.up.loss = 1.0
    rig.run(10)
    assert set(rig.telemetry.ages) == {"HEARTBEAT"}
    rig.up.loss = 0.0
    rig.run(70)
    assert {"GLOBAL_POSITION_INT", "ATTITUDE_QUATERNION", "EKF_STATUS_REPORT"} <= set(rig.telemetry.ages)


@BOTH
def test_streams_come_at_their_rates(dialect: str) -> None:
    rig = Rig(dialect, rates={"HIGHRES_IMU": 25.0, "RC_CHANNELS": 0.0}, step=0.02).ready()
    counts, reader = Counter[str](), mavlink.MAVLink(None)
    receive = rig.ours.receive

    def counting(data: bytes, now_ns: int) -> None:
        receive(data, now_ns)
        counts.update(m.get_type() for m in reader.parse_buffer(data) or ())

    rig.ours.receive = counting  # type: ignore[method-assign]
    rig.run(20)
    rates = {name: n / 20 for name, n in counts.items()}
    assert rates["ATTITUDE_QUATERNION"] == pytest.approx(20, rel=0.2)  # steps of 20 ms
    assert rates["GLOBAL_POSITION_INT"] == pytest.approx(10, rel=0.1)
    assert rates["HIGHRES_IMU"] == pytest.approx(25, rel=0.1)
    assert "RC_CHANNELS" not in rates


def test_a_build_without_highres_imu_is_asked_for_raw_imu() -> None:
    """If ArduPilot denies HIGHRES_IMU, RAW_IMU is requested; RAW_IMU for another ground station doubles no sample."""
    rig = Rig(rates={"HIGHRES_IMU": 25.0}, step=0.02)
    rig.sim.reports.lacks = {"HIGHRES_IMU"}
    rig.ready().run(3)
    times = [s.t_ns for s in rig.samples if isinstance(s, ImuSample)]
    assert len(times) > 40
    assert "HIGHRES_IMU" not in rig.vehicle.missing_streams
    both = Rig(rates={"HIGHRES_IMU": 25.0, "RAW_IMU": 10.0}, step=0.02).ready()
    both.run(3)
    both.samples.clear()
    both.run(4)
    times = [s.t_ns for s in both.samples if isinstance(s, ImuSample)]
    assert len(times) == pytest.approx(100, abs=5)


def test_ardupilot_has_room_for_all_intervals() -> None:
    """ArduPilot keeps ten different intervals a link, of which a ground station may use some."""
    assert len({*ArduPilotFirmware.rates.values(), 100.0}) <= 6


@BOTH
def test_streams_are_asked_for_again_after_a_reboot(dialect: str) -> None:
    rig = Rig(dialect, seed=5, link={"loss": 0.2, "delay": 0.05}).ready()
    rig.run(10)
    rig.sim.reboot()
    rig.run(1.5)
    assert rig.run(25, lambda: bool(rig.of(NoticeKind.REBOOT)) and rig.telemetry.ready)
    rig.run(20)
    ages = rig.telemetry.ages
    assert ages["GLOBAL_POSITION_INT"] < 1.0
    assert ages["ATTITUDE_QUATERNION"] < 1.0
    assert rig.vehicle.starts == 2
    newest = rig.samples[-1]
    assert abs(newest.t_ns - rig.now_ns) < 0.4e9  # on our clock again, although its own has begun anew


def test_a_stream_that_dries_up_is_asked_for_again() -> None:
    rig = Rig().ready()
    rig.run(5)
    rig.sim.reports.intervals.pop("GLOBAL_POSITION_INT")
    rig.run(1)
    assert rig.telemetry.ages["GLOBAL_POSITION_INT"] > 0.9
    rig.run(8)
    assert rig.telemetry.ages["GLOBAL_POSITION_INT"] < 0.3
    assert not rig.of(NoticeKind.REBOOT)


def test_a_stream_that_never_comes_is_not_asked_for_all_the_time() -> None:
    rig = Rig(rates={"RANGEFINDER": 5.0}, step=0.1).ready()
    asked: list[float] = []
    command = rig.sim.execute
    rig.sim.execute = lambda n, p: asked.append(p[0]) or command(n, p)  # type: ignore[method-assign,func-returns-value]
    rig.run(100)
    assert 1 <= asked.count(173.0) <= 2
    assert not rig.of(NoticeKind.COMMAND)


@BOTH
def test_commands_get_through_and_are_answered_once(dialect: str) -> None:
    rig = Rig(dialect, seed=3, link=BAD).ready()
    tickets = [rig.vehicle.set_mode(FlightMode.GUIDED), rig.vehicle.arm(), rig.vehicle.take_off(8.0)]
    assert rig.run(30, lambda: len(rig.of(NoticeKind.COMMAND)) == len(tickets))
    notices = rig.of(NoticeKind.COMMAND)
    assert sorted(n.ticket or 0 for n in notices) == sorted(tickets)
    assert rig.sim.logic.armed


def test_progress_is_waited_for() -> None:
    rig = Rig().ready()
    seen: list[int] = []
    command = rig.sim.execute

    def slow(number: int, p: tuple[float, ...]) -> int:
        if number != 400:
            return command(number, p)
        seen.append(number)
        return 5  # in progress

    rig.sim.execute = slow  # type: ignore[method-assign]
    ticket = rig.vehicle.arm()
    rig.run(20)
    assert len(seen) == 1  # not sent again
    assert not rig.of(NoticeKind.COMMAND)
    rig.sim.send(mavlink.MAVLink_command_ack_message(400, 0, 0, 0, 1, 191))
    assert rig.answered(ticket).ok


def test_an_order_does_not_wait_behind_requests_for_streams() -> None:
    rig = Rig(link={"delay": 0.4}, rates={"RANGEFINDER": 1.0, "VFR_HUD": 1.0, "RAW_IMU": 1.0})
    assert rig.run(3, lambda: rig.ours.vehicle is not None)  # now it requests everything, 0.8 s each
    rig.step()
    start = rig.t
    assert rig.answered(rig.vehicle.set_mode(FlightMode.GUIDED)).ok
    assert rig.t - start < 1.2


def test_the_newest_order_counts() -> None:
    """The first order is lost again and again; after the second one it must not be sent any more."""
    rig = Rig().ready()
    rig.up.loss = 1.0
    rig.vehicle.set_mode(FlightMode.LAND)
    rig.run(1.5)
    rig.vehicle.set_mode(FlightMode.HOLD)
    rig.up.loss = 0.0
    rig.run(8)
    assert rig.sim.logic.doing is Doing.HOLD
    assert not rig.of(NoticeKind.TAKEOVER)


@BOTH
def test_a_pilot_takes_over_and_nothing_of_ours_moves_the_vehicle_any_more(dialect: str) -> None:
    """Our order to land is lost when the pilot switches the mode: its next try must not undo the switch."""
    rig = Rig(dialect)
    rig.up_and_flying(15.0)
    assert rig.vehicle.in_control
    rig.up.loss = 1.0
    rig.vehicle.set_mode(FlightMode.LAND)
    rig.run(0.5)
    rig.sim.pilot()
    flown = rig.t
    assert rig.run(3, lambda: bool(rig.of(NoticeKind.TAKEOVER)))
    assert rig.t - flown < 1.2  # the next heartbeat
    rig.up.loss = 0.0
    rig.run(10)
    assert rig.sim.logic.doing is Doing.PILOT
    (notice,) = rig.of(NoticeKind.TAKEOVER)
    assert notice.mode is FlightMode.PILOT
    assert {"ardupilot": "LOITER", "px4": "POSCTL"}[dialect] in notice.text
    assert not rig.vehicle.in_control
    assert not rig.vehicle.guide(Setpoint(velocity_world=np.ones(3)))
    assert not rig.vehicle.land_on(rig.now_ns, np.array([0.0, 0.0, -5.0]), np.eye(3))
    assert rig.answered(rig.vehicle.set_mode(FlightMode.GUIDED)).ok  # an order of ours takes over again
    assert rig.vehicle.in_control


def test_sticks_that_move_are_a_takeover() -> None:
    rig = Rig()
    rig.up_and_flying(10.0)
    rig.sim.reports.sticks = [1510, 1495, 1130, 1500]  # noise, and a throttle that rests
    rig.run(3)
    assert not rig.of(NoticeKind.TAKEOVER)
    rig.sim.reports.sticks[1] = 1750
    flown = rig.t
    assert rig.run(3, lambda: bool(rig.of(NoticeKind.TAKEOVER)))
    assert rig.t - flown < 0.5
    assert "stick 2" in rig.of(NoticeKind.TAKEOVER)[0].text


@BOTH
def test_a_failsafe_is_a_takeover_too(dialect: str) -> None:
    rig = Rig(dialect)
    rig.up_and_flying(10.0)
    rig.sim.pilot(Doing.RETURN)
    assert rig.run(3, lambda: bool(rig.of(NoticeKind.TAKEOVER)))
    assert rig.of(NoticeKind.TAKEOVER)[0].mode is FlightMode.RETURN


@BOTH
def test_our_own_changes_are_no_takeover_on_a_bad_link(dialect: str) -> None:
    rig = Rig(dialect, seed=8, link={"loss": 0.15, "delay": 0.1, "jitter": 0.3, "double": 0.3})
    rig.up_and_flying(10.0)
    for mode in (FlightMode.HOLD, FlightMode.GUIDED, FlightMode.LAND, FlightMode.HOLD, FlightMode.RETURN):
        rig.vehicle.set_mode(mode)
        rig.run(4)
    assert not rig.of(NoticeKind.TAKEOVER)
    assert not rig.of(NoticeKind.REBOOT)


def test_px4_that_loses_our_setpoints_is_reported() -> None:
    rig = Rig("px4")
    rig.up_and_flying(10.0)
    rig.up.loss = 1.0
    assert rig.run(5, lambda: bool(rig.of(NoticeKind.TAKEOVER)))
    assert rig.of(NoticeKind.TAKEOVER)[0].mode is FlightMode.HOLD


@BOTH
def test_a_link_that_breaks_and_comes_back(dialect: str) -> None:
    rig = Rig(dialect).ready()
    rig.down.loss = 1.0
    assert rig.run(6, lambda: bool(rig.of(NoticeKind.LINK_LOST)))
    assert not rig.vehicle.alive
    rig.down.loss = 0.0
    assert rig.run(3, lambda: bool(rig.of(NoticeKind.LINK_BACK)))
    rig.run(5)
    assert rig.telemetry.ages["GLOBAL_POSITION_INT"] < 0.5


@BOTH
def test_nothing_that_moves_is_sent_after_a_link_was_lost(dialect: str) -> None:
    """A link that stalls delivers all when it is back; a set-point or a mode must not be sent, nor repeated."""
    rig = Rig(dialect)
    rig.up_and_flying(10.0)
    rig.vehicle.guide(Setpoint(np.zeros(3)), EstimateTie(LOCAL, np.zeros(3), rig.telemetry.place))
    rig.vehicle.set_mode(FlightMode.LAND)  # not answered
    rig.up.stalls_until = rig.down.stalls_until = rig.t + 6.0
    assert rig.run(6, lambda: bool(rig.of(NoticeKind.LINK_LOST)))
    assert not rig.vehicle.in_control
    sent: list[mavlink.MAVLink_message] = []
    reader, put = mavlink.MAVLink(None), rig.up.put
    rig.up.put = lambda data, t: (sent.extend(reader.parse_buffer(data) or ()), put(data, t))  # type: ignore[method-assign]
    rig.run(10)
    assert rig.of(NoticeKind.LINK_BACK)
    streams = {f"{m.get_type()} {getattr(m, 'command', '')}" for m in sent}
    assert streams <= {"HEARTBEAT ", "TIMESYNC ", "COMMAND_LONG 511"}


def test_time_outs_wait_for_a_slow_autopilot() -> None:
    """The autopilot runs at a tenth of our speed and answers after 0.4 s: a command is sent once, not four times."""
    rig = Rig(link={"delay": 0.0}).ready()
    rig.run(3)
    seen: list[int] = []
    command = rig.sim.execute
    rig.sim.execute = lambda n, p: seen.append(n) or command(n, p)  # type: ignore[method-assign,func-returns-value]
    step, slowly = rig.sim.step, 0.1
    rig.sim.step = lambda dt: step(dt * slowly)  # type: ignore[method-assign]
    rig.down.delay = 4.0
    rig.run(8.0)
    rig.answered(rig.vehicle.arm(), 30)
    assert seen.count(400) == 1


def test_a_slow_autopilot_is_not_lost() -> None:
    """At a tenth of our speed heartbeats come every ten seconds; other telemetry shows that the autopilot is alive."""
    rig = Rig().ready()
    rig.run(3)
    step = rig.sim.step
    rig.sim.step = lambda dt: step(0.1 * dt)  # type: ignore[method-assign]
    rig.run(25)
    assert not rig.of(NoticeKind.LINK_LOST)
    rig.down.loss = 1.0
    lost = rig.t
    assert rig.run(15, lambda: bool(rig.of(NoticeKind.LINK_LOST)))
    assert rig.t - lost < 5.0


def test_texts_of_the_autopilot_are_passed_on() -> None:
    rig = Rig().ready()
    rig.sim.send(mavlink.MAVLink_statustext_message(2, b"PreArm: Compass not healthy"))
    rig.run(0.2)
    (text,) = rig.of(NoticeKind.TEXT)
    assert (text.text, text.ok) == ("PreArm: Compass not healthy", False)


def test_a_long_text_comes_in_pieces() -> None:
    """A piece may come twice; if one is lost, the rest is passed on with the next text or a little later."""
    rig, long = Rig().ready(), "Preflight Fail: No connection to the ground control station, or none at all by now"

    def send(number: int, *pieces: int) -> None:
        for k in pieces:
            text = (long if number else "over").encode()[50 * k : 50 * (k + 1)]
            rig.sim.send(mavlink.MAVLink_statustext_message(3, text, number, k))
        rig.run(0.2)

    send(7, 0, 0, 1)
    send(8, 0)
    send(0, 0)
    send(9, 0)
    assert [n.text for n in rig.of(NoticeKind.TEXT)] == [long, long[:50], "over"]
    rig.run(1.2)
    assert [n.text for n in rig.of(NoticeKind.TEXT)][3:] == [long[:50]]


def test_positions_of_an_instant() -> None:
    """The autopilot's place is known at our instants, between and just after its reports."""
    rig = Rig(step=0.01).ready()
    start = rig.t

    def fly() -> None:
        rig.sim.vehicle.position = np.array([4.0 * (rig.t - start), -3.0 * (rig.t - start), 30.0])
        rig.sim.vehicle.velocity = np.array([4.0, -3.0, 0.0])

    rig.each_step = fly
    rig.run(6)
    for back in (0.0, 0.25, 1.03, 4.0):
        got = rig.vehicle.place_at(rig.now_ns - round(back * 1e9))
        assert got is not None
        expected = rig.sim.home.degrees(np.array([4.0, -3.0, 0.0]) * (rig.t - start - back) + [0, 0, 30.0])
        assert math.hypot(got.latitude - expected[0], got.longitude - expected[1]) * 111_000 < 0.12
    assert rig.vehicle.place_at(rig.now_ns - 60_000_000_000) is None
    assert rig.vehicle.tie(LOCAL, np.zeros(3), rig.now_ns) is not None


def test_a_setpoint_without_an_alignment_is_refused() -> None:
    rig = Rig().ready()
    with pytest.raises(ValueError, match="one instant"):
        rig.vehicle.guide(Setpoint(np.zeros(3)))
