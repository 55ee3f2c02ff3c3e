"""What an autopilot stores is read over the protocol: parameters, fence, rally points."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from autopilot_rig import HOME, LOCAL, Rig
from length import BOTH, EITHER
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import on_plane
from alight.flight.autopilot.fence import fence_region
from alight.flight.autopilot.onboard import StoredItem
from alight.geometry import LocalFrame
from alight.geometry.zones import Region
from alight.records import InputError
from alight_sim.autopilot.memory import MissionItem, fence_circle, fence_polygon

FENCE, RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
EXCLUSION = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
NAMES = {"ardupilot": ("FS_EKF_ACTION", "WPNAV_ACCEL"), "px4": ("COM_OBL_RC_ACT", "COM_OF_LOSS_T")}
CORNERS = [(-30.0, -20.0), (40.0, -20.0), (40.0, 25.0), (-30.0, 25.0)]
YARD = [*fence_polygon(CORNERS, HOME.degrees, True), *fence_circle((10.0, 5.0), 4.0, HOME.degrees, False)]


def reading(r: Rig, *names: str, fence: list[MissionItem] | None = None) -> Rig:
    """Read all that an autopilot stores."""
    if fence is not None:
        r.sim.memory.plans[FENCE] = fence
    r.ready()
    r.vehicle.onboard.begin(names)
    assert r.run(20.0, lambda: r.vehicle.onboard.over)
    return r


def room(region: Region, points: np.ndarray) -> np.ndarray:
    """Return the distance, (N,) metres, of points to the nearest border; negative where the vehicle must not be."""
    return np.asarray(np.min([z.depth(points) * (1.0 if z.keeps_in else -1.0) for z in region.zones], axis=0))


@BOTH
def test_all_is_read_over_a_bad_link(dialect: str) -> None:
    r = Rig(dialect, link={"loss": 0.15, "delay": 0.05, "jitter": 0.05})
    r.sim.memory.parameters[NAMES[dialect][0]] = -3
    r.sim.memory.plans[RALLY] = [MissionItem(mavlink.MAV_CMD_NAV_RALLY_POINT, 0.0, 47.6, 13.4)]
    onboard = reading(r, *NAMES[dialect], fence=YARD).vehicle.onboard
    values = [r.sim.memory.parameters[n] for n in NAMES[dialect]]
    assert [onboard.parameters[n] for n in NAMES[dialect]] == values
    assert onboard.rally.items is not None
    assert len(onboard.rally.items) == 1
    region = r.vehicle.fence_of(LOCAL)
    assert [z.name for z in region.zones] == ["inclusion polygon 1", "exclusion circle 1"]
    points = np.array([[0.0, 0.0], [10.0, 8.0], [30.0, 0.0], [45.0, 0.0]])
    np.testing.assert_allclose(room(region, points), [11.18 - 4.0, -1.0, 10.0, -5.0], atol=0.05)


@EITHER
def test_what_cannot_be_had_ends_in_seconds_and_with_the_reason(dialect: str) -> None:
    r = Rig(dialect)
    r.ready()
    del r.sim.memory.plans[FENCE]  # this build has no fences
    r.lose("MISSION_REQUEST_LIST", lambda m: m.mission_type == RALLY)
    begin = r.t
    onboard = reading(r, NAMES[dialect][0], "NO_SUCH").vehicle.onboard
    assert r.t - begin < 5.0
    assert "UNSUPPORTED" in onboard.fence.failed
    assert "no answer" in onboard.rally.failed
    assert onboard.unanswered == ["NO_SUCH"]


def test_answers_to_others_and_endless_lists_have_no_effect() -> None:
    r = Rig()
    r.ready()
    r.vehicle.onboard.begin(())
    r.sim.memory.plans[FENCE] = [YARD[0]] * 3000
    r.step()
    for system, component in ((255, 190), (1, 100)):
        r.sim.send(mavlink.MAVLink_mission_count_message(system, component, 0, FENCE))
    assert r.run(5.0, lambda: r.vehicle.onboard.fence.over)
    assert r.vehicle.onboard.fence.failed == "1000 items are read at most"


def test_a_reboot_reads_all_again() -> None:
    r = reading(Rig(), "PLND_STRICT", fence=YARD)
    r.sim.memory.plans[FENCE], r.sim.memory.parameters["PLND_STRICT"] = [], 1
    r.sim.reboot()
    assert r.run(20.0, lambda: r.vehicle.onboard.fence.items == ())
    assert r.run(5.0, lambda: r.vehicle.onboard.parameters == {"PLND_STRICT": 1.0})


@pytest.mark.parametrize(
    ("dialect", "options", "inside"), [("px4", 0, True), ("ardupilot", 0, False), ("ardupilot", 2, True)]
)
def test_two_zones_that_keep_it_in(dialect: str, options: int, inside: bool) -> None:
    """PX4 allows both; ArduPilot what they share, unless FENCE_OPTIONS joins them."""
    r = Rig(dialect)
    r.sim.memory.parameters["FENCE_OPTIONS"] = options
    two = [item for east in (0.0, 30.0) for item in fence_circle((east, 0.0), 20.0, HOME.degrees, True)]
    region = reading(r, *r.ready().vehicle.firmware.fence_parameters, fence=two).vehicle.fence_of(LOCAL)
    assert bool(room(region, np.array([[-5.0, 0.0]]))[0] > 0) is inside
    waist = math.sqrt(20.0**2 - 15.0**2)  # m, where the circles meet
    assert room(region, np.array([[15.0, 0.0]]))[0] == pytest.approx(waist if inside else 5.0, abs=0.05)


def corner(count: float = 4.0, command: int = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION) -> StoredItem:
    return StoredItem(command, count, 47.6, 13.4)


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([corner()] * 3, "inclusion polygon 1 has 3 corners of one kind and 4 are announced"),
        ([corner(2.0)] * 2, "inclusion polygon 1 has 2 corners"),
        ([corner(float("nan"))] * 4, "inclusion polygon 1"),
        ([*[corner()] * 2, *[corner(4.0, EXCLUSION)] * 2], "inclusion polygon 1"),
        ([corner(0.0, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)], "exclusion circle 1 has a radius of 0 m"),
        ([corner(1.0, mavlink.MAV_CMD_NAV_WAYPOINT)], "command 16"),
    ],
)
def test_a_fence_that_is_damaged_is_refused_by_name(items: list[StoredItem], words: str) -> None:
    with pytest.raises(InputError, match=words):
        fence_region(items, LOCAL, False)


@pytest.mark.parametrize("longitude", [13.4, 179.999, -179.999])
def test_the_plane_is_that_of_the_world_near_its_origin(longitude: float) -> None:
    local = LocalFrame(-33.0, longitude, 100.0)
    degrees: Callable[[float, float], StoredItem] = lambda e, n: StoredItem(0, 0.0, *_degrees(local, e, n))  # noqa: E731
    for east, north in ((80.0, -60.0), (-150.0, 150.0)):
        np.testing.assert_allclose(on_plane(local, degrees(east, north)), [east, north], atol=0.02)


def _degrees(local: LocalFrame, east: float, north: float) -> tuple[float, float]:
    latitude, lon, _ = local.to_geodetic([east, north, 0.0])
    return float(latitude), (float(lon) + 180.0) % 360.0 - 180.0
