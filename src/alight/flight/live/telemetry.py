"""The autopilot's telemetry as GPS/INS of a live run: a listening thread, and events in order of arrival."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Iterator, Mapping

from alight.flight.autopilot import Autopilot, TelemetryEvents, open_link
from alight.flight.autopilot.interference import counts_text
from alight.flight.autopilot.signing import SigningKey
from alight.flight.live.sight import SightNavigation
from alight.geometry import LocalFrame
from alight.records import Event, InputError, Motion, NavSample
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.live import LiveSource, as_they_arrive

log = logging.getLogger(__name__)

READ = 0.02  # s that a read may wait
PATIENCE = 30.0  # s, longest wait for a position of the autopilot


class TelemetryFeed:
    """Listens to an autopilot, and requests the streams that a flight needs. Stamps are of this machine's steady clock.

    Args:
        link: name of the link: `udp:0.0.0.0:14550`, `tcp:HOST:PORT` or `serial:DEVICE:BAUD`.
        separation: ellipsoidal height minus altitude above the sea, metres; None: as reported by the receiver.
        rates, key, odometry: see `Autopilot`.

    Raises:
        InputError: the link cannot be opened.
    """

    def __init__(
        self, link: str, separation: float | None = None, rates: Mapping[str, float] | None = None,
        key: SigningKey | None = None, odometry: bool = False,
    ) -> None:  # fmt: skip
        self.name = link
        self.link = open_link(link)
        self.events_of = TelemetryEvents(None, separation)
        self.autopilot = Autopilot(rates, self.events_of, key=key, odometry=odometry)
        self.lock = threading.Lock()  # guards the autopilot, which gets orders from several threads
        self._samples: queue.Queue[Event] = queue.Queue()
        self._sending = threading.Lock()  # orders are sent at once, without waiting for the listener
        self._ended, self._located = threading.Event(), False
        self._alive = True  # whether the vehicle was not lost when the listener looked last
        self._trouble = ""  # the newest error of the listener
        threading.Thread(target=self._listen, daemon=True).start()

    def wait_for_position(self) -> LocalFrame:
        """Wait until the autopilot reports a position; return the world frame with its origin there.

        Raises:
            InputError: no position came within `PATIENCE` seconds; the message gives the reason.
        """
        end = time.monotonic() + PATIENCE
        while not self.located:
            if time.monotonic() > end:
                with self.lock:
                    connected = self.autopilot.telemetry is not None
                    dropped = counts_text(self.autopilot.dropped)
                silent = "no heartbeat of an autopilot comes" + (f"; dropped messages: {dropped}" if dropped else "")
                why = self.events_of.missing if connected else silent
                raise InputError(f"{self.name}: no position within {PATIENCE:.0f} s: {why or 'no clock in common yet'}")
            time.sleep(READ)
        assert self.events_of.local is not None
        return self.events_of.local

    @property
    def located(self) -> bool:
        """Whether the autopilot has reported a position."""
        return self._located and self.events_of.local is not None

    def flush(self) -> None:
        """Send pending messages. Call it twenty times per second: it also checks that the listener runs.

        If the listener does not run, the vehicle is treated as lost and nothing is sent: no takeover would be noticed.
        """
        with self.lock:
            deaf = not self.autopilot.has_listener(time.monotonic_ns())
            if deaf:
                self.autopilot.pending()
        if not deaf:
            self._send()

    def _send(self) -> None:
        with self._sending:
            with self.lock:
                out = self.autopilot.pending()
            for datagram in out:
                self.link.write(datagram)

    def events(self) -> Iterator[Event]:
        """Yield rows of GPS/INS and IMU samples as they come, until `close`."""
        while not self._ended.is_set():
            try:
                yield self._samples.get(timeout=READ)
            except queue.Empty:
                continue

    def close(self) -> None:
        """Stop listening, and close the link."""
        self._ended.set()
        self.link.close()

    def _listen(self) -> None:
        """Listen until `close`, despite any error: a flight must not go on without telemetry."""
        try:
            while not self._ended.is_set():
                try:
                    self._receive()
                except Exception as e:  # logged once if it repeats
                    if repr(e) != self._trouble:
                        self._trouble = repr(e)
                        log.error("%s: %r while listening; going on", self.name, e, exc_info=e)
                    time.sleep(READ)
        finally:
            if not self._ended.is_set():
                log.error("%s: the listener has ended; nothing is received any more", self.name)

    def _receive(self) -> None:
        datagrams = self.link.read(READ)
        with self.lock:
            for data in datagrams:
                self.autopilot.receive(data, time.monotonic_ns())
            self.autopilot.tick(time.monotonic_ns())
            samples = self.autopilot.samples()
            was_alive, self._alive = self._alive, self.autopilot.vehicle is None or self.autopilot.vehicle.alive
        if was_alive and not self._alive:
            self.link.reopen()
        self._send()
        for sample in samples:
            self._located |= isinstance(sample, NavSample) and sample.position_world is not None
            if self._located:
                self._samples.put(sample)


def with_telemetry(
    opened: LiveSource, link: str, separation: float | None = None, key: SigningKey | None = None,
    odometry: bool = False,
) -> LiveSource:  # fmt: skip
    """Combine a source of pictures with an autopilot's GPS/INS; the world's origin is the autopilot's position.

    `link`, `separation`, `key`, `odometry`: see `TelemetryFeed`.

    Raises:
        InputError: the source is a recording, or the autopilot gives no position.
    """
    source = opened.source
    if not isinstance(source, CalibratedFolder) or not opened.real_time:
        raise InputError(f"{source.name}: has a clock of its own; --telemetry goes with cameras and folders that fill")
    feed = TelemetryFeed(link, separation, key=key, odometry=odometry)
    try:
        source.locate(feed.wait_for_position())
    except InputError:
        feed.close()
        raise

    def events() -> Iterator[Event]:
        try:
            yield from as_they_arrive(opened.events, feed.events())
        finally:
            feed.close()

    vehicle = feed.autopilot.vehicle
    if not odometry or vehicle is None:
        return LiveSource(source, events(), True, lambda: feed.autopilot.telemetry)
    sight = SightNavigation(vehicle, vehicle, lambda lane, words: log.warning("%s: %s", lane, words))

    def on_motion(motion: Motion) -> None:
        with feed.lock:
            for notice in feed.autopilot.notices():
                sight.on_notice(notice)
            sight.on_motion(motion, time.monotonic_ns())
        feed.flush()

    return LiveSource(source, events(), True, lambda: feed.autopilot.telemetry, on_motion)
