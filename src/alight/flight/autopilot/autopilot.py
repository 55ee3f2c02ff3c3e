"""The protocol machine: bytes in; bytes, telemetry and notices out. No socket, no thread, and no clock."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.firmware import FIRMWARES, HOVERS
from alight.flight.autopilot.framing import Framing, ReceivedMessage
from alight.flight.autopilot.interference import Allowance, Interference
from alight.flight.autopilot.remote_vehicle import RemoteVehicle
from alight.flight.autopilot.signing import SigningKey
from alight.records import ImuSample, NavSample, Notice, NoticeKind, Telemetry

_NOTICES = 20.0  # a second and kind; a text more often is read by nobody


class TelemetryReader(Protocol):
    """Interface of a reader of a vehicle's messages, such as `TelemetryEvents`."""

    starts: int  # number of the autopilot's boot that the messages belong to
    by_sight: bool  # whether the autopilot's position and velocity come from our odometry

    def restart(self, starts: int) -> None:
        """Begin anew after a reboot of the autopilot; `starts` is the number of its boots so far."""

    def feed(self, name: str, message: Any, clock: VehicleClock) -> Sequence[NavSample | ImuSample]:
        """Process a message of the type `name`; return the samples that are now complete, in order of time.

        `clock` converts the message's stamps to our clock.
        """


class Autopilot:
    """One vehicle over MAVLink 2: ArduPilot's Copter or PX4's multicopter.

    Pass the bytes of a link to `receive`, and call `tick` at 10 Hz or more. Send the datagrams of `pending`, and read
    `notices`, `samples` and `telemetry`. All times are of one monotonic clock of ours, in nanoseconds.

    The vehicle is the first autopilot that sends a heartbeat. Messages of other senders are ignored. Without a key,
    whoever uses the vehicle's identity is taken for it, but is noticed.

    Args:
        rates: Hz of further streams, or non-default rates of default streams, by message; 0: not requested.
        events: maker of GPS/INS rows and IMU samples from the telemetry; None: no samples are made.
        component: our component number on the link.
        key: signs what is sent; messages without its signature are dropped. None: nothing is signed.
        odometry: whether to request the further messages that sending odometry needs.
    """

    def __init__(
        self,
        rates: Mapping[str, float] | None = None,
        events: TelemetryReader | None = None,
        component: int = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER,
        key: SigningKey | None = None,
        odometry: bool = False,
    ) -> None:
        self._framing = Framing(1, component, key)
        self._component, self._events, self._rates = component, events, dict(rates or {})
        self.odometry = odometry  # whether odometry is sent
        self._out: list[bytes] = []
        self._notices: list[Notice] = []
        self._samples: list[NavSample | ImuSample] = []
        self._allowances = defaultdict[NoticeKind, Allowance](lambda: Allowance(_NOTICES))
        self._refused: set[int] = set()
        self._interference = Interference((0, 0))
        self._heartbeat_ns: int | None = None
        self._now_ns = 0
        self.vehicle: RemoteVehicle | None = None  # receiver of the orders; None: no heartbeat yet

    @property
    def telemetry(self) -> Telemetry | None:
        """Snapshot of everything received from the vehicle so far; None: no vehicle yet."""
        return None if self.vehicle is None else self.vehicle.telemetry

    @property
    def messages(self) -> int:
        """Number of messages received since the link was opened, from any sender."""
        return self._framing.messages

    @property
    def dropped(self) -> Counter[str]:
        """Number of messages dropped since the link was opened, by reason: forged, replayed, or too many."""
        return self._framing.dropped

    def pending(self) -> list[bytes]:
        """Return the datagrams to send; each datagram is returned only once."""
        out, self._out = self._out, []
        return out

    def notices(self) -> list[Notice]:
        """Return the vehicle's changes of state and answers to our commands since the last call."""
        out, self._notices = self._notices, []
        return out

    def samples(self) -> list[NavSample | ImuSample]:
        """Return the GPS/INS rows and IMU samples since the last call."""
        out, self._samples = self._samples, []
        return out

    def tick(self, now_ns: int) -> None:
        """Send what is due now: heartbeats, requests, retries.

        Args:
            now_ns: present time of our clock, never less than before.
        """
        self._now_ns = max(now_ns, self._now_ns)
        if self._heartbeat_ns is None or self._now_ns - self._heartbeat_ns >= 1_000_000_000:
            self._heartbeat_ns = self._now_ns
            kind, invalid = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
            self._send(mavlink.MAVLink_heartbeat_message(kind, invalid, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))
        for line in self._interference.reports(self.dropped, self._now_ns):
            self._note(NoticeKind.INTERFERENCE, line, ok=False)
        if self.vehicle is not None:
            self.vehicle.tick(self._now_ns)

    def has_listener(self, now_ns: int) -> bool:
        """Whether another thread still calls `tick`; call this on the thread that sends orders.

        Args:
            now_ns: present time of the clock passed to `tick`.

        Returns:
            False if `tick` was not called for more than a second, during several calls of this method. The vehicle is
            then treated as lost, and no order may be sent.
        """
        self._now_ns = max(now_ns, self._now_ns)
        return self.vehicle is None or self.vehicle.has_listener(self._now_ns)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Process bytes received at `now_ns`, in pieces of any length; no content raises an exception."""
        self._now_ns = max(now_ns, self._now_ns)
        for received in self._framing.decode(data, now_ns):
            if received.component != mavlink.MAV_COMP_ID_AUTOPILOT1:
                continue
            if self.vehicle is None and received.name == "HEARTBEAT":
                self.vehicle = self._vehicle_of(received)
            vehicle, events = self.vehicle, self._events
            if vehicle is None or received.system != vehicle.system:
                continue
            if received.clash:
                self._interference.on_clash(self._now_ns)
            if received.name == "HEARTBEAT" and not self._interference.is_of_vehicle(received.message):
                continue
            if vehicle.on_message(received, self._now_ns) and events is not None:
                if vehicle.starts > events.starts:
                    events.restart(vehicle.starts)
                events.by_sight = vehicle.odometry.in_use
                self._samples += events.feed(received.name, received.message, vehicle.clock)

    def _vehicle_of(self, heartbeat: ReceivedMessage) -> RemoteVehicle | None:
        m, system = heartbeat.message, heartbeat.system
        if m.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return None
        firmware = FIRMWARES.get(m.autopilot)
        if firmware is None or m.type not in HOVERS:
            if system not in self._refused:
                self._refused.add(system)
                what = "autopilot" if firmware is None else "kind of vehicle"
                text = f"system {system}: this {what} is not supported (ArduPilot's Copter, PX4's multicopter)"
                self._note(NoticeKind.FOUND, text, ok=False)
            return None
        self._framing.set_sender(system, self._component)
        self._interference = Interference((m.autopilot, m.type))
        self._note(NoticeKind.FOUND, f"{firmware.name}, system {system}")
        rates = {**(firmware.odometry_rates if self.odometry else {}), **self._rates}
        return RemoteVehicle(heartbeat, firmware(), (system, self._component), rates, self._send, self._note)

    def _send(self, outgoing: Any) -> None:
        self._out.append(self._framing.encode(outgoing))

    def _note(self, kind: NoticeKind, text: str, ok: bool = True, **more: Any) -> None:
        if self._allowances[kind].admits(self._now_ns):
            self._notices.append(Notice(self._now_ns, kind, text, ok, **more))
