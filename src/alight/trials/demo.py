"""The demo: a landing in closed loop over simulated ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

from alight.outputs import prepare_folder
from alight.outputs.recorder import Recorder
from alight.pipeline.timing import StageProgress
from alight.records import RunResult
from alight.records.codec import FlightHead
from alight.records.executive import FlightState
from alight.runs import appearance_of, result_of
from alight.settings import Settings
from alight.trials.landing import Trial
from alight_sim.oracle import OracleLander, Touchdown
from alight_sim.steered import SteeredFlight
from alight_sim.steered.touchdown import judge_flight

START = (-4.0, -12.0, 30.0)  # metres east, north, and above the ground


@dataclass(frozen=True, eq=False)
class DemoLanding:
    """The end of the demo's landing, and its touchdown by the simulator's truth."""

    result: RunResult
    state: FlightState
    seconds: float  # length of the landing
    touchdown: Touchdown | None  # by the simulator's truth; None: it did not land

    @property
    def lines(self) -> list[str]:
        """The flight in words, one line per look or change of state; the last line is the touchdown."""
        diary = self.result.diary
        out = [e.line for e in diary.entries] if diary is not None else []
        t = self.touchdown
        if t is None:
            return [*out, f"no touchdown: {self.state.value} after {self.seconds:.0f} s"]
        safe = "safe" if t.safe else f"NOT safe ({', '.join(t.reasons)})"
        shape = f"tilt {math.degrees(t.tilt):.1f} deg, rough {t.roughness:.2f} m"
        return [*out, f"touchdown by the simulator's truth: {safe}; {shape}, {t.sink:.1f} m/s down"]


def fly_demo(
    out: Path, seed: int, settings: Settings, overwrite: bool, progress: StageProgress, recording: Path | None = None
) -> DemoLanding:
    """Land on simulated ground: search, look from lower and lower, and land or give up.

    Args:
        out: folder of the results; it is only prepared, and the caller writes into it.
        seed: seed of the ground and the flight.
        overwrite: whether the folder may hold other files.
        recording: file for a recording of the landing, without its schedule; None: it is not recorded.

    Raises:
        AlightError: the folder or the recording cannot be written.
    """
    prepare_folder(out, overwrite)
    lander = OracleLander.of(settings.lander.model_dump())
    vehicle = SteeredFlight("demo", seed, start=START, radius=lander.reach)
    done, states = [0.0], list(takewhile(lambda state: state is not FlightState.LANDED, FlightState))

    def happening(trial: Trial) -> None:
        if trial.state in states:
            done[0] = max(done[0], states.index(trial.state) / len(states))
        progress(trial.state.value, done[0])

    recorder = None if recording is None else _recorder(recording, vehicle, settings)
    trial = Trial(vehicle, settings, appearance_of(settings), recorder=recorder)
    trial.fly(happening)
    if recorder is not None:
        recorder.close()
    flown = trial.result(map_all=True)
    assert flown.decision is not None
    ended, _ = flown.diary.end or (flown.state, "")
    progress(ended.value, 1.0)
    result = result_of(vehicle, settings, flown.decision, flown.timings)
    notes = {**result.notes, "landing": ended.value}
    result = replace(result, diary=flown.diary, notes=notes, route=None)  # the vehicle is already there
    return DemoLanding(result, ended, flown.seconds, judge_flight(vehicle, lander))


def _recorder(path: Path, vehicle: SteeredFlight, settings: Settings) -> Recorder:
    """Return a recorder of a simulated landing that keeps the map of every verdict."""
    head = FlightHead(vehicle.name, vehicle.rig, vehicle.local, vehicle.georeferenced, vehicle.imu_noise, settings)
    return Recorder(path, head, map_share=math.inf)
