"""The judging lane: who looks, and from where next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from some_run import candidate, elevation, hazards, site

from alight.geometry import Camera, Pose
from alight.pipeline.judging import Verdict, observer
from alight.pipeline.map_frame import MapFrame
from alight.pipeline.mapping import MapSnapshot, VehiclePosition
from alight.records import NextView, Sites, View


def look_down(t_ns: int, cam: int, focal: float) -> View:
    lens = Camera(64, 48, focal, focal, 32.0, 24.0)
    return View(t_ns, cam, np.zeros((48, 64), np.uint8), lens, Pose(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 9.0])))


@pytest.mark.parametrize(("newest", "stereo"), [((0,), False), ((0, 1), True)])
def test_the_observer_is_the_vehicle_with_the_cameras_of_the_newest_instant(
    newest: tuple[int, ...], stereo: bool
) -> None:
    """The instant before had two cameras of another focal length."""
    views = (look_down(1, 0, 300.0), look_down(1, 1, 300.0), *(look_down(2, cam, 500.0) for cam in newest))
    vehicle = VehiclePosition(np.array([1.0, 2.0, 9.0]), 8.0)
    seen = MapSnapshot(0, elevation(), views, vehicle, MapFrame(0, np.zeros(3), np.eye(3)))
    who = observer(seen)
    assert (who.focal, who.stereo, who.height_above_ground) == (500.0, stereo, 8.0)
    np.testing.assert_array_equal(who.position, [1.0, 2.0, 9.0])


def test_the_next_look_is_that_of_the_first_candidate_that_has_one_while_there_is_no_site() -> None:
    blind, seen = replace(candidate(), look=None), candidate(2, 12.0, 6.0)

    def look(found: Sites) -> NextView | None:
        return Verdict(elevation(), None, hazards(), found, MapFrame(0, np.zeros(3), np.eye(3))).look

    assert look(Sites((), "fog", candidates=(blind, seen))) == seen.look
    assert look(Sites((site(),), candidates=(seen,))) is None
    assert look(Sites((), "fog", candidates=(blind,))) is None
