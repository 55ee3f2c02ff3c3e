"""Streams with a clock of their own, and their values at other times."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from alight.arrays import F64, I64, Mask
from alight.sources.streams import rising

GAP = 0.5  # s, longest interval between two rows that is interpolated


@dataclass(frozen=True, eq=False)
class LoggedStream:
    """One stream of a log, one row per time; NaN: not measured."""

    name: str = ""  # name of its messages
    t_ns: I64 = field(default_factory=lambda: np.empty(0, np.int64))  # (N,) autopilot's clock
    values: F64 = field(default_factory=lambda: np.empty((0, 0)))  # (N, D)

    @classmethod
    def of(cls, name: str, t_ns: I64, *columns: F64) -> LoggedStream:
        """Make the stream called `name` from times (N,), ns, and columns (N,) of values."""
        return cls(name, np.asarray(t_ns, np.int64), np.stack([np.asarray(c, np.float64) for c in columns], axis=-1))

    def where(self, keep: Mask) -> LoggedStream:
        """Return the stream of the rows at which the mask `keep` (N,) is true."""
        return LoggedStream(self.name, self.t_ns[keep], self.values[keep])

    @property
    def in_order(self) -> LoggedStream:
        """The stream of the finite rows with rising times. A single wrong time does not remove the rows after it."""
        rows = self.where(np.asarray(np.isfinite(self.values).all(axis=1)))
        if (np.diff(rows.t_ns) > 0).all():
            return rows
        return rows.where(np.array(rising(rows.t_ns.tolist()), bool))

    def at(self, t_ns: I64) -> F64:
        """Return the values (M, D) interpolated at `t_ns` (M,); NaN where no row is near. Rows must be in order."""
        if not len(self.t_ns):
            return np.full((len(t_ns), self.values.shape[1]), np.nan)
        near, seconds, own = _covered(self.t_ns, t_ns), _seconds(t_ns, self.t_ns[0]), _seconds(self.t_ns, self.t_ns[0])
        found = np.stack([np.interp(seconds, own, column) for column in self.values.T], axis=-1)
        return np.where(near[:, None], found, np.nan)


def attitude_at(attitude: LoggedStream, t_ns: I64) -> F64:
    """Return the quaternions w, x, y, z at times `t_ns`, (M, 4), by spherical interpolation; NaN where no row is near.

    Rows must be in order; at the time of a row its own quaternion is returned.
    """
    usable = attitude.where(np.abs(np.linalg.norm(attitude.values, axis=1) - 1.0) < 0.05)
    out = np.full((len(t_ns), 4), np.nan)
    if len(usable.t_ns) < 2:
        return out
    near, origin = _covered(usable.t_ns, t_ns), usable.t_ns[0]
    if near.any():
        turning = Slerp(_seconds(usable.t_ns, origin), Rotation.from_quat(np.roll(usable.values, -1, axis=1)))
        out[near] = np.roll(turning(_seconds(t_ns[near], origin)).as_quat(), 1, axis=1)
    _, own, at = np.intersect1d(usable.t_ns, t_ns, return_indices=True)
    out[at] = usable.values[own]
    return out


def _covered(own: I64, t_ns: I64) -> Mask:
    """Return a mask (M,) of the `t_ns` that lie between two neighbours of `own`, (N,) ns, at most `GAP` s apart."""
    after = np.searchsorted(own, t_ns).clip(1, len(own) - 1) if len(own) > 1 else np.zeros(len(t_ns), np.intp)
    gap = own[after] - own[np.maximum(after - 1, 0)]
    return np.asarray((t_ns >= own[0]) & (t_ns <= own[-1]) & (gap <= GAP * 1e9))


def _seconds(t_ns: I64, origin: int) -> F64:
    return np.asarray((t_ns - origin).astype(np.float64) * 1e-9)
