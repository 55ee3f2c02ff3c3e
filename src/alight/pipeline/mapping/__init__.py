"""The mapping lane: exposures with their motion in, the map out.

There are two ways behind one interface: recursive (flight), and in one batch at the end (recordings, photos).
"""

from __future__ import annotations

from alight.elevation import TileStore
from alight.jobs import Jobs
from alight.pipeline.mapping.lane import FinishedMap, MappingLane, MapSnapshot, MapUpdate, VehiclePosition
from alight.pipeline.timing import Timings
from alight.records import PriorHeights, Rig
from alight.settings import StageSettings

__all__ = ["FinishedMap", "MapSnapshot", "MapUpdate", "MappingLane", "VehiclePosition", "mapping_lane"]


def mapping_lane(
    rig: Rig,
    settings: StageSettings,
    at_end: bool,
    far: TileStore | None,
    timings: Timings,
    history: bool,
    jobs: Jobs,
    prior: PriorHeights | None = None,
) -> MappingLane:
    """Choose the way to map.

    Args:
        at_end: all motions come at the end of the recording.
        far: store of the tiles that the vehicle has left behind; None: memory.
        history: keep the data for the end of a recording; without it there is no end to wait for.
        jobs: matches tiles at the end.
        prior: heights from elsewhere, with which the search at the end begins.
    """
    if not at_end and (settings.parallax.method == "recursive" or not history):  # without an end there is no batch
        from alight.pipeline.mapping.recursive_mapper import RecursiveMapper

        return RecursiveMapper(rig, settings, far, timings, history)
    from alight.pipeline.mapping.batch_mapper import BatchMapper, PhotoMapper

    return (PhotoMapper if at_end else BatchMapper)(rig, settings, far, timings, jobs, prior)
