"""Model of a bad link that loses, doubles, delays and reorders datagrams; equal seeds give equal results."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field

import numpy as np


@dataclass
class LossyChannel:
    """One direction of a link; times are seconds of the caller's clock."""

    loss: float = 0.0  # probability
    delay: float = 0.0  # s
    jitter: float = 0.0  # s, uniform, added to the delay: datagrams overtake each other
    double: float = 0.0  # probability of a second copy
    damage: float = 0.0  # probability that a byte of the datagram is wrong
    seed: int = 0
    stalls_until: float = -math.inf  # s, before which nothing arrives; then all comes at once, as over TCP
    damaged: int = field(default=0, init=False)  # number of datagrams with a wrong byte
    _queue: list[tuple[float, int, bytes]] = field(default_factory=list, init=False)
    _count: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def put(self, data: bytes, t: float) -> None:
        """Send a datagram at time `t`, s."""
        for _ in range(1 + int(self._rng.random() < self.double)):
            if self._rng.random() < self.loss:
                continue
            self._count += 1
            due = t + self.delay + self.jitter * self._rng.random()
            heapq.heappush(self._queue, (due, self._count, self._spoiled(data)))

    def get(self, t: float) -> list[bytes]:
        """Remove and return the datagrams that have arrived by time `t` (s), in order of arrival."""
        out = []
        while self._queue and self._queue[0][0] <= t and t >= self.stalls_until:
            out.append(heapq.heappop(self._queue)[2])
        return out

    def _spoiled(self, data: bytes) -> bytes:
        if self._rng.random() >= self.damage:
            return data
        self.damaged += 1
        out = bytearray(data)
        out[int(self._rng.integers(len(out)))] ^= int(self._rng.integers(1, 256))
        return bytes(out)
