"""The simulated autopilot behind a UDP socket, in its own thread."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Event as Signal
from threading import Thread
from types import TracebackType
from typing import Any

from alight.records import Event
from alight_sim.autopilot.channel import LossyChannel
from alight_sim.autopilot.simulated import SimulatedAutopilot


class UdpServer:
    """UDP server of the autopilot; a context manager with its own thread.

    Args:
        to: address to which it always sends; it also sends to all senders of the last ten seconds.
        speed: simulated seconds per second of the clock.
        step: length of a step, s.
        outwards, inwards: channels from and to the autopilot; None: without faults.
        after_step: called in the server's thread after every step, with the vehicle's events.
    """

    def __init__(
        self,
        autopilot: SimulatedAutopilot,
        to: tuple[str, int] | None = None,
        speed: float = 1.0,
        step: float = 0.02,
        outwards: LossyChannel | None = None,
        inwards: LossyChannel | None = None,
        after_step: Callable[[Sequence[Event]], None] = lambda events: None,
    ) -> None:
        self.autopilot = autopilot
        self._spoke: dict[Any, float] = {} if to is None else {to: math.inf}  # s, last datagram; `to`: never expires
        self._speed, self._step, self._after_step = speed, step, after_step
        self._outwards, self._inwards = outwards or LossyChannel(), inwards or LossyChannel()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._stop = Signal()
        self.behind = 0.0  # s, largest delay against the clock, on a machine that is too slow
        self._thread = Thread(target=self._run, daemon=True)

    @property
    def port(self) -> int:
        """UDP port of the server itself."""
        return int(self._socket.getsockname()[1])

    def __enter__(self) -> UdpServer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        pace = self._step / self._speed
        due = time.monotonic() + pace
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            while due <= (now := time.monotonic()) and not self._stop.is_set():  # all due steps before it answers
                self.behind = max(self.behind, now - due)
                self._after_step(self.autopilot.step(self._step))
                due += pace
            with suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    data, peer = self._socket.recvfrom(65_535)
                    self._spoke[peer] = max(now, self._spoke.get(peer, now))
                    self._inwards.put(data, now)
            for data in self._inwards.get(now):
                self.autopilot.receive(data)
            for data in self.autopilot.pending():
                self._outwards.put(data, now)
            self._spoke = {peer: t for peer, t in self._spoke.items() if now - t < 10.0}
            for data in self._outwards.get(now):
                for peer in self._spoke:
                    with suppress(BlockingIOError, ConnectionRefusedError):
                        self._socket.sendto(data, peer)
