"""Inertial measurements in order of time, as arrays that kernels can read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from alight.arrays import F64, I64
from alight.records import ImuSample

_ROOM = 1024  # samples; it doubles when it is full
_LONGEST_NS = 60_000_000_000  # ns of samples that are kept, where old ones are forgotten


class ImuBuffer:
    """The newest samples, in order of time; old ones are forgotten from the front.

    Args:
        samples: to begin with.
    """

    def __init__(self, samples: Iterable[ImuSample] = ()) -> None:
        self._times, self._rates = np.empty(_ROOM, np.int64), np.empty((_ROOM, 6))
        self._first = self._end = 0
        for s in samples:
            self.append(s)

    def __len__(self) -> int:
        return self._end - self._first

    @property
    def first_ns(self) -> int:
        """Stamp of the oldest sample."""
        return int(self._times[self._first])

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample."""
        return int(self._times[self._end - 1])

    @property
    def times(self) -> I64:
        """Stamps of the samples, (M,) ns, ascending."""
        return self._times[self._first : self._end]

    @property
    def rates(self) -> F64:
        """(M, 6) angular velocity [rad/s] and specific force [m/s^2] in the body."""
        return self._rates[self._first : self._end]

    def mean_rate(self, t_ns: int, half_ns: int) -> F64:
        """Return the (3,) rad/s mean angular velocity within `half_ns` of an instant, of one sample at least."""
        first = min(int(np.searchsorted(self.times, t_ns - half_ns)), len(self) - 1)
        end = int(np.searchsorted(self.times, t_ns + half_ns, side="right"))
        some = self.rates[first : max(end, first + 1), :3]
        return np.asarray(some.sum(axis=0) / len(some))

    def append(self, sample: ImuSample) -> bool:
        """Add a sample; False: it is left out, because it is not newer than all others or not finite."""
        if len(self) and sample.t_ns <= self.last_ns:
            return False
        if not (np.isfinite(sample.angular_velocity_body).all() and np.isfinite(sample.specific_force_body).all()):
            return False
        if self._end == len(self._times):
            self._make_room()
        self._times[self._end] = sample.t_ns
        self._rates[self._end, :3], self._rates[self._end, 3:] = (
            sample.angular_velocity_body,
            sample.specific_force_body,
        )
        self._end += 1
        return True

    def forget_before(self, t_ns: int) -> None:
        """Forget the samples before an instant, and those older than a minute: memory stays bounded."""
        t_ns = max(t_ns, self.last_ns - _LONGEST_NS) if len(self) else t_ns
        while self._first < self._end and self._times[self._first] < t_ns:
            self._first += 1

    def _make_room(self) -> None:
        """Move the samples to the front of new arrays: twice as long where less than half is forgotten."""
        n = len(self)
        times, rates = self.times, self.rates
        size = len(self._times) * (2 if 2 * n > len(self._times) else 1)
        self._times, self._rates = np.empty(size, np.int64), np.empty((size, 6))
        self._times[:n], self._rates[:n], self._first, self._end = times, rates, 0, n
