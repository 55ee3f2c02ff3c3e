"""The lane of the filter: its mounting by the kind of recording, its warnings, and its reason for no motion."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from point_flight import RIG

from alight.geometry import Pose
from alight.motion import MotionFilter
from alight.pipeline.lanes import PipelineOptions, navigation_lane
from alight.pipeline.navigation import Trajectory, filter_lane
from alight.pipeline.navigation.filter_lane import FilterLane
from alight.records import Motion, Rig
from alight.settings import FilterSettings, Settings, load_settings


@pytest.mark.parametrize(
    ("kind", "key", "sigma"),
    [("flight", "", 0.0), ("photos", "", None), ("flight", "motion.filter.mounting_sigma=0.01", 0.01)],
)
def test_a_flight_holds_its_mounting(
    monkeypatch: pytest.MonkeyPatch, kind: Literal["flight", "photos"], key: str, sigma: float | None
) -> None:
    """A flight without velocities is no set of photos: its mounting is as calibrated. Photos leave it to their tags."""
    made: list[FilterSettings] = []

    def noted(rig: Rig, settings: FilterSettings, frame_id: int = 0) -> MotionFilter:
        made.append(settings)
        return MotionFilter(rig, settings, frame_id)

    monkeypatch.setattr(filter_lane, "MotionFilter", noted)
    stages = load_settings("", ["motion.method=filter", *([key] if key else [])]).stages()
    navigation_lane(RIG, kind, stages, PipelineOptions())
    assert [s.mounting_sigma for s in made] == [sigma]


@pytest.mark.parametrize(("count", "cause"), [(2, "too few"), (5, "no solution")])
def test_a_flight_that_was_not_smoothed_names_the_cause(count: int, cause: str) -> None:
    lane = FilterLane(RIG, Settings().stages())
    pose = Pose(np.eye(3), np.zeros(3))
    motions = [Motion(k, pose, (pose, pose), np.eye(6)) for k in range(count)]
    (warning,) = lane.warnings(motions, smoothed=False)
    assert "could not be refined together" in warning
    assert cause in warning


def test_no_motion_names_the_attitude() -> None:
    assert "none with an attitude and no way over which the pictures show it" in Trajectory((), RIG).reason
