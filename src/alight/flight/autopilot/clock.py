"""The autopilot's clock: converted to ours by TIMESYNC, and used for time-outs."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from alight.arrays import F64

_WINDOW = 300  # exchanges: a minute
_ASKED = 50  # requests that may still be answered
_DRIFT = 50e-6  # 1-sigma of the rate of a crystal
_FLOOR = 0.2e-3  # s, 1-sigma of an exchange without any waiting
_JUMP = 0.02  # s, deviation of an answer beyond its round trip; a larger one means that the clock has jumped
_SILENCE_NS = 1_500_000_000
_BACK_NS = 1_000_000_000  # a clock that goes back by more was started again


@dataclass(frozen=True)
class _Exchange:
    theirs_ns: int
    offset_ns: int  # ours minus theirs
    round_trip: float  # s


class VehicleClock:
    """Offset and drift of the autopilot's clock against ours, from the round trips of TIMESYNC.

    An answer was sent between request and receipt: its offset is known to half the round trip. The answers with the
    shortest round trips are used; a line through them follows the drift.
    """

    def __init__(self) -> None:
        self._asked: deque[int] = deque(maxlen=_ASKED)
        self._exchanges: deque[_Exchange] = deque(maxlen=_WINDOW)
        self._fit: F64 = np.zeros(2)  # s from the base, s/s
        self._base: _Exchange | None = None
        self._doubtful: _Exchange | None = None  # the last one did not fit the others
        self.sigma = float("nan")  # s, of an instant converted now

    @property
    def known(self) -> bool:
        """True once an answer has come: instants can be converted from one clock to the other."""
        return self._base is not None

    def question(self, now_ns: int) -> int:
        """Return the stamp for a TIMESYNC request; only answers with such a stamp are used."""
        self._asked.append(now_ns)
        return now_ns

    def answer(self, asked_ns: int, theirs_ns: int, now_ns: int) -> bool:
        """Take an answer to TIMESYNC. After a jump of the autopilot's clock the estimate begins anew.

        A jump is accepted when two answers in turn agree on it: a simulated autopilot that had to wait for its machine
        is late once, and catches up.

        Args:
            asked_ns: our stamp, as the answer repeats it.
            theirs_ns: the autopilot's clock when it answered.
            now_ns: our clock when the answer came.

        Returns:
            False: no request of ours had this stamp, or it was answered before.
        """
        if asked_ns not in self._asked or now_ns < asked_ns:
            return False
        self._asked.remove(asked_ns)
        exchange = _Exchange(theirs_ns, (asked_ns + now_ns) // 2 - theirs_ns, (now_ns - asked_ns) * 1e-9)
        before, self._doubtful = self._doubtful, None
        if self._jumped(exchange):
            if before is None or not _agree(before, exchange):
                self._doubtful = exchange
                return True
            self.forget()
            self._exchanges.append(before)
        self._exchanges.append(exchange)
        self._update()
        return True

    def forget(self) -> None:
        """Forget all exchanges, as after a reboot: instants cannot be converted until the next answer."""
        self._exchanges.clear()
        self._asked.clear()
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
        """Convert an instant of the autopilot's clock to ours.

        Raises:
            ValueError: no exchange yet.
        """
        if self._base is None:
            raise ValueError("the autopilot's clock is not known yet")
        dt = (theirs_ns - self._base.theirs_ns) * 1e-9
        return theirs_ns + self._base.offset_ns + round(float(self._fit[0] + self._fit[1] * dt) * 1e9)

    def theirs_ns(self, ours_ns: int) -> int:
        """Convert an instant of our clock to the autopilot's.

        Raises:
            ValueError: no exchange yet.
        """
        if self._base is None:
            raise ValueError("the autopilot's clock is not known yet")
        guess = ours_ns - self._base.offset_ns
        return guess - (self.ours_ns(guess) - ours_ns)  # the drift over the remainder is negligible


def _agree(a: _Exchange, b: _Exchange) -> bool:
    """True if two exchanges have the same offset, within half of both round trips."""
    return abs(a.offset_ns - b.offset_ns) * 1e-9 <= _JUMP + (a.round_trip + b.round_trip) / 2


class Pace:
    """Clock of the time-outs: the autopilot's own, so that a slow simulation gets its time; ours while it is silent."""

    def __init__(self) -> None:
        self.t_ns = 0
        self._boot_ns: int | None = None
        self._counted_ns: int | None = None  # of our clock: until when silence has been counted

    def heard(self, boot_ns: int, now_ns: int) -> bool:
        """Take a stamp of the autopilot's clock; True if it was started again."""
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
        """Let our own time pass where the autopilot's is not heard."""
        if self._counted_ns is None:
            self._counted_ns = now_ns
        self.t_ns += max(now_ns - self._counted_ns, 0)
        self._counted_ns = max(now_ns, self._counted_ns)
