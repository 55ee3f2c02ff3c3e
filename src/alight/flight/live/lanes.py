"""Makers of the three lanes, called in the lanes' processes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from alight import compiled, terrain
from alight.landing.zones import MapZones
from alight.outputs import FileStore
from alight.pipeline.judging import JudgingLane, JudgingMemory
from alight.pipeline.mapping.recursive_map import RecursiveMapper
from alight.pipeline.navigation import Navigation
from alight.pipeline.navigation.filter_lane import FilterLane, FrameBatch
from alight.pipeline.timing import Timings
from alight.records import Frame, Rig
from alight.settings import StageSettings


class NavigationProcess(FilterLane):
    """The navigation lane: tracker and filter, fed with one batch at a time."""

    def __init__(self, rig: Rig, settings: StageSettings, frame_id: int) -> None:
        super().__init__(rig, settings, history=False, frame_id=frame_id)

    def take(self, batch: FrameBatch) -> Navigation | None:
        """Process a batch and return the result without its pictures; see `FilterLane.take`."""
        found = super().take(batch)
        return None if found is None else replace(found, frame=Frame(found.frame.t_ns, ()))


def make_mapping(rig: Rig, settings: StageSettings, folder: Path) -> RecursiveMapper:
    """Make the mapping lane; map tiles that the vehicle has left behind are stored in a file in `folder`."""
    compiled.load_cached(parallel=True)
    compiled.use_threads(compiled.most_threads())
    return RecursiveMapper(rig, settings, FileStore(folder), Timings(), history=False)


def make_judging(
    settings: StageSettings, appearance: terrain.Model | None, zones: MapZones | None, memory: JudgingMemory
) -> JudgingLane:  # fmt: skip
    """Make the judging lane, with the memory of the lane that it replaces."""
    compiled.load_cached(parallel=True)
    return JudgingLane(settings, appearance, Timings(), memory, zones)
