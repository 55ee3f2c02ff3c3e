"""Inertial measurements in order of time, as arrays that kernels can read."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

import numpy as np

from alight.arrays import F64, I64
from alight.records import ImuSample

_LONGEST_NS = 60_000_000_000  # ns of samples that are kept when old samples are dropped


class ImuBuffer:
    """The newest inertial samples, in order of time; old samples are dropped from the front."""

    def __init__(self, samples: Iterable[ImuSample] = ()) -> None:
        self._samples = list[ImuSample]()
        self._arrays: tuple[I64, F64] | None = None  # made at the first reading after a change
        for s in samples:
            self.append(s)

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def first_ns(self) -> int:
        """Stamp of the oldest sample, ns."""
        return self._samples[0].t_ns

    @property
    def last_ns(self) -> int:
        """Stamp of the newest sample, ns."""
        return self._samples[-1].t_ns

    @property
    def times(self) -> I64:
        """Stamps of the samples, (M,) ns, ascending."""
        return self._as_arrays()[0]

    @property
    def rates(self) -> F64:
        """Angular velocity [rad/s] and specific force [m/s^2] of the samples in the body frame, (M, 6)."""
        return self._as_arrays()[1]

    def _as_arrays(self) -> tuple[I64, F64]:
        if self._arrays is None:
            rates = [(*s.angular_velocity_body, *s.specific_force_body) for s in self._samples]
            times = np.array([s.t_ns for s in self._samples], np.int64)
            self._arrays = times, np.array(rates, np.float64).reshape(-1, 6)
        return self._arrays

    def mean_rate(self, t_ns: int, half_ns: int) -> F64:
        """Return the mean angular velocity, (3,) rad/s, of samples within `half_ns` of `t_ns`, else of the next one."""
        first = min(int(np.searchsorted(self.times, t_ns - half_ns)), len(self) - 1)
        end = int(np.searchsorted(self.times, t_ns + half_ns, side="right"))
        some = self.rates[first : max(end, first + 1), :3]
        return np.asarray(some.sum(axis=0) / len(some))

    def append(self, sample: ImuSample) -> bool:
        """Add a sample and return whether it was added: it must be finite and newer than all others."""
        if len(self) and sample.t_ns <= self.last_ns:
            return False
        if not (np.isfinite(sample.angular_velocity_body).all() and np.isfinite(sample.specific_force_body).all()):
            return False
        self._samples.append(sample)
        self._arrays = None
        return True

    def forget_before(self, t_ns: int) -> None:
        """Drop the samples before an instant, and samples older than a minute, so that memory stays bounded."""
        if len(self) and (old := bisect_left(self._samples, max(t_ns, self.last_ns - _LONGEST_NS), key=_stamp)):
            del self._samples[:old]
            self._arrays = None


def _stamp(sample: ImuSample) -> int:
    return sample.t_ns
