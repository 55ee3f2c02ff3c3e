"""The autopilot's clock, converted to ours by TIMESYNC; the clock of the time-outs; and the watch over the link."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64

_DRIFT = 50e-6  # 1-sigma of the rate of a crystal
_FLOOR = 0.2e-3  # s, 1-sigma of an exchange without waiting
_JUMP = 0.02  # s, deviation of an answer beyond its round trip above which the clock has jumped
_SILENCE_NS = 1_500_000_000
_BACK_NS = 1_000_000_000  # a clock that goes back by more was restarted
_HEARTBEAT_NS = 3_500_000_000  # longest time without a heartbeat
_SLOW_HEARTBEAT_NS = 1_900_000_000  # also of the autopilot's time: a slow simulation sends one per second of it
_NO_TICK_NS = 1_200_000_000  # longer than a TCP link takes to reopen


@dataclass(frozen=True)
class _Exchange:
    theirs_ns: int
    offset_ns: int  # ours minus theirs
    round_trip: float  # s


class VehicleClock:
    """Converts instants between the autopilot's clock and ours, by the offset and drift that TIMESYNC shows.

    The error of an offset is at most half the round trip of its answer. So answers with short round trips have the
    most weight in the line that is fitted to the offsets.
    """

    def __init__(self) -> None:
        self._requested: deque[int] = deque(maxlen=50)  # stamps of requests that may still be answered
        self._requests, self._request_ns = 0, 0  # number since the autopilot's boot; the newest
        self._exchanges: deque[_Exchange] = deque(maxlen=300)  # a minute
        self._fit: F64 = np.zeros(2)  # offset from the base, s; drift, s/s
        self._base: _Exchange | None = None
        self._doubtful: _Exchange | None = None  # the last exchange, if it contradicts the others
        self.sigma = float("nan")  # s, 1-sigma of an instant converted now

    @property
    def known(self) -> bool:
        """Whether a TIMESYNC answer has come, so that instants can be converted between the clocks."""
        return self._base is not None

    def is_request_due(self, now_ns: int) -> bool:
        """Whether the next TIMESYNC request is due: at 10 Hz for the first ten requests, then at 5 Hz."""
        return not self._requests or now_ns - self._request_ns >= (100_000_000 if self._requests < 10 else 200_000_000)

    def request(self, now_ns: int) -> int:
        """Register a TIMESYNC request sent at `now_ns`, and return its stamp; answers with other stamps are ignored."""
        self._requests, self._request_ns = self._requests + 1, now_ns
        self._requested.append(now_ns)
        return now_ns

    def add_answer(self, requested_ns: int, theirs_ns: int, now_ns: int) -> bool:
        """Process an answer to TIMESYNC. If the autopilot's clock has jumped, the estimate begins anew.

        A jump is accepted when two consecutive answers agree on it, as a single answer may only be late.

        Args:
            requested_ns: our stamp of the request, as the answer repeats it.
            theirs_ns: the autopilot's clock when it answered.
            now_ns: our clock when the answer came.

        Returns:
            False if no request of ours had this stamp, or it was answered before.
        """
        if requested_ns not in self._requested or now_ns < requested_ns:
            return False
        self._requested.remove(requested_ns)
        offset_ns = (requested_ns + now_ns) // 2 - theirs_ns
        exchange = _Exchange(theirs_ns, offset_ns, (now_ns - requested_ns) * 1e-9)
        before, self._doubtful = self._doubtful, None
        if self._jumped(exchange):
            both = 0.0 if before is None else (before.round_trip + exchange.round_trip) / 2  # s
            if before is None or abs(before.offset_ns - exchange.offset_ns) * 1e-9 > _JUMP + both:
                self._doubtful = exchange
                return True
            self._forget()
            self._exchanges.append(before)
        self._exchanges.append(exchange)
        self._update()
        return True

    def restart(self) -> None:
        """Forget all exchanges after a reboot; instants cannot be converted until the next answer."""
        self._forget()
        self._requests = 0

    def _forget(self) -> None:
        self._exchanges.clear()
        self._requested.clear()
        self._base = self._doubtful = None
        self.sigma = float("nan")

    def _jumped(self, new: _Exchange) -> bool:
        if self._base is None:
            return False
        expected_ns = self.ours_ns(new.theirs_ns) - new.theirs_ns
        least = min(e.round_trip for e in self._exchanges)
        return abs(new.offset_ns - expected_ns) * 1e-9 > _JUMP + (new.round_trip + least) / 2 + 5 * self.sigma

    def _update(self) -> None:
        base = self._exchanges[-1]
        t = np.array([(e.theirs_ns - base.theirs_ns) * 1e-9 for e in self._exchanges])
        offset = np.array([(e.offset_ns - base.offset_ns) * 1e-9 for e in self._exchanges])
        trip = np.array([e.round_trip for e in self._exchanges])
        weight = 1.0 / (_FLOOR + (trip - trip.min()) / 2) ** 2
        A = np.stack([np.ones_like(t), t], axis=1)
        information = A.T @ (weight[:, None] * A) + np.diag([0.0, _DRIFT**-2])
        self._fit = np.linalg.solve(information, A.T @ (weight * offset))
        self._base = base
        self.sigma = float(np.hypot(np.sqrt(np.linalg.inv(information)[0, 0]), trip.min() / 4))

    def ours_ns(self, theirs_ns: int) -> int:
        """Convert an instant of the autopilot's clock to our clock.

        Raises:
            ValueError: no TIMESYNC answer has come yet.
        """
        if self._base is None:
            raise ValueError("the autopilot's clock is not known yet")
        dt = (theirs_ns - self._base.theirs_ns) * 1e-9
        return theirs_ns + self._base.offset_ns + round(float(self._fit[0] + self._fit[1] * dt) * 1e9)

    def theirs_ns(self, ours_ns: int) -> int:
        """Convert an instant of our clock to the autopilot's clock; raises like `ours_ns`."""
        start = ours_ns - (0 if self._base is None else self._base.offset_ns)
        return start - (self.ours_ns(start) - ours_ns)  # the drift over the remainder is negligible


class TimeoutClock:
    """Clock for time-outs. It follows the clock of the (simulated) autopilot, or ours while the autopilot is silent."""

    def __init__(self) -> None:
        self.t_ns = 0
        self._boot_ns: int | None = None
        self._counted_ns: int | None = None  # our clock: until when silence has been counted

    def add_stamp(self, boot_ns: int, now_ns: int) -> bool:
        """Process a stamp of the autopilot's clock, received at `now_ns`; return whether the autopilot has rebooted."""
        before, self._counted_ns = self._boot_ns, now_ns + _SILENCE_NS
        if before is None or boot_ns > before:
            self.t_ns += 0 if before is None else boot_ns - before
            self._boot_ns = boot_ns
            return False
        if before - boot_ns > _BACK_NS:
            self._boot_ns = boot_ns
            return True
        return False

    def tick(self, now_ns: int) -> None:
        """Advance the clock at the rate of our clock while the autopilot is silent."""
        if self._counted_ns is None:
            self._counted_ns = now_ns
        self.t_ns += max(now_ns - self._counted_ns, 0)
        self._counted_ns = max(now_ns, self._counted_ns)


class LinkWatch:
    """Detects a lost vehicle: by missing heartbeats in `tick`, and by missing calls of `tick` in `check`."""

    def __init__(self) -> None:
        self.alive = True
        self._heartbeat: tuple[int, int] | None = None  # newest heartbeat, ns of our clock and of the time-outs' clock
        self._ticked_ns: int | None = None
        self._checks = 0  # checks since the last tick

    def on_heartbeat(self, now_ns: int, timeout_ns: int) -> bool:
        """Process a heartbeat; return whether the link was lost before and is back.

        `now_ns`, `timeout_ns`: present time of our clock, and of the `TimeoutClock`.
        """
        self._heartbeat = now_ns, timeout_ns
        back, self.alive = not self.alive, True
        return back

    def tick(self, now_ns: int, timeout_ns: int) -> str:
        """Check the heartbeat; return the reason if the vehicle was lost now, else "". Args: see `on_heartbeat`."""
        self._ticked_ns, self._checks = now_ns, 0
        if self._heartbeat is None:
            return ""
        late = now_ns - self._heartbeat[0] > _HEARTBEAT_NS and timeout_ns - self._heartbeat[1] > _SLOW_HEARTBEAT_NS
        return self._lose("no heartbeat of the vehicle any more") if late else ""

    def check(self, now_ns: int) -> str:
        """Check that another thread calls `tick`; return the reason if the vehicle was lost just now, else ""."""
        self._checks += 1
        return "" if self.has_ticks(now_ns) else self._lose("nobody listens to the link")

    def has_ticks(self, now_ns: int) -> bool:
        """Whether `tick` is still called; True for the first checks without a call, as we may have been suspended."""
        return self._ticked_ns is None or self._checks < 5 or now_ns - self._ticked_ns <= _NO_TICK_NS

    def _lose(self, why: str) -> str:
        lost, self.alive = self.alive, False
        return why if lost else ""
