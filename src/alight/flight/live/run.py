"""A live run from start to end: events in as they come, a folder of results out."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from alight.flight.live.live import Listener, Live, LiveOptions
from alight.landing.zones import MapZones
from alight.outputs import prepare_folder
from alight.outputs.recorder import Recorder, make_room
from alight.pipeline import FlightPolicy
from alight.records import NO_ZONES, AlightError, Event, Frame, Motion, RunResult
from alight.records.codec import FlightHead
from alight.records.map_frame import in_world
from alight.runs import appearance_of, result_of
from alight.settings import Settings
from alight.sources import Source

log = logging.getLogger(__name__)

RECORDING = "recording.mcap"
MOST_CELLS = 2_000_000  # cells of the map of the whole flight


@dataclass(frozen=True)
class LiveRequest:
    """Folder and options of a live run."""

    out: Path  # the folder of the results; the recording goes there while the flight lasts
    settings: Settings
    record: bool = True
    real_time: bool = False  # whether events come from sensors: late events and clock jumps are found by arrival
    overwrite: bool = False
    inputs: Sequence[Path] = ()  # files that the source reads; they may not lie in `out`
    zones: MapZones | None = None  # zones of the user, in the world of the source


def fly_live(
    source: Source, events: Iterator[Event], request: LiveRequest,
    on_health: Callable[[str], None] = lambda line: None, on_motion: Callable[[Motion], None] = lambda motion: None,
) -> RunResult:  # fmt: skip
    """Run the lanes on events as they come, until the events end or Ctrl-C is pressed; return the result.

    Args:
        source: source of the events.
        events: events of the source, each yielded when it is due.
        request: folder and options.
        on_health: called with the state of the lanes as one line, about twice per second.
        on_motion: called with each motion, on the thread of its lane.

    Raises:
        AlightError: the input cannot be used, or the output cannot be written.
    """
    run = LiveRun(source, request, Listener(on_motion))
    try:
        run.live.wait_until_ready()
        reported = time.perf_counter()
        try:
            for event in events:
                run.live.feed(event)
                if isinstance(event, Frame) and time.perf_counter() - reported > 0.5:
                    on_health(run.live.health)
                    reported = time.perf_counter()
        except KeyboardInterrupt:
            run.live.warnings.append("live: ended by Ctrl-C; what was seen until then is judged")
        return run.finish()
    finally:
        run.close()


class LiveRun:
    """The lanes of a live run and their recording. Feed `live`, then call `finish`; call `close` in any case.

    A finished run in the folder is replaced together with its recording. The recording of a run that did not end is
    kept under another name. Raises the errors of `fly_live`.
    """

    def __init__(
        self, source: Source, request: LiveRequest, listener: Listener | None = None, policy: FlightPolicy | None = None
    ) -> None:
        prepare_folder(request.out, request.overwrite, request.inputs)
        self._source, self._settings = source, (settings := for_flight(request.settings))
        zones = NO_ZONES if request.zones is None else request.zones.plane
        head = FlightHead(
            source.name, source.rig, source.local, source.georeferenced, source.imu_noise, settings, zones
        )
        if (kept := make_room(request.out / RECORDING)) is not None:
            log.warning("%s: the recording of a run that did not end is kept as %s", request.out, kept.name)
        self.recorder = Recorder(request.out / RECORDING, head) if request.record else None
        self._listener, self._motions = listener or Listener(), list[Motion]()
        policy = policy or FlightPolicy(min(settings.sites.every, 1))  # as often as the computer can
        options = LiveOptions(
            replace(self._listener, motion=self._keep), self.recorder, folder=request.out,
            appearance=appearance_of(settings), imu=source.imu_noise, real_time=request.real_time, policy=policy,
            zones=request.zones,
        )  # fmt: skip
        self.live = Live(source.rig, settings, options)

    def finish(self) -> RunResult:
        """Wait until all events are processed, judge the map of the whole flight, and end the lanes and the recording.

        Raises:
            AlightError: no image has come, or a lane could not be restarted.
        """
        if not self.live.watch.counts["frames"]:
            raise AlightError(
                f"{self._source.name}: not one image came; see that the camera or the folder gives pictures"
            )
        decision, recorder = self.live.finish(), self.recorder
        decision = replace(decision, motions=tuple(sorted(in_world(self._motions), key=lambda m: m.t_ns)))
        if recorder is not None:
            recorder.decision(decision)
        self.close()
        warnings = [*decision.warnings, *(recorder.warnings if recorder else [])]
        timings = dict(self.live.watch.timings.stages)  # s, of the last steps
        result = result_of(self._source, self._settings, replace(decision, warnings=warnings), timings)
        counts = {**result.counts, **self.live.counts}
        if recorder is not None:
            counts |= {f"recording: messages missing, {why}": n for why, n in recorder.lost.items()}
        return replace(result, counts=counts)

    def _keep(self, motion: Motion) -> None:
        """Keep a motion for the trajectory, at 2 kB."""
        self._motions.append(replace(motion, odometry=None))
        self._listener.motion(motion)

    def close(self) -> None:
        """End the lanes and the recording; further calls have no effect."""
        self.live.close()
        if self.recorder is not None:
            self.recorder.close()


def for_flight(settings: Settings) -> Settings:
    """Return settings that limit the final map to a size that a small computer can judge, at 500 bytes per cell."""
    most = min(settings.elevation.most_cells, MOST_CELLS)
    return settings.model_copy(update={"elevation": settings.elevation.model_copy(update={"most_cells": most})})
