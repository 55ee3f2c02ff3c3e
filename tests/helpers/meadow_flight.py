"""A tiny simulated flight over the demo's meadow, and its map by true poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from alight.geometry import Camera, Pose
from alight.jobs import InTurn
from alight.pipeline.mapping import FinishedMap
from alight.pipeline.mapping.batch_map import BatchMapper
from alight.pipeline.mapping.recursive_map import RecursiveMapper
from alight.pipeline.navigation.given import GivenLane
from alight.pipeline.timing import Timings
from alight.records import ElevationMap, Event, ImuSample, Rig, RigCamera
from alight.settings import Settings, StageSettings, load_settings
from alight_sim import SimulatedFlight, default_rig, fly

LENS = Camera(160, 120, 120.0, 120.0, 79.3, 59.8)
FORWARD = Pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # optical axis along the nose


def one_camera(body_from_cam: Pose | None = None) -> Rig:
    return Rig((RigCamera("cam0", LENS, body_from_cam or default_rig().cameras[0].body_from_cam),))


@cache
def flight() -> tuple[SimulatedFlight, tuple[Event, ...]]:
    """Flight 40 m over the demo's meadow, 15 m above it, 41 frames of 160 x 120."""
    f = fly("demo", 1, 8.0, rig=one_camera(), rate_hz=5.0, height=15.0)
    return f, tuple(e for e in f.events() if not isinstance(e, ImuSample))


def settings_of(*assignments: str) -> Settings:
    """Coarse and quick settings; P(safe) is low on cells of 0.25 m, and a site and its route are needed anyway."""
    quick = ["parallax.cell=0.25", "tuning.elevation.tile=64", "hazards.p_safe=0.02"]
    return load_settings("", [*quick, *assignments])


@dataclass(frozen=True)
class Mapped:
    """A map by given poses, and the most memory that it held while it was made."""

    found: FinishedMap
    most_bytes: int  # of pixels
    most_keyframes: int

    @property
    def elevation(self) -> ElevationMap:
        assert self.found.snapshot is not None, self.found.reason
        return self.found.snapshot.elevation


def mapped(mapper: BatchMapper | RecursiveMapper, events: tuple[Event, ...] | None = None) -> Mapped:
    """Run navigation and mapping alone, in turn."""
    f, all_events = flight()
    lane, most_bytes, most_keyframes = GivenLane(f.rig, f.truth_trajectory, Settings().motion), 0, 0
    for e in events or all_events:
        navigation = lane.feed(e)
        if navigation is not None:
            mapper.feed(navigation)
        most_bytes = max(most_bytes, mapper.store.bytes)
        most_keyframes = max(most_keyframes, len(mapper.store.keyframes))
    found = mapper.finish(lane.finish(lambda share: None), lambda share: None)
    return Mapped(found, most_bytes, most_keyframes)


def batch_mapper(settings: StageSettings) -> BatchMapper:
    return BatchMapper(flight()[0].rig, settings, None, Timings(), InTurn())
