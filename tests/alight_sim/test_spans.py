"""Spans: their curve, their share of pixels, parallax, shadow and occlusion in closed form; strikes of the oracle."""

import math

import numpy as np
import pytest

from alight.geometry import Camera, Grid, Pose
from alight.records import Terrain
from alight_sim import fly, world_of, write
from alight_sim.cameras import Eye, Shutter
from alight_sim.light import Light
from alight_sim.oracle import OracleLander, judge_touchdown, safe_places
from alight_sim.point_mass import Wanted
from alight_sim.scene import parse_scene
from alight_sim.scene_world import build
from alight_sim.spans import TrueSpans
from alight_sim.steered import SteeredFlight
from alight_sim.steered.touchdown import judge_flight
from alight_sim.truth import TrueFootprint

CELL, HALF = 0.1, 300  # metres, cells on either side of the middle
GRID = Grid(-HALF * CELL, HALF * CELL, CELL, 2 * HALF + 1, 2 * HALF + 1)
EAST, NORTH = np.meshgrid(*GRID.xy())
LENS = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
CLEAR = {"visibility": 1e9}
SKY_ALONE = Light(sun=0.0, **CLEAR)
DOWN = np.diag([1.0, -1.0, -1.0])  # image up is north


def wire(start, end, diameter=0.02, sag=0.0, colour=(0.0, 0.0, 0.0)):
    return TrueSpans.of(np.array([start], float), np.array([end], float), sag=sag, diameter=diameter, colour=colour)


def covered(spans, pose, height=0.0, light=SKY_ALONE, lens=LENS, shutter=None):
    """Share of the light of each pixel, mean of the colours, that black spans and their shadows take away."""
    eye, surface = Eye(lens), np.broadcast_to(np.float32(height), GRID.shape)
    pictures = [
        eye.radiance(world_of(GRID, surface, light=light, spans=s), pose, 0.0, shutter).astype(float)
        for s in (None, spans)
    ]
    return (1.0 - pictures[1] / pictures[0]).mean(axis=2)


def centroids(share, axis=1):
    """Centre of the covered share of each row (axis 1) or column (axis 0)."""
    at = np.arange(share.shape[axis])
    return (share * (at if axis == 1 else at[:, None])).sum(axis=axis) / share.sum(axis=axis)


# -- the curve


def test_a_span_hangs_by_its_sag_and_follows_the_catenary():
    span = wire((0, 0, 9), (30, 40, 12), sag=2.0)
    number, ends = span.pieces(0.25)
    assert len(number) == math.ceil(math.dist((0, 0, 9), (30, 40, 12)) / 0.25)
    assert ends[1:, 0] == pytest.approx(ends[:-1, 1])
    assert ends[[0, -1], [0, 1]] == pytest.approx(np.array([[0, 0, 9], [30, 40, 12]], float))
    assert span.at(np.array([0]), np.array([0.5]))[0] == pytest.approx([15, 20, 8.5])
    level = wire((0, 0, 9), (40, 0, 9), sag=4.0)
    a = 51.0  # metres: parameter of the catenary of this length and sag
    for _ in range(50):
        a = 20.0 / math.acosh(1.0 + 4.0 / a)
    x = np.linspace(-20.0, 20.0, 41)
    catenary = 5.0 + a * (np.cosh(x / a) - 1.0)
    assert np.abs(level.at(np.zeros(41, int), (x + 20.0) / 40.0)[:, 2] - catenary).max() < 0.01 * 4.0


def test_a_cylinder_and_a_span_touch_where_they_overlap():
    span = wire((-10, 0, 5), (10, 0, 5), sag=1.0)
    assert span.highest(0.0, 0.5, 0.6, 3.0, 4.2) == pytest.approx(4.0, abs=0.01)
    assert span.highest(0.0, 0.7, 0.6, 3.0, 4.2) == -math.inf  # beside it
    assert span.highest(0.0, 0.0, 0.6, 4.1, 6.0) == -math.inf  # under it
    assert span.aside(np.array([[0.0, 3.0], [12.0, 0.0]]))[:, 0] == pytest.approx([2.99, 1.99])
    mask = span.over(GRID, 1.5)
    assert (mask == (span.aside(np.stack([EAST, NORTH], -1))[..., 0] <= 1.5)).all()


# -- pictures


@pytest.mark.parametrize("diameter", [0.004, 0.02, 0.3])
@pytest.mark.parametrize("turn", [0.0, 0.3, math.pi / 4, 1.2])
def test_the_covered_shares_add_up_to_width_times_length(diameter, turn):
    way = 2.5 * np.array([math.cos(turn), math.sin(turn), 0.0])
    span = wire(np.array([0.03, 0.02, 8.0]) - way, np.array([0.03, 0.02, 8.0]) + way, diameter)
    share = covered(span, Pose(DOWN, np.array([0.0, 0.0, 18.0])))
    scale = 150.0 / 10.0  # pixels a metre at the wire
    assert share.sum() == pytest.approx(diameter * scale * 5.0 * scale, rel=0.01)
    assert share.max() <= 1.0
    if diameter < 0.01:  # a wire of a 17th of a pixel darkens by no more than that
        assert share.max() < 1.5 * diameter * scale


def test_a_wire_moves_between_two_cameras_by_its_own_disparity():
    span = wire((-6.7, -20, 9), (7.3, 20, 9), 0.03)  # askew: the phases of all rows average out
    left, right = (centroids(covered(span, Pose(DOWN, np.array([e, 0.0, 36.0])))) for e in (0.0, 0.4))
    assert (left - right).mean() == pytest.approx(150.0 * 0.4 / 27.0, abs=0.02)
    assert np.abs(left - right - 150.0 * 0.4 / 27.0).max() < 0.7


def test_a_rolling_shutter_bends_a_wire_and_a_long_exposure_smears_it():
    span = wire((-7, -20, 9), (7, 20, 9), 0.03)

    def poses(seconds):
        places = np.column_stack([5.0 * seconds, 0.0 * seconds, 36.0 + 0.0 * seconds])
        return np.repeat(DOWN[None], len(seconds), axis=0), places

    still, rolling = (centroids(covered(span, poses, shutter=Shutter(line_time=t))) for t in (0.0, 2e-3))
    slope = np.polyfit(np.arange(120), rolling - still, 1)[0]
    assert slope == pytest.approx(-150.0 * 5.0 * 2e-3 / 27.0, rel=0.02)
    still, smeared = (covered(span, poses, shutter=Shutter(exposure=x, moments=8)) for x in (0.0, 0.2))
    assert smeared.sum() == pytest.approx(still.sum(), rel=0.1)  # weighted by the ground that it hides
    assert smeared.max() < 0.4 * still.max()


def test_a_lens_with_distortion_bends_a_wire_as_it_does_its_points():
    lens = Camera(160, 120, 150.0, 150.0, 79.5, 59.5, "radial-tangential", (-0.2, 0.05, 0.0, 0.0))
    span = wire((-20, 3.0, 9), (20, 3.0, 9), 0.1)
    got = centroids(covered(span, Pose(DOWN, np.array([0.0, 0.0, 19.0])), lens=lens), axis=0)
    x = np.linspace(-8.0, 8.0, 2001)
    truly = lens.project(np.column_stack([x, np.full(2001, -3.0), np.full(2001, 10.0)]))
    off = (got - np.interp(np.arange(160), *truly.T))[5:-5]
    assert np.abs(off).max() < 0.1  # a pixel's share of it does not tell where in the pixel it is
    assert abs(off.mean()) < 0.02


def test_a_roof_hides_a_wire_under_it():
    roof = np.where(EAST > 1.0, 5.0, 0.0)
    share = covered(wire((-10, 0.03, 3), (10, 0.03, 3), 0.1), Pose(DOWN, np.array([0.0, 0.0, 20.0])), roof)
    edge = 79.5 + 150.0 * 1.0 / 15.0  # of the roof, nearer to the camera than the wire
    assert share[:, : int(edge) - 1].max(axis=0).min() > 0.3
    assert np.abs(share[:, int(edge) + 2 :]).max() < 1e-6


@pytest.mark.parametrize(("azimuth", "elevation"), [(90.0, 45.0), (250.0, 30.0)])
def test_the_shadow_lies_away_from_the_sun_and_is_weak(azimuth, elevation):
    """Seen from under the wire. A wire of 2 cm takes 2 cm of a sun whose disc is as wide as many of them."""
    light = Light(azimuth_deg=azimuth, elevation_deg=elevation, **CLEAR)
    sun = light.sun_at(0.0)
    place = -9.0 * sun.direction[0] / sun.direction[2]  # where the wire's shadow meets the ground
    share = covered(wire((0, -40, 9), (0, 40, 9)), Pose(DOWN, np.array([place, 0.0, 5.0])), light=light)
    assert centroids(share) == pytest.approx(np.full(120, 79.5), abs=0.1)
    direct = np.array(sun.colour) * math.sin(sun.elevation)
    most = (direct / (direct + np.array(sun.sky))).mean()
    flat = sun.direction[0] / sun.direction[2]
    width = 0.02 * math.hypot(1.0, flat)  # of the shadow on level ground
    assert share.sum(axis=1).mean() / 30.0 == pytest.approx(most * width, rel=0.05)
    disc = math.radians(0.53) * 9.0 / sun.direction[2] * math.hypot(1.0, flat)
    assert share.max() == pytest.approx(most * width / disc, rel=0.25)
    assert share.max() < 0.25


def test_a_shadow_is_as_weak_as_the_sun_under_a_cloud():
    span, pose = wire((0, -40, 9), (0, 40, 9)), Pose(DOWN, np.array([-9.0, 0.0, 5.0]))
    clear, overcast = (
        covered(
            span, pose, light=Light(azimuth_deg=90.0, elevation_deg=45.0, clouds={"share": s, "dark": 0.9}, **CLEAR)
        )
        for s in (0.0, 1.0)
    )
    sun = Light(elevation_deg=45.0).sun_at(0.0)
    direct, sky = math.sin(sun.elevation) * np.array(sun.colour), np.array(sun.sky)
    ratio = (0.1 * direct / (0.1 * direct + sky)).mean() / (direct / (direct + sky)).mean()
    assert overcast.sum() == pytest.approx(ratio * clear.sum(), rel=0.05)


def test_no_shadow_falls_in_a_shadow_or_without_sun():
    wall = np.where((EAST > 3.0) & (EAST < 4.0), 12.0, 0.0)  # throws its shadow to the west, over the wire's
    light = Light(azimuth_deg=90.0, elevation_deg=45.0)
    span, pose = wire((0, -40, 5), (0, 40, 5)), Pose(DOWN, np.array([-5.0, 0.0, 4.0]))
    assert np.abs(covered(span, pose, wall, light)).max() < 1e-6
    assert np.abs(covered(span, pose)).max() < 1e-6


# -- the oracle


def test_a_place_under_a_wire_is_unsafe_within_the_reach():
    world = world_of(GRID, np.zeros(GRID.shape), spans=wire((-20, 2.0, 8), (20, 2.0, 8)))
    lander = OracleLander(radius=0.8, rotor_radius=1.2)
    for north, safe in ((0.75, True), (0.82, False), (2.0, False), (3.25, True)):
        got = judge_touchdown(world, lander, Pose(np.eye(3), np.array([0.0, north, 0.3])))
        assert (got.safe, got.reasons) == ((True, ()) if safe else (False, ("wire",)))
    places = safe_places(world, (-3.0, -3.0, 3.0, 6.0), lander, step=0.5)
    assert (places.safe == (np.abs(places.north - 2.0) > 1.21)[:, None]).all()
    truth = world.truth((-5.0, -5.0, 5.0, 5.0))
    beside = np.abs(truth.grid.xy()[1] - 2.0) > 1.51
    inner = np.abs(truth.grid.xy()[1]) < 3.4  # discs within the box
    assert (truth.safe(TrueFootprint())[inner, 50] == beside[inner]).all()
    assert (truth.height == 0.0).all()


@pytest.mark.parametrize(("north", "struck"), [(0.5, True), (1.5, False)])
def test_a_vehicle_that_sinks_onto_a_wire_strikes_it(north, struck):
    world = world_of(GRID, np.zeros(GRID.shape), spans=wire((-20, north, 6), (20, north, 6)))
    flight = SteeredFlight(world, 1, start=(0, 0, 9), size=(32, 24), rate_hz=1.0, gusts=0.0, radius=1.0)
    while not flight.landed:
        flight.step(0.5, Wanted(velocity=np.array([0.0, 0.0, -0.9])))
    verdict = judge_flight(flight, OracleLander(radius=1.0))
    if struck:
        (strike,) = [c for c in flight.contacts if c.struck is not None]
        assert strike.pose.translation[2] == pytest.approx(6.0 + flight.standing, abs=2.2 * flight.standing)
        assert (verdict.safe, verdict.reasons) == (False, ("strike",))
    else:
        assert verdict.safe


# -- things


def made(*layers, seed=2):
    tree = {"ground": {"size": [60, 60], "relief": [{"height": 0.5}], "layers": list(layers)}}
    return build(parse_scene(tree, "test.yaml"), seed)


def test_a_power_line_hangs_from_the_tops_of_its_posts():
    line = {"thing": "power_line", "path": [[-25, -3], [0, 4], [26, 4]], "posts": 12, "wires": 2, "post": 0.1}
    world = made(line | {"spacing": 1.0, "post_height": 7, "sag": 0.05})
    truth, spans = world.truth(), world.truth().spans
    assert len(spans) == 2 * 4 + 5  # wires, cross-arms
    tops = 0.5 * (spans.start[8:] + spans.end[8:])
    for east, north, up in tops:
        row, col = (round(float(v)) for v in truth.grid.index(east, north))
        assert truth.label[row, col] == Terrain.STRUCTURE
        assert truth.height[row, col] == pytest.approx(up, abs=1e-3)
        assert up - np.median(truth.height[row - 4 : row + 5, col - 4 : col + 5]) == pytest.approx(7.0, abs=0.2)
    assert 0.5 * (spans.start[:4] + spans.start[4:8]) == pytest.approx(tops[:4], abs=1e-9)
    assert spans.sag[:8] == pytest.approx(0.05 * np.linalg.norm(spans.end - spans.start, axis=1)[:8], rel=0.02)


@pytest.mark.parametrize("thing", ["washing_line", "guyed_mast", "branches"])
def test_scattered_spans_do_not_depend_on_the_box_that_is_asked_for(thing):
    world = made({"thing": thing, "per_hectare": 60})
    spans = world.truth().spans
    assert len(spans) > 20
    near = world.truth((-10.0, -10.0, 10.0, 10.0)).spans
    assert sorted(map(tuple, near.table)) == sorted(map(tuple, spans.within((-10.0, -10.0, 10.0, 10.0)).table))
    if thing == "guyed_mast":
        assert all(up == pytest.approx(world.height_at(e, n), abs=1e-3) for e, n, up in spans.end[:9])


def test_spans_stand_in_the_truth_of_a_flight_and_of_its_log(tmp_path):
    from alight.evaluation.flight import read_flight_truth
    from alight.settings import Lander

    world = made({"thing": "washing_line", "per_hectare": 40, "height": 4, "length": [8, 12]})
    flight = fly(world, 2, 0.3, height=20.0, rate_hz=4.0)
    assert len(flight.truth.spans)
    write(flight, tmp_path / "log")
    read = read_flight_truth(tmp_path / "log")
    assert read.spans.table == pytest.approx(flight.truth.spans.table, abs=1e-4)
    under = flight.truth.spans.over(read.grid, 1.4)
    assert not read.safe(Lander(radius=1.5))[under].any()
    assert not flight.truth.safe()[under].any()
