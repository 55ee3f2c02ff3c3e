"""Framing over damaged links: good messages come through, damaged ones do no harm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from autopilot_rig import Rig
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import Autopilot, EstimateTie, Setpoint, TelemetryEvents, metres_between
from alight.flight.autopilot.framing import Framing
from alight.geometry import LocalFrame
from alight.records import FlightMode, NoticeKind, Place

SECOND = 1_000_000_000


def spoken(count: int, system: int = 1, component: int = 1, first: int = 0) -> list[bytes]:
    """Return messages packed by pymavlink."""
    talker = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    out = []
    for k in range(count):
        talker.seq = (first + k) % 256
        out.append(bytes(mavlink.MAVLink_system_time_message(1_000_000 + k, 1000 * k).pack(talker)))
    return out


def stamps(framing: Framing, data: bytes, now_ns: int = 0) -> list[int]:
    return [h.message.time_boot_ms // 1000 for h in framing.decode(data, now_ns) if h.name == "SYSTEM_TIME"]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=60), st.integers(1, 12))
def test_pieces_of_any_length_give_the_same_messages(cuts: list[int], count: int) -> None:
    data, framing, got = b"".join(spoken(count)), Framing(255, 191), []
    for cut in cuts:
        got += stamps(framing, data[:cut])
        data = data[cut:]
    assert got + stamps(framing, data) == list(range(count))


@settings(max_examples=150, deadline=None)
@given(st.lists(st.binary(max_size=60), min_size=4, max_size=4), st.booleans())
@example([b"", b"", b"\xfe\xf7\x00\x00\x00\xca\x00", bytes(13)], False)  # an unknown message by chance
def test_rubbish_between_messages_costs_none_of_them(rubbish: list[bytes], with_markers: bool) -> None:
    """Rubbish may hold markers and claim any length: every good message is out once enough bytes have followed."""
    good, framing = spoken(4), Framing(255, 191)
    pieces = [b"\xfd" * with_markers + r + g for r, g in zip(rubbish, good, strict=True)]
    tail = b"".join(spoken(16, first=4))  # longer than any frame, so that a false header gets all its bytes
    got = stamps(framing, b"".join(pieces) + tail)
    assert got[:4] == [0, 1, 2, 3]


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_wrong_byte_costs_one_message_at_most(data: st.DataObject) -> None:
    stream = bytearray(b"".join(spoken(30)))
    place = data.draw(st.integers(0, len(stream) - 320))
    stream[place] ^= data.draw(st.integers(1, 255))
    got = stamps(Framing(255, 191), bytes(stream))
    assert len(got) >= 29
    assert sorted(set(got)) == got


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=600))
def test_no_bytes_raise_and_nothing_is_believed(data: bytes) -> None:
    ours = Autopilot()
    ours.receive(data, 0)
    ours.tick(0)
    assert ours.vehicle is None


@pytest.mark.parametrize("dialect", ["ardupilot", "px4"])
def test_damage_during_a_flight_harms_nothing(dialect: str) -> None:
    rig = Rig(dialect, seed=4, link={"damage": 0.3, "jitter": 0.05, "double": 0.2})
    rig.up_and_flying(10.0)
    assert rig.down.damaged > 250  # datagrams
    assert not rig.of(NoticeKind.TAKEOVER)
    assert not rig.of(NoticeKind.REBOOT)
    errors = [np.abs(s.position_world).max() for s in rig.samples if s.position_world is not None]
    assert max(errors) < 11.0


def test_version_1_is_understood_and_version_2_is_spoken() -> None:
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    old = bytes(mavlink.MAVLink_system_time_message(5, 7000).pack(talker, force_mavlink1=True))
    assert old[0] == 0xFE
    framing = Framing(3, 191)
    assert stamps(framing, old) == [7]
    sent = framing.encode(mavlink.MAVLink_system_time_message(5, 7000))
    assert sent[0] == 0xFD
    assert (sent[5], sent[6]) == (3, 191)


def test_a_signed_message_is_understood() -> None:
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    talker.signing.secret_key, talker.signing.sign_outgoing = b"k" * 32, True
    signed = bytes(mavlink.MAVLink_system_time_message(5, 7000).pack(talker))
    plain = spoken(1)[0]
    assert len(signed) == len(bytes(mavlink.MAVLink_system_time_message(5, 7000).pack(mavlink.MAVLink(None)))) + 13
    assert stamps(Framing(255, 191), signed + plain) == [7, 0]


def test_an_unknown_message_is_counted_and_left_out() -> None:
    head = bytes([0xFD, 9, 0, 0, 0, 1, 1]) + (54_321).to_bytes(3, "little")
    framing = Framing(255, 191)
    assert stamps(framing, spoken(1)[0] + head + bytes(9) + b"\x12\x34" + spoken(1, first=1)[0]) == [0, 0]


def test_sequence_numbers_wrap_and_what_was_overtaken_is_late() -> None:
    framing = Framing(255, 191)
    a, b, c = spoken(3, first=254)  # 254, 255, 0

    def lateness(data: bytes, now_ns: int = 0) -> list[bool]:
        return [h.late for h in framing.decode(data, now_ns)]

    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    talker.seq = 255
    other = bytes(mavlink.MAVLink_extended_sys_state_message(0, 1).pack(talker))

    assert lateness(a + c) == [False, False]
    assert lateness(b) == [True]
    assert lateness(c) == lateness(b) == []  # copies
    (kept,) = framing.decode(other, 0)
    assert (kept.late, kept.overtaken) == (False, True)  # there is no newer one of its kind
    assert lateness(spoken(1, first=1)[0]) == [False]
    assert lateness(spoken(1, first=100, system=9)[0]) == [False]  # each sender counts for itself
    assert lateness(spoken(1, first=0)[0], 2 * SECOND) == [False]  # a new start


def heartbeat(autopilot: int, kind: int, system: int = 1, component: int = 1, mode: int = 5) -> bytes:
    talker = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(mavlink.MAVLink_heartbeat_message(kind, autopilot, 1, mode, 4, 3).pack(talker))


@pytest.mark.parametrize(
    ("others", "why"),
    [
        (heartbeat(8, 6, 255, 190), "a ground station"),
        (heartbeat(8, 26, 1, 154), "a gimbal of the vehicle"),
        (heartbeat(3, 2, 1, 191), "a companion that calls itself autopilot"),
    ],
)
def test_others_on_the_link_are_not_the_vehicle(others: bytes, why: str) -> None:
    ours = Autopilot()
    ours.receive(others, 0)
    assert ours.vehicle is None, why
    assert not ours.notices()
    ours.receive(heartbeat(12, 2, 7), 0)
    assert ours.vehicle is not None
    assert ours.vehicle.system == 7
    ours.receive(heartbeat(3, 2, 8), 0)  # a second vehicle
    assert ours.vehicle.system == 7


@pytest.mark.parametrize(("autopilot", "kind"), [(3, 1), (12, 20), (4, 2)])
def test_what_is_not_supported_is_refused_in_words_once(autopilot: int, kind: int) -> None:
    ours = Autopilot()
    for _ in range(3):
        ours.receive(heartbeat(autopilot, kind), 0)
    assert ours.vehicle is None
    assert [(n.kind, n.ok) for n in ours.notices()] == [(NoticeKind.FOUND, False)]


def test_a_foreign_ground_station_changes_nothing_of_ours() -> None:
    """Acknowledgements and TIMESYNC answers of another ground station on the link change nothing of ours."""
    rig = Rig()
    assert rig.run(5, lambda: rig.ours.telemetry is not None and rig.ours.telemetry.ready)
    ticket = rig.vehicle.arm()
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def foreign(message: Any) -> None:
        rig.ours.receive(bytes(message.pack(talker)), rig.now_ns)

    foreign(mavlink.MAVLink_command_ack_message(400, 4, 0, 0, 255, 190))
    before = rig.vehicle.clock.ours_ns(0)
    foreign(mavlink.MAVLink_timesync_message(123_456_789, rig.now_ns - 5_000_000))
    assert rig.vehicle.clock.ours_ns(0) == before
    assert not [n for n in rig.ours.notices() if n.kind is NoticeKind.COMMAND and n.ticket == ticket and not n.ok]


HANDLED = (  # messages that are used
    "HEARTBEAT SYS_STATUS SYSTEM_TIME GPS_RAW_INT SCALED_IMU RAW_IMU ATTITUDE ATTITUDE_QUATERNION LOCAL_POSITION_NED "
    "GLOBAL_POSITION_INT RC_CHANNELS HIGHRES_IMU TIMESYNC WIND WIND_COV EKF_STATUS_REPORT ESTIMATOR_STATUS "
    "HOME_POSITION EXTENDED_SYS_STATE STATUSTEXT COMMAND_ACK"
)

ANY_BITS = st.lists(
    st.tuples(st.sampled_from(HANDLED.split()), st.binary(min_size=255, max_size=255)), min_size=1, max_size=8
)

QUIET = {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG"}  # messages that move nothing


def packed(kind: Any, talker: Any, payload: bytes) -> bytes:
    """Return a frame with this payload and a true checksum."""
    head = bytes([0xFD, len(payload), 0, 0, talker.seq, talker.srcSystem, talker.srcComponent])
    frame = head + kind.id.to_bytes(3, "little") + payload
    checksum = mavlink.x25crc(frame[1:] + bytes([kind.crc_extra])).crc
    return frame + checksum.to_bytes(2, "little")


@settings(max_examples=120, deadline=None)
@given(ANY_BITS, st.sampled_from([3, 12]))
def test_whatever_numbers_a_vehicle_sends_nothing_raises(messages: list[tuple[str, bytes]], autopilot: int) -> None:
    """Every field of every message in use may have any value of its bits, NaN included."""
    ours = Autopilot(events=TelemetryEvents())
    ours.receive(heartbeat(autopilot, 2), 0)
    assert ours.vehicle is not None
    asked = ours.vehicle.clock.request(1000)
    ours.vehicle.clock.add_answer(asked, 500, 2000)
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for k, (name, data) in enumerate(messages):
        ours.tick(k * SECOND // 10)
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        talker.seq = (k + 1) % 256
        ours.receive(packed(kind, talker, data[: kind.unpacker.size]), k * SECOND // 10)
        assert ours.telemetry is not None
    assert ours.messages >= 2
    sent = Framing(1, 1).decode(b"".join(ours.pending()), len(messages) * SECOND)
    assert {"HEARTBEAT"} <= {h.name for h in sent} <= QUIET  # never a movement: nobody has ordered one
    assert {h.message.command for h in sent if h.name == "COMMAND_LONG"} <= {511, 512}


HERE = Place(47.6, 13.4, 530.0, 30.0)


def guided(autopilot: int) -> tuple[Autopilot, Any, int]:
    """Return our side of a vehicle that it guides to a place 7 m away, the vehicle's talker, and the time in ns."""
    ours, talker, now = Autopilot(events=TelemetryEvents()), mavlink.MAVLink(None, srcSystem=1, srcComponent=1), 0
    mode = 4 if autopilot == 3 else 6 << 16
    for k in range(12):
        now = k * SECOND // 10
        said = [mavlink.MAVLink_heartbeat_message(2, autopilot, 129, mode, 4, 3)]
        said += [mavlink.MAVLink_global_position_int_message(100 * k, 476000000, 134000000, 530000, 30000, 0, 0, 0, 0)]
        for m in said:
            ours.receive(bytes(m.pack(talker)), now)
            talker.seq = (talker.seq + 1) % 256
        if k == 2:
            assert ours.vehicle is not None
            ours.vehicle.set_mode(FlightMode.GUIDED)
            tie = EstimateTie(LocalFrame(47.6, 13.4, 500.0), np.zeros(3), HERE)
            ours.vehicle.guide(Setpoint(np.array([5.0, 5.0, 0.0]), heading=0.1, speed=2.0), tie)
        ours.tick(now)
    return ours, talker, now


def targets(ours: Autopilot, now: int) -> list[float]:
    """Distance, metres, from where the vehicle was to each place that it is sent to by what is pending."""
    sent = Framing(1, 1).decode(b"".join(ours.pending()), now)
    assert {h.name for h in sent} <= QUIET | {"SET_POSITION_TARGET_GLOBAL_INT"}
    assert {h.message.command for h in sent if h.name == "COMMAND_LONG"} <= {176, 178, 511, 512}
    places = [h.message for h in sent if h.name == "SET_POSITION_TARGET_GLOBAL_INT"]
    return [metres_between(HERE, Place(p.lat_int * 1e-7, p.lon_int * 1e-7, p.alt, 30.0)) for p in places]


@settings(max_examples=80, deadline=None)
@given(ANY_BITS, st.sampled_from([3, 12]))
def test_whatever_a_guided_vehicle_sends_it_is_sent_nowhere_else(
    messages: list[tuple[str, bytes]], autopilot: int
) -> None:
    """As above, while set-points are sent: they stay near the one that was ordered, or end."""
    ours, talker, now = guided(autopilot)
    before = targets(ours, now)
    assert before
    assert max(before) < 15.0
    for name, data in messages:
        now += SECOND // 10
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        ours.receive(packed(kind, talker, data[: kind.unpacker.size]), now)
        talker.seq = (talker.seq + 1) % 256
        ours.tick(now)
    assert max(targets(ours, now), default=0.0) < 15.0
