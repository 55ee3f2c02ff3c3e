"""Commands with their answers: sent again until answered, one at a time of each kind."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from alight.flight.autopilot.pymavlink_dialect import message

_TRIES = 6
_ANSWER_NS = 1_000_000_000  # until a command is sent again
_PROGRESS_NS = 30_000_000_000  # until one that is in progress counts as lost
_NOT_NOW, _IN_PROGRESS = 1, 5
_PARAMETERS = 7
RESULTS = {
    0: "accepted",
    1: "refused for now: the autopilot is not in a state for it",
    2: "denied",
    3: "not supported by this autopilot",
    4: "failed",
    6: "cancelled",
}


@dataclass
class _Command:
    ticket: int
    name: str
    number: int
    parameters: tuple[float, ...]
    flies: bool  # moves the vehicle: never sent after a takeover
    deadline_ns: int = 0
    tries: int = 0


@dataclass(frozen=True)
class CommandAnswer:
    """The end of a command: accepted, refused or never answered."""

    ticket: int
    name: str
    ok: bool
    text: str
    refused: bool = False  # by an answer of the autopilot that no second try will change
    number: int = 0  # of the MAV_CMD


class CommandQueue:
    """COMMAND_LONG out, COMMAND_ACK in.

    An answer names the command and not its parameters. So one of each kind is under way at a time, and the different
    kinds do not wait for each other: no request for a stream delays the order to land.
    """

    def __init__(self, send: Callable[[Any], None]) -> None:
        self._send = send
        self._queues: dict[int, deque[_Command]] = {}
        self._tickets = 0
        self.target = (0, 0)  # system and component

    def submit(
        self, name: str, number: int, parameters: Sequence[float], t_ns: int, flies: bool = True, wait_ns: int = 0
    ) -> int:
        """Send a command, or line it up behind one of its kind.

        Args:
            name: for its answer.
            number: of the MAV_CMD.
            parameters: the first of its seven; the others are 0.
            t_ns: now.
            flies: it moves the vehicle, and is given up at a takeover.
            wait_ns: until it is sent for the first time.

        Returns:
            The ticket that its answer will carry.
        """
        self._tickets += 1
        ticket = self._tickets
        full = (*parameters, *(0.0,) * (_PARAMETERS - len(parameters)))
        queue = self._queues.setdefault(number, deque())
        queue.append(_Command(ticket, name, number, full, flies, t_ns + wait_ns))
        if len(queue) == 1 and not wait_ns:
            self._transmit(queue[0], t_ns)
        return ticket

    def replace(self, name: str, number: int, parameters: Sequence[float], t_ns: int, wait_ns: int = 0) -> int:
        """As `submit`, but commands of its kind that are under way or lined up are given up first."""
        self._queues.pop(number, None)
        return self.submit(name, number, parameters, t_ns, wait_ns=wait_ns)

    def waiting(self, number: int) -> int:
        """The number of commands of a MAV_CMD that are under way or lined up."""
        return len(self._queues.get(number, ()))

    def drop(self, everything: bool = False) -> None:
        """Give up, without an answer, the commands that move the vehicle, or all."""
        for number, queue in list(self._queues.items()):
            left = deque(c for c in queue if not (everything or c.flies))
            self._queues[number] = left

    def hear(self, number: int, result: int, t_ns: int) -> CommandAnswer | None:
        """Take a COMMAND_ACK.

        Args:
            number: of the MAV_CMD.
            result: MAV_RESULT; "in progress" only prolongs the wait.
            t_ns: now.

        Returns:
            The answer to a command of ours that has ended; None: none has.
        """
        queue = self._queues.get(number)
        if not queue or not queue[0].tries:
            return None
        if result == _IN_PROGRESS:
            queue[0].deadline_ns = t_ns + _PROGRESS_NS
            return None
        text = RESULTS.get(result, f"result {result}")
        return self._finish(queue, result == 0, text, t_ns, refused=result not in (0, _NOT_NOW))

    def tick(self, t_ns: int) -> list[CommandAnswer]:
        """Send commands without an answer in time again; return the failure of those that were tried often enough."""
        out = []
        for queue in self._queues.values():
            if queue and t_ns >= queue[0].deadline_ns:
                if queue[0].tries < _TRIES:
                    self._transmit(queue[0], t_ns)
                else:
                    out.append(self._finish(queue, False, f"no answer to {_TRIES} tries", t_ns))
        return out

    def _finish(self, queue: deque[_Command], ok: bool, text: str, t_ns: int, refused: bool = False) -> CommandAnswer:
        done = queue.popleft()
        if queue:
            self._transmit(queue[0], t_ns)
        return CommandAnswer(done.ticket, done.name, ok, f"{done.name}: {text}", refused, done.number)

    def _transmit(self, command: _Command, t_ns: int) -> None:
        system, component = self.target
        fields = {f"param{i + 1}": p for i, p in enumerate(command.parameters)}
        self._send(
            message("COMMAND_LONG", target_system=system, target_component=component, command=command.number,
                    confirmation=command.tries, **fields)
        )  # fmt: skip
        command.tries += 1
        command.deadline_ns = t_ns + _ANSWER_NS
