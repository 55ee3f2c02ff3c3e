"""Fuzzer of the MAVLink protocol machine: messages with arbitrary fields, and arbitrary bytes."""

from __future__ import annotations

import math
import random
import traceback
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import Autopilot, TelemetryEvents

SECOND = 1_000_000_000
HEARD = (
    "HEARTBEAT", "SYSTEM_TIME", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "ATTITUDE_QUATERNION",
    "GPS_RAW_INT", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "SYS_STATUS", "HOME_POSITION", "WIND", "EXTENDED_SYS_STATE",
    "COMMAND_ACK", "STATUSTEXT", "TIMESYNC", "RADIO_STATUS", "BATTERY_STATUS", "VFR_HUD", "AUTOPILOT_VERSION",
)  # fmt: skip
KINDS = [k for k in mavlink.mavlink_map.values() if k.msgname in HEARD]
REALS = (0.0, -0.0, 1.0, -1.0, 1e30, -1e30, 1e-30, math.nan, math.inf, -math.inf)


def _value(draw: random.Random, kind: str) -> Any:
    if kind in ("float", "double"):
        return draw.choice(REALS)
    if kind == "char":
        return draw.choice((b"", b"\xff\xfe", b"<b>", b"x" * 50))
    bits, signed = int("".join(c for c in kind if c.isdigit())), not kind.startswith("u")
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    return draw.choice((0, 1, 2, low, high, draw.randint(low, high)))


def message(draw: random.Random) -> Any:
    """Draw a message of a kind that the protocol machine reads, each field with any value of its type."""
    kind = draw.choice(KINDS)
    values = []
    for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        length = kind.array_lengths[kind.ordered_fieldnames.index(name)]
        one = _value(draw, form)
        values.append([one] * length if length and form != "char" else one)
    return kind(*values)


def trial(seed: int, count: int = 200) -> str | None:
    """Feed an autopilot with messages and damaged bytes; return the traceback, or None."""
    draw = random.Random(seed)
    pilot, now = Autopilot(events=TelemetryEvents()), 0
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    try:
        for _ in range(count):
            now += draw.choice((0, SECOND // 10, SECOND, -SECOND, 40 * SECOND))
            data = bytearray(message(draw).pack(talker))
            if draw.random() < 0.2:
                data[draw.randrange(len(data))] = draw.randrange(256)
            if draw.random() < 0.05:
                del data[draw.randrange(len(data)) :]
            pilot.receive(bytes(data), max(now, 0))
            pilot.tick(max(now, 0))
            pilot.pending(), pilot.samples(), pilot.notices(), pilot.telemetry
    except Exception:
        return traceback.format_exc()
    return None
