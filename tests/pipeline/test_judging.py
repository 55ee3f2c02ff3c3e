"""The judging lane: its cells, the observer, and the next view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from descent_views import look, surface
from ground import GREEN, GREY, ground, textured
from some_run import candidate, elevation, hazards, site

from alight.elevation import FIELDS, on_cells_up_to
from alight.geometry import Camera, Grid, Pose
from alight.hazards import assess
from alight.parallax.orthophoto import orthophoto
from alight.pipeline.judging import JudgingLane, JudgingMemory, Verdict, find_land_cover, observer
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.remembered import NOWHERE
from alight.pipeline.timing import Timings
from alight.raster import block_mean, cells_as_blocks
from alight.records import ElevationMap, Hazard, MissingVeto, NextView, Sites, Terrain, View
from alight.records.map_frame import MapFrame
from alight.settings import Settings, TerrainSettings, load_settings


def look_down(t_ns: int, cam: int, focal: float) -> View:
    lens = Camera(64, 48, focal, focal, 32.0, 24.0)
    return View(t_ns, cam, np.zeros((48, 64), np.uint8), lens, Pose(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 9.0])))


@pytest.mark.parametrize(("newest", "stereo"), [((0,), False), ((0, 1), True)])
def test_the_observer_is_the_vehicle_with_the_cameras_of_the_newest_instant(
    newest: tuple[int, ...], stereo: bool
) -> None:
    """The cameras of the exposure before had another focal length, and there were two."""
    views = (look_down(1, 0, 300.0), look_down(1, 1, 300.0), *(look_down(2, cam, 500.0) for cam in newest))
    vehicle = np.array([1.0, 2.0, 9.0]), 8.0
    seen = MapSnapshot(elevation(), views, *vehicle, MapFrame(0, np.zeros(3), np.eye(3)))
    who = observer(seen)
    assert (who.focal, who.stereo, who.height_above_ground) == (500.0, stereo, 8.0)
    np.testing.assert_array_equal(who.position, [1.0, 2.0, 9.0])
    assert observer(replace(seen, views=())) is None  # at the end of a flight no camera may look down


def test_the_next_look_is_that_of_the_first_candidate_that_has_one_while_there_is_no_site() -> None:
    blind, seen = replace(candidate(), look=None), candidate(2, 12.0, 6.0)

    def look(found: Sites) -> NextView | None:
        return Verdict(elevation(), None, hazards(), found, MapFrame(0, np.zeros(3), np.eye(3))).look

    assert look(Sites((), "fog", candidates=(blind, seen))) == seen.look
    assert look(Sites((site(),), candidates=(seen,))) is None
    assert look(Sites((), "fog", candidates=(blind,))) is None


def cells(shape: tuple[int, int], cell: float, factor: int) -> ElevationMap:
    """Level ground with a random grey in every pixel of the finest picture."""
    rng = np.random.default_rng(0)
    fine = rng.integers(1, 255, (shape[0] * factor, shape[1] * factor, 3)).astype(np.uint8)
    full = {"height": 0.0, "sigma": 0.02, "flags": 0, "views": 5, "residual": 0.1, "sampling": cell}
    types = {k: FIELDS[k][0] for k in full}
    fields = {k: np.full(shape, v, types[k]) for k, v in full.items()}
    rgb = fine[::factor, ::factor].copy()
    own = np.full(shape, cell / factor, np.float32)
    return ElevationMap(Grid(0.0, 0.0, cell, *shape), rgb=rgb, fine=fine, fine_sampling=own, **fields)  # type: ignore[arg-type]


def test_wider_cells_keep_the_finest_picture_where_it_is() -> None:
    fine = cells((31, 40), 0.05, 2)
    wide = on_cells_up_to(fine, 0.2)
    assert (wide.grid.cell, wide.grid.shape) == (0.2, (8, 10))
    picture, n = wide.finest
    assert n == 8
    np.testing.assert_array_equal(picture[:62, :80], fine.fine)
    assert not picture[62:].any()
    np.testing.assert_allclose(wide.picture_sampling, 0.025)


@pytest.mark.parametrize(("pixel", "n"), [(0.01, 8), (0.05, 4), (0.1, 2), (0.2, 1), (9.0, 1)])
def test_a_picture_is_asked_for_by_the_width_of_its_pixels(pixel: float, n: int) -> None:
    wide = on_cells_up_to(cells((32, 40), 0.05, 2), 0.2)
    picture, got = wide.picture(pixel)
    assert got == n
    want = block_mean(wide.finest[0][..., 1].astype(np.float32), 8 // n)
    np.testing.assert_allclose(picture[..., 1], want, atol=0.5)


def test_land_cover_is_found_on_cells_that_fit_its_evidence_and_given_on_those_of_the_map() -> None:
    fine = cells((40, 40), 0.1, 2)
    cover = find_land_cover(fine, TerrainSettings(), None)
    assert cover.grid == fine.grid
    blocks = cells_as_blocks(cover.landable, 2)
    assert (blocks == blocks[:, :1, :, :1]).all()
    coarse = cells((20, 20), 0.2, 4)
    assert find_land_cover(coarse, TerrainSettings(), None).grid == coarse.grid


@pytest.mark.parametrize(
    ("missing", "key", "words"),
    [
        (MissingVeto.SECOND_CAMERA, "one_camera_hazard", "one camera sees the ground"),
        (MissingVeto.ATTITUDE, "unchecked_hazard", "attitude was measured neither"),
    ],
)
def test_a_missing_second_camera_or_attitude_is_warned_of_and_p_pays_for_it(
    missing: MissingVeto, key: str, words: str
) -> None:
    seen, stages = cells((60, 60), 0.1, 1), Settings().stages()
    whole, less = (assess(seen, None, stages.lander, stages.hazards, m).p_safe for m in (MissingVeto(0), missing))
    judged = np.isfinite(less)
    assert judged.any()
    np.testing.assert_allclose(less[judged] / whole[judged], np.exp(-getattr(stages.hazards, key)), rtol=1e-4)
    verdict = Verdict(seen, None, hazards(), Sites((), "fog"), MapFrame(0, np.zeros(3), np.eye(3)), missing)
    assert words in verdict.warnings[1]
    assert words not in "".join(replace(verdict, missing=MissingVeto(0)).warnings)


def test_a_snapshot_knows_which_veto_is_missing() -> None:
    one, two = (look_down(0, cam, 300.0) for cam in (0, 1))
    place = np.zeros(3), 10.0
    seen = MapSnapshot(elevation(), (one, two), *place, MapFrame(0, np.zeros(3), np.eye(3)))
    assert seen.missing == MissingVeto(0)
    assert replace(seen, views=(one,)).missing == MissingVeto.SECOND_CAMERA
    assert replace(seen, attitude=False).missing == MissingVeto.ATTITUDE


def test_grey_pictures_are_warned_of_and_p_pays_for_them() -> None:
    seen = cells((60, 60), 0.1, 1)
    grey = replace(seen, rgb=np.repeat(seen.rgb[..., :1], 3, axis=2), fine=None, fine_sampling=None)
    cover, coloured = (find_land_cover(e, TerrainSettings(), None) for e in (grey, replace(seen, fine=None)))
    assert (cover.coloured, coloured.coloured) == (False, True)
    assert cover.on(Grid(0.0, 0.0, 0.2, 30, 30)).coloured is False
    stages = Settings().stages()
    with_colour, without = (
        assess(grey, replace(cover, coloured=known), stages.lander, stages.hazards).p_ground for known in (True, False)
    )
    judged = np.isfinite(without)
    assert judged.any()
    np.testing.assert_allclose(
        without[judged] / with_colour[judged], np.exp(-stages.hazards.unchecked_hazard), rtol=1e-4
    )
    frame = MapFrame(0, np.zeros(3), np.eye(3))
    verdict = Verdict(grey, cover, hazards(), Sites((), "fog"), frame)
    assert "the pictures are grey" in verdict.warnings[0]
    assert replace(verdict, land_cover=coloured).warnings == ()
    assert "terrain.enabled=false" in replace(verdict, land_cover=None).warnings[0]


def on_a_roof(half: float) -> MapSnapshot:
    """A flat roof of 8 x 8 m, 4 m above the ground, seen within `half` metres of its middle."""
    n = round(2 * half / 0.1)
    seen = cells((n, n), 0.1, 1)
    grid = replace(seen.grid, east=-half, north=half)
    x, y = (np.abs(v) for v in grid.xy())
    height = np.where((x < 4)[None] & (y < 4)[:, None], 4.0, 0.0).astype(np.float32)
    place = np.array([0.0, 0.0, 20.0]), 16.0
    frame = MapFrame(0, np.zeros(3), np.eye(3))
    return MapSnapshot(replace(seen, grid=grid, height=height), (look_down(1, 0, 300.0),), *place, frame)


def test_a_roof_is_remembered_where_its_rim_is_not_seen_any_more() -> None:
    """The roof is remembered also in another map frame; a lane that has never seen its rim finds none."""
    lane, new = (JudgingLane(Settings().stages(), None, Timings()) for _ in range(2))
    near = on_a_roof(2.5)
    assert not (new.judge(near).land_cover.label == Terrain.STRUCTURE).any()  # type: ignore[union-attr]
    far = lane.judge(on_a_roof(12.0)).land_cover
    assert far is not None
    x, y = (np.abs(v) for v in far.grid.xy())
    assert (far.label == Terrain.STRUCTURE)[(x < 3)[None] & (y < 3)[:, None]].all()
    assert not (far.label == Terrain.STRUCTURE)[(x > 6)[None] | (y > 6)[:, None]].any()
    shift = np.array([100.0, -50.0, 2.0])
    for at in (np.zeros(3), shift):
        there = replace(near.elevation, grid=replace(near.elevation.grid, east=at[0] - 2.5, north=at[1] + 2.5))
        frame = MapFrame(int(at.any()), -at, np.eye(3))
        cover = lane.judge(replace(near, elevation=there, frame=frame)).land_cover
        assert cover is not None
        assert (cover.label == Terrain.STRUCTURE).all()
        assert (cover.landable == 0).all()


def test_a_roof_covers_what_is_not_known_of_its_place_in_another_frame() -> None:
    frame, later = (MapFrame(k, np.zeros(3), np.diag([0.18, 0.08, 1.0])) for k in range(2))
    memory = JudgingMemory(frame=frame, roofs=NOWHERE.with_seen(np.array([[4, 6]]), 7))
    roofs = memory.tied(frame.tie(later), later).roofs  # known to 0.6 m: 1.2 m on each side
    np.testing.assert_array_equal(np.ptp(roofs.cells, axis=0), [6, 6])
    np.testing.assert_array_equal(roofs.cells.mean(axis=0), [4, 6])


def on_a_road(half: float) -> MapSnapshot:
    """A road of 5 m through a level meadow, seen within `half` metres of its middle."""
    n = round(2 * half / 0.2)
    colour = textured(GREEN, (n, n), 0.1, 1)
    beside = np.abs(np.arange(n) - (n - 1) / 2) * 0.2
    colour[beside < 2.5] = textured(GREY, (n, n), 0.03, 2)[beside < 2.5]
    seen = ground(np.zeros((n, n)), 0.2, 0.02, colour)
    seen = replace(seen, grid=replace(seen.grid, east=0.1 - half, north=half - 0.1))
    place = np.array([0.0, 0.0, 20.0]), 20.0
    return MapSnapshot(seen, (look_down(1, 0, 300.0),), *place, MapFrame(0, np.zeros(3), np.eye(3)))


def test_a_road_is_remembered_where_it_is_not_seen_how_far_it_goes_on() -> None:
    lane, new = (JudgingLane(Settings().stages(), None, Timings()) for _ in range(2))
    assert "road" not in [z.kind for z in new.judge(on_a_road(8.0)).others]
    assert "road" in [z.kind for z in lane.judge(on_a_road(25.0)).others]
    near = lane.judge(on_a_road(8.0))
    assert near.land_cover is not None
    assert near.land_cover.road is not None
    (road,) = (z for z in near.others if z.kind == "road")
    assert road.shape.area == pytest.approx(5.0 * 16.0, rel=0.3)
    assert (near.hazards.reasons[near.land_cover.road] & Hazard.AVOID).all()


def test_roads_are_looked_for_in_new_exposures_and_on_the_whole_map() -> None:
    """The first map shows too little of the road; the next ones show all of it, but no other exposure."""
    lane = JudgingLane(Settings().stages(), None, Timings())
    verdicts = [lane.judge(seen) for seen in (on_a_road(8.0), on_a_road(25.0), replace(on_a_road(25.0), whole=True))]
    assert ["road" in [z.kind for z in v.others] for v in verdicts] == [False, False, True]


def test_third_parties_can_be_turned_off() -> None:
    alone = load_settings("", ("tuning.sites.third_party=false",)).stages()
    verdict = JudgingLane(alone, None, Timings()).judge(on_a_road(25.0))
    assert verdict.others == ()
    assert not (verdict.hazards.reasons & Hazard.AVOID).any()


def test_the_picture_of_a_large_map_is_coarser_and_its_pixels_say_so() -> None:
    """The finest picture of a large map, with only few photos from near by, once took a sixth of the memory."""
    views = [look((0.3 * k, 0.0, 8.0), k) for k in range(5)]
    grid = Grid(-1.5, -1.5, 0.1, 30, 30)
    level = np.full(grid.shape, np.float32(surface(np.array(0.0), np.array(0.0))))
    ground = replace(cells(grid.shape, 0.1, 1), grid=grid, height=level)
    whole, sampling = orthophoto(views, ground)
    n = whole.shape[0] // grid.rows
    assert n > 1
    coarse, wider = orthophoto(views, ground, most=grid.rows * grid.cols * n**2 - 1)
    assert coarse.shape[0] == whole.shape[0] // 2
    mean = whole.reshape(coarse.shape[0], 2, coarse.shape[1], 2, 3).mean(axis=(1, 3))
    assert np.abs(coarse - mean).mean() < 0.5 * np.abs(mean - mean.mean(axis=(0, 1))).mean()
    np.testing.assert_allclose(wider, np.maximum(sampling, 0.1 / (n / 2)), rtol=1e-6)


def test_a_tower_above_the_cameras_leaves_the_picture_of_the_ground_beside_it() -> None:
    """Each view is looked up only where it may show ground, from the lowest height up to the camera's own."""
    views = [look((0.3 * k, 0.0, 8.0), k) for k in range(5)]
    grid = Grid(-4.5, 4.5, 0.1, 90, 90)
    level = np.full(grid.shape, np.float32(surface(np.array(0.0), np.array(0.0))))
    tower = level.copy()
    tower[:10, :10] += 12.0
    ground = replace(cells(grid.shape, 0.1, 1), grid=grid, rgb=np.zeros((*grid.shape, 3), np.uint8))
    alone, beside = (orthophoto(views, replace(ground, height=h))[0].astype(int) for h in (level, tower))
    n = alone.shape[0] // grid.rows
    alone, beside = alone[12 * n :], beside[12 * n :]
    assert alone.any(axis=2).mean() > 0.3
    assert (alone.any(axis=2) == beside.any(axis=2)).mean() > 0.999
    assert np.abs(alone - beside).mean() < 0.01


def test_no_pixel_that_a_camera_saw_is_black() -> None:
    """Black marks missing pixels: half of the ground is painted black, the other half red without any green."""
    views = [look((0.3 * k, 0.0, 8.0), k) for k in range(5)]
    painted = [replace(v, image=np.zeros((*v.image.shape[:2], 3), np.uint8)) for v in views]
    for v in painted:
        np.asarray(v.image)[:, :120, 0] = 200
    grid = Grid(-1.5, 1.5, 0.1, 30, 60)
    level = np.full(grid.shape, np.float32(surface(np.array(0.0), np.array(0.0))))
    ground = replace(cells(grid.shape, 0.1, 1), grid=grid, height=level, rgb=np.zeros((*grid.shape, 3), np.uint8))
    picture, _ = orthophoto(painted, ground)
    shown = orthophoto(views, ground)[0].any(axis=2)
    assert shown.mean() > 0.5
    assert (picture[shown][:, 1] == 1).all()
    assert set(np.unique(picture[shown][:, 2])) == {1}
    assert picture[shown][:, 0].min() == 1
    assert picture[shown][:, 0].max() > 100
    assert not picture[~shown].any()
