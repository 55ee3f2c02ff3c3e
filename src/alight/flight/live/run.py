"""A live run from its start to its end: events in as they come, a folder of results out."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from alight.flight.live.health import FlightHealth
from alight.flight.live.interface import SILENT, Listener
from alight.flight.live.live import NAVIGATION, Live
from alight.flight.live.stream_clock import Clocks
from alight.outputs import prepare_folder
from alight.outputs.recorder import Recorder, make_room
from alight.pipeline import FlightPolicy, Verdict
from alight.records import AlightError, Event, Frame, Motion, RunResult
from alight.records.codec import FlightHead
from alight.runs import appearance_of, result_of
from alight.settings import Settings
from alight.sources import Source

log = logging.getLogger(__name__)

RECORDING = "recording.mcap"
MOST_CELLS = 2_000_000  # of the map of the whole flight
TELL_EVERY = 0.5  # s between two lines of status

Tell = Callable[[FlightHealth], None]


def fly_live(
    source: Source,
    events: Iterator[Event],
    out: Path,
    settings: Settings,
    record: bool = True,
    real_time: bool = False,
    overwrite: bool = False,
    tell: Tell = lambda health: None,
    listener: Listener = SILENT,
    inputs: Sequence[Path] = (),
) -> RunResult:
    """Run the lanes on events as they come, until there are no more or Ctrl-C is pressed.

    Args:
        source: of the events.
        events: its events, each when it is due.
        out: the folder of the results; the recording goes there while the flight lasts.
        record: make the recording.
        real_time: the events come from sensors: late ones and clocks that jump are found by the time of arrival.
        tell: called with the health of the lanes, about twice a second.
        listener: called with motions and verdicts.
        inputs: files that the source reads; they may not lie in `out`.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written; the message says how to mend it.
    """
    run = LiveRun(source, out, settings, record, real_time, overwrite, listener, inputs)
    try:
        run.live.posts[NAVIGATION].worker.wait_until_ready()
        _feed(run.live, events, tell)
        return run.finish()
    finally:
        run.close()


class LiveRun:
    """The lanes with their recording, from the start to the result. Feed `live`, then `finish`; `close` in any case.

    A recording in the folder is replaced with the finished run that it is of. That of a run that did not end is kept
    under another name.

    Args:
        source, out, settings, record, real_time, overwrite, listener, inputs: as of `fly_live`.
        policy: as of `Live`.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written; the message says how to mend it.
    """

    def __init__(
        self, source: Source, out: Path, settings: Settings, record: bool = True, real_time: bool = False,
        overwrite: bool = False, listener: Listener = SILENT, inputs: Sequence[Path] = (),
        policy: FlightPolicy | None = None,
    ) -> None:  # fmt: skip
        prepare_folder(out, overwrite, inputs)
        self._source, self._settings = source, (settings := for_flight(settings))
        head = FlightHead(source.name, source.rig, source.local, source.georeferenced, source.imu_noise, settings)
        if (kept := make_room(out / RECORDING)) is not None:
            log.warning("%s: the recording of a run that did not end is kept as %s", out, kept.name)
        self.recorder = Recorder(out / RECORDING, head) if record else None
        told = _Told(listener, self.recorder)
        self.live = Live(
            source.rig, settings, told.listener, folder=out, appearance=appearance_of(settings), imu=source.imu_noise,
            diary=self.recorder, clocks=Clocks if real_time else None, policy=policy,
        )  # fmt: skip

    def finish(self) -> RunResult:
        """Wait until all is done, judge the map of the whole flight, and end the lanes and the recording.

        Raises:
            AlightError: no image has come, or a lane could not be started again.
        """
        if not self.live.watch.counts["frames"]:
            raise AlightError(
                f"{self._source.name}: not one image came; see that the camera or the folder gives pictures"
            )
        decision = self.live.finish()
        self.close()
        recorder = self.recorder
        warnings = [*decision.warnings, *(recorder.warnings if recorder else [])]
        result = result_of(self._source, self._settings, replace(decision, warnings=warnings), self.live.timings())
        counts = {**result.counts, **self.live.counts}
        if recorder is not None:
            counts |= {f"recording: messages missing, {why}": n for why, n in recorder.lost.items()}
        return replace(result, counts=counts)

    def close(self) -> None:
        """End the lanes and the recording; a second call has no effect."""
        self.live.close()
        if self.recorder is not None:
            self.recorder.close()


def for_flight(settings: Settings) -> Settings:
    """Limit the map of the whole flight to a size that a small computer can judge at the end: 500 bytes a cell."""
    most = min(settings.elevation.most_cells, MOST_CELLS)
    return settings.model_copy(update={"elevation": settings.elevation.model_copy(update={"most_cells": most})})


def _feed(live: Live, events: Iterator[Event], tell: Tell) -> None:
    said = time.perf_counter()
    try:
        for event in events:
            live.feed(event)
            if isinstance(event, Frame) and time.perf_counter() - said > TELL_EVERY:
                tell(live.health)
                said = time.perf_counter()
    except KeyboardInterrupt:
        live.warnings.append("live: ended by Ctrl-C; what was seen until then is judged")


class _Told:
    """Passes on motions and verdicts, and records them."""

    def __init__(self, listener: Listener, recorder: Recorder | None) -> None:
        self._to, self._recorder = listener, recorder
        self.listener = Listener(self._motion, self._verdict, listener.lost)

    def _motion(self, motion: Motion) -> None:
        if self._recorder is not None:
            self._recorder.motion(motion)
        self._to.motion(motion)

    def _verdict(self, verdict: Verdict, t_ns: int) -> None:
        if self._recorder is not None:
            self._recorder.sites(t_ns, verdict.in_world().sites)
        self._to.verdict(verdict, t_ns)
