"""Commands and their answers: a command is repeated until answered, one command of each kind at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from alight.flight.autopilot.dialect import mavlink
from alight.records import FlightMode

_TRIES = 6
_ANSWER_NS = 1_000_000_000  # until an unanswered command is repeated
_PROGRESS_NS = 30_000_000_000  # until a command that is in progress is treated as lost
RESULTS = {
    mavlink.MAV_RESULT_ACCEPTED: "accepted",
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "refused for now: the autopilot is not in a state for it",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "not supported by this autopilot",
    mavlink.MAV_RESULT_FAILED: "failed",
    6: "cancelled",  # MAV_RESULT_CANCELLED: not in every release of pymavlink
}


@dataclass
class _Command:
    ticket: int
    name: str
    number: int
    parameters: Sequence[float]
    flies: bool  # whether it moves the vehicle: never sent after a takeover
    mode: FlightMode | None
    deadline_ns: int
    tries: int = 0


class CommandAnswer(NamedTuple):
    """The end of a command: accepted, refused or never answered."""

    ticket: int  # of the command
    ok: bool  # whether the command was accepted
    text: str  # name of the command, and its outcome in words
    mode: FlightMode | None  # mode that the command leads to
    refused: bool  # whether the autopilot refused it for good


class CommandQueue:
    """Sends COMMAND_LONG and processes COMMAND_ACK.

    An answer names the kind of command (MAV_CMD) but not its parameters. So one command of each kind is under way at a
    time. Different kinds do not wait for each other: no request for a stream delays the order to land.

    Args:
        send: called with each message to send.
        target: system and component of the vehicle.
    """

    def __init__(self, send: Callable[[Any], None], target: tuple[int, int]) -> None:
        self._send, self._target = send, target
        self._queues: dict[int, deque[_Command]] = {}
        self._tickets = 0

    def submit(
        self, name: str, number: int, parameters: Sequence[float], t_ns: int, *, flies: bool = True,
        mode: FlightMode | None = None, wait_ns: int = 0,
    ) -> int:  # fmt: skip
        """Send a command, or queue it behind a command of its kind; return the ticket that its answer will carry.

        Args:
            name, number: name of the command for its answer, and its MAV_CMD.
            parameters: up to seven parameters; missing ones are 0.
            t_ns: present time; all times here are of the `TimeoutClock`.
            flies: whether the command moves the vehicle; such a command is dropped at a takeover.
            mode: flight mode that the command leads to; None: it changes no mode.
            wait_ns: delay before the command is first sent.
        """
        self._tickets += 1
        queue = self._queues.setdefault(number, deque())
        queue.append(_Command(self._tickets, name, number, parameters, flies, mode, t_ns + wait_ns))
        if len(queue) == 1 and not wait_ns:
            self._transmit(queue[0], t_ns)
        return self._tickets

    def give_up(self, number: int) -> None:
        """Drop all commands whose MAV_CMD is `number`, without an answer."""
        self._queues.pop(number, None)

    def waiting(self, number: int) -> bool:
        """Whether a command whose MAV_CMD is `number` is under way or queued."""
        return bool(self._queues.get(number))

    def waiting_modes(self) -> set[FlightMode]:
        """Return the modes to which the commands under way or queued lead."""
        return {c.mode for queue in self._queues.values() for c in queue if c.mode is not None}

    def drop(self, everything: bool = False) -> None:
        """Drop the commands that move the vehicle or, with `everything`, all commands, without an answer."""
        for number, queue in list(self._queues.items()):
            self._queues[number] = deque(c for c in queue if not (everything or c.flies))

    def on_ack(self, number: int, result: int, t_ns: int) -> Iterator[CommandAnswer]:
        """Yield the answer that a COMMAND_ACK gives to our command; yield nothing while the command is in progress.

        `number`, `result`: MAV_CMD and MAV_RESULT of the COMMAND_ACK.
        """
        queue = self._queues.get(number)
        if not queue or not queue[0].tries:
            return
        if result == mavlink.MAV_RESULT_IN_PROGRESS:
            queue[0].deadline_ns = t_ns + _PROGRESS_NS
            return
        refused = result not in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        text = RESULTS.get(result, f"result {result}")
        yield self._finish(queue, result == mavlink.MAV_RESULT_ACCEPTED, text, t_ns, refused)

    def tick(self, t_ns: int) -> list[CommandAnswer]:
        """Repeat commands that were not answered in time; return a failure for each that is not repeated any more."""
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
        return CommandAnswer(done.ticket, ok, f"{done.name}: {text}", done.mode, refused)

    def _transmit(self, command: _Command, t_ns: int) -> None:
        parameters = [*command.parameters, *[0.0] * (7 - len(command.parameters))]
        self._send(mavlink.MAVLink_command_long_message(*self._target, command.number, command.tries, *parameters))
        command.tries += 1
        command.deadline_ns = t_ns + _ANSWER_NS
