"""Somebody on the link who forges what the vehicle sends, replays it, and floods it with rubbish."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from autopilot_rig import LOCAL, Rig
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import EstimateTie, Setpoint
from alight.records import Notice, NoticeKind

M = mavlink
SENDERS = ((1, 1), (1, 1), (1, 1), (1, 191), (7, 1), (255, 190))
ELSEWHERE = (480_000_000, 140_000_000)


def forgeries(draw: random.Random) -> list[Any]:
    """One message of each kind that could take a vehicle away."""
    boot = draw.choice((0, 5_000, 90_000, 2**31))
    status = draw.choice((M.MAV_STATE_ACTIVE, M.MAV_STATE_CRITICAL))
    kind, autopilot = draw.choice(((2, 3), (2, 12), (M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID)))
    return [
        M.MAVLink_heartbeat_message(kind, autopilot, draw.choice((0, 129)), draw.choice((0, 2, 6, 9)), status, 3),
        M.MAVLink_rc_channels_message(boot, 8, *[draw.choice((1000, 2000)) for _ in range(18)], 99),
        M.MAVLink_global_position_int_message(boot, *ELSEWHERE, 900_000, 400_000, 500, 500, 500, 0),
        M.MAVLink_gps_raw_int_message(boot * 1000, 0, *ELSEWHERE, 0, 0, 0, 0, 0, 0),
        M.MAVLink_ekf_status_report_message(0, 9.0, 9.0, 9.0, 9.0, 9.0),
        M.MAVLink_extended_sys_state_message(0, M.MAV_LANDED_STATE_ON_GROUND),
        M.MAVLink_sys_status_message(0, 0, 0, 0, 9000, -1, 0, 0, 0, 0, 0, 0, 0),
        M.MAVLink_home_position_message(*ELSEWHERE, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        M.MAVLink_system_time_message(0, boot),
        M.MAVLink_command_ack_message(draw.choice((176, 400, 511)), draw.choice((0, 4)), 0, 0, 0, 0),
        M.MAVLink_timesync_message(draw.randrange(2**40), draw.randrange(2**40)),
        M.MAVLink_statustext_message(draw.choice((0, 6)), b"Battery Failsafe", draw.randrange(9), draw.randrange(9)),
        M.MAVLink_mission_count_message(1, 191, 60_000),
        M.MAVLink_param_value_message(b"FS_EKF_ACTION", draw.random(), 9, 60_000, draw.randrange(60_000)),
    ]


class HostilePeer:
    """Makes datagrams of every forgery, from several senders, unsigned and wrongly signed, and replays."""

    def __init__(self, seed: int) -> None:
        self._draw = random.Random(seed)
        self._forger = mavlink.MAVLink(None)
        self._forger.signing.secret_key, self._forger.signing.timestamp = b"x" * 32, 2**47
        self._heard: list[bytes] = []

    def hear(self, data: bytes) -> None:
        """Note a datagram of the vehicle, to replay it."""
        self._heard = [*self._heard[-200:], data]

    def datagrams(self, count: int) -> list[bytes]:
        """Return so many datagrams or a few more."""
        out: list[bytes] = []
        while len(out) < count:
            for m in forgeries(self._draw):
                self._forger.srcSystem, self._forger.srcComponent = self._draw.choice(SENDERS)
                self._forger.seq = self._draw.randrange(256)
                self._forger.signing.sign_outgoing = self._draw.random() < 0.5
                out.append(bytes(m.pack(self._forger)))
            out += self._draw.sample(self._heard, min(3, len(self._heard)))
        return out


@dataclass
class Attacked:
    """A flight under attack: what was sent to the vehicle, and what was noticed."""

    sent: list[tuple[float, bytes]] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    dropped: dict[str, int] = field(default_factory=dict)
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def notices_but(self, kind: NoticeKind) -> list[Notice]:
        return [n for n in self.notices if n.kind is not kind]

    def of(self, kind: NoticeKind) -> list[str]:
        return [n.text for n in self.notices if n.kind is kind]


def attacked(key: bytes | None, seed: int, count: int, seconds: float = 4.0) -> Attacked:
    """Fly to a place while `count` hostile datagrams a step of 0.05 s arrive for so many seconds."""
    rig, peer, out = Rig(key=key), HostilePeer(seed), Attacked()
    put_up, put_down = rig.up.put, rig.down.put

    def sent(data: bytes, t: float) -> None:
        out.sent.append((t, data))
        put_up(data, t)

    def overheard(data: bytes, t: float) -> None:
        peer.hear(data)
        put_down(data, t)

    rig.up.put, rig.down.put = sent, overheard  # type: ignore[method-assign]
    rig.up_and_flying(5.0)
    tie = EstimateTie(LOCAL, np.zeros(3), rig.telemetry.place)
    rig.vehicle.guide(Setpoint(np.array([20.0, 0.0, 0.0]), speed=3.0), tie)

    def attack() -> None:
        for data in peer.datagrams(count) if count else ():
            rig.ours.receive(data, rig.now_ns)

    rig.each_step = attack
    rig.run(seconds)
    out.notices, out.dropped, out.position = rig.heard, dict(rig.ours.dropped), rig.truth()
    return out
