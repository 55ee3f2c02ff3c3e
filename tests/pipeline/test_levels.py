"""The recursive map on a descent from 100 m to 5 m, in a hover, after a gap, with lost and late keyframes."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from descent_views import descent, level_flight, look, surface

from alight.elevation import FIELDS, NullStore
from alight.geometry import Pose
from alight.pipeline.mapping.batch_map import BatchMap
from alight.pipeline.mapping.ground_map import level_for
from alight.pipeline.mapping.keyframes import footprint
from alight.pipeline.mapping.recursive_map import RecursiveMap
from alight.pipeline.remembered import NOWHERE
from alight.records import ElevationMap, View
from alight.settings import Settings, load_settings
from alight.settings.tuning import MappingTuning

SMALL = ["tuning.elevation.tile=64", "elevation.max_sigma=5"]  # 240 pixels across: a third of the usual accuracy


@cache
def down() -> tuple[View, ...]:
    return tuple(descent(100.0, 5.0))


def lane_of(views: Iterable[View], settings: Settings | None = None, forget: bool = False) -> RecursiveMap:
    """Return a lane whose ground is found."""
    lane = RecursiveMap((settings or load_settings("", SMALL)).stages(), NullStore() if forget else None)
    assert lane.find_ground(list(views)), lane.reason
    return lane


def under(lane: RecursiveMap, view: View, level: int | None = None, share: float = 0.7) -> ElevationMap:
    """Return the map about the middle of a view's footprint."""
    assert lane.elevation is not None
    seen = footprint(view, lane.ground_here or 0.0)
    middle, half = (seen.max(axis=0) + seen.min(axis=0)) / 2, share * (seen.max(axis=0) - seen.min(axis=0)) / 2
    (west, south), (east, north) = middle - half, middle + half
    at = lane.level if level is None else level
    return lane.elevation.read(lane.elevation.layer(at).window((west, east), (south, north)))


def errors(m: ElevationMap) -> np.ndarray:
    """Errors of the trusted cells, metres, in the order of `m.trusted`."""
    x, y = np.meshgrid(*m.grid.xy())
    return np.asarray((m.height - surface(x, y))[m.trusted], dtype=np.float64)


@dataclass(frozen=True)
class Stage:
    """Accuracy of the map at one height."""

    height: float
    cell: float
    known: float  # share of the cells
    spread: float  # median absolute error over the height
    worst: float  # 95th percentile of the absolute error over the height
    covered: float  # share within two sigma


def stage(lane: RecursiveMap, view: View) -> Stage:
    m = under(lane, view)
    e, up = np.abs(errors(m)), float(view.centre[2])
    covered = float((e < 2 * m.sigma[m.trusted]).mean())
    return Stage(
        up, m.grid.cell, float(m.trusted.mean()), float(np.median(e)) / up, float(np.percentile(e, 95)) / up, covered
    )


@cache
def flown() -> tuple[RecursiveMap, tuple[Stage, ...], tuple[tuple[float, float], ...]]:
    """Fly the descent; return the map, its accuracy at every tenth step, and height steps at changes of the cell."""
    lane, stages, jumps, level = lane_of(down()[:10]), [], [], 0
    assert lane.elevation is not None
    for k, v in enumerate(down()):
        before = under(lane, v)
        lane.step([v])
        if lane.level != level:
            after = lane.elevation.read(before.grid)
            both = after.trusted & before.trusted
            assert both.mean() > 0.5
            d = (np.abs(after.height - before.height) / before.sigma)[both]
            jumps.append((float(np.median(d)), float((d > 2).mean())))
            level = lane.level
        if k >= 10 and k % 10 == 0:
            stages.append(stage(lane, v))
    stages.append(stage(lane, down()[-1]))
    return lane, tuple(stages), tuple(jumps)


def test_the_error_is_the_same_share_of_the_height_all_the_way_down() -> None:
    """From 100 m to 5 m in one map, no stage is worse than another, and sigma covers the errors."""
    _, stages, _ = flown()
    assert stages[0].height > 60
    assert stages[-1].height < 5.5
    for s in stages:
        assert s.known > 0.65, s
        assert s.spread < 0.0035, s
        assert s.worst < 0.03, s
        assert s.covered > 0.9, s
    assert np.median([s.known for s in stages]) > 0.9
    assert stages[-1].spread < 1.5 * stages[0].spread


def test_the_cell_follows_the_height() -> None:
    lane, stages, jumps = flown()
    pixels = [s.cell * 225.0 / s.height for s in stages]
    assert min(pixels) > 1.8 * 2**-0.95  # half an octave, the hysteresis, and the rounding of the cell
    assert max(pixels) < 1.8 * 2**0.95
    assert stages[0].cell / stages[-1].cell == 16
    assert len(jumps) == 4
    assert lane.level == -4


def test_no_step_where_the_cell_changes() -> None:
    """The heights of one place before and after a change of the cell differ by less than sigma.

    For independent heights 5 % would differ by more than two sigmas; 0.8 to 1.2 % were measured, depending on rounding.
    """
    _, _, jumps = flown()
    for middle, beyond in jumps:
        assert middle < 0.5
        assert beyond < 0.02


def test_no_seam_where_levels_meet() -> None:
    """Across the border of the finest cells, the error jumps by no more than the sigma of the coarser cells."""
    lane, _, _ = flown()
    assert lane.elevation is not None
    last = under(lane, down()[-1], -4, share=1.8)
    own = lane.elevation.layers[-4].read(last.grid)
    fine = np.isfinite(own["height"])
    assert 0.2 < fine.mean() < 0.9
    x, y = np.meshgrid(*last.grid.xy())
    e = last.height - surface(x, y)
    both = last.trusted[:, 1:] & last.trusted[:, :-1] & (fine[:, 1:] != fine[:, :-1])
    assert both.sum() > 20
    jump = np.abs(np.diff(e, axis=1))[both]
    sigma = np.maximum(last.sigma[:, 1:], last.sigma[:, :-1])[both]
    assert np.median(jump / sigma) < 1.0
    assert (jump < 2 * sigma).mean() > 0.9


def test_one_raster_comes_out() -> None:
    """The raster has the finest cells if they are a twentieth of it, the rest interpolated; larger ones if too many."""
    lane, stages, _ = flown()
    whole = lane.snapshot()
    assert whole is not None
    assert whole.grid.cell == 4 * stages[-1].cell
    x, y = np.meshgrid(*whole.grid.xy())
    e = np.abs(whole.height - surface(x, y))[whole.trusted]
    assert np.percentile(e, 95) < 0.01 * 80
    small = load_settings("", [*SMALL, "elevation.most_cells=100000"])
    lane.settings, before = small, lane.settings
    coarse = lane.snapshot()
    lane.settings = before
    assert coarse is not None
    assert coarse.grid.rows * coarse.grid.cols <= 100_000
    assert coarse.grid.cell == 2 * whole.grid.cell


def test_the_same_descent_gives_the_same_bits() -> None:
    a, _, _ = flown()
    b = lane_of(down()[:10])
    for v in down():
        b.step([v])
    x, y = a.snapshot(), b.snapshot()
    assert x is not None
    assert y is not None
    assert x.grid == y.grid
    for f in FIELDS:
        assert getattr(x, f).tobytes() == getattr(y, f).tobytes(), f


def test_up_again_keeps_what_was_seen_from_near() -> None:
    """After a descent and a climb, the coarse map about the landing place keeps the finer heights."""
    views = [v for v in down() if v.centre[2] < 30]
    lane = lane_of(views[:10])
    for v in views:
        lane.step([v])
    near = under(lane, views[-1])
    e_near = np.median(np.abs(errors(near)))
    for v in (replace(v, t_ns=10**12 - v.t_ns) for v in reversed(views[:-1])):
        lane.step([v])
    again = under(lane, views[-1], -1)
    assert np.median(np.abs(errors(again))) < 2 * e_near
    assert again.trusted.mean() > 0.7


def test_a_gust_does_not_change_the_cell() -> None:
    """With hysteresis, the cell does not change around the border between two levels, from either side."""
    cell, border, slack = 1.0, 2**-0.5, MappingTuning().level_slack  # metres, metres, octaves
    for now in (0, -1):
        assert {level_for(border * s, cell, now, slack) for s in (0.92, 0.97, 1.03, 1.08)} == {now}
    assert level_for(border * 0.85, cell, 0, slack) == -1
    assert level_for(border * 1.15, cell, -1, slack) == 0
    assert level_for(0.05, cell, 0, slack) == -4


def test_a_cell_that_was_asked_for_stays() -> None:
    lane = lane_of(down()[:10], load_settings("", [*SMALL, "parallax.cell=0.8"]))
    for v in down()[::3]:
        lane.step([v])
    m = lane.snapshot()
    assert m is not None
    assert m.grid.cell == 0.8


def test_the_batch_is_as_fine_as_the_views_of_each_place() -> None:
    views = [v for v in down() if v.centre[2] < 17]
    lane = BatchMap(
        load_settings("", ["tuning.elevation.tile=96", "elevation.max_sigma=5", "parallax.quality=fine"]).stages()
    )
    assert lane.find_ground(views[::3]), lane.reason
    lane.match_tiles(views[::3], lambda share: None)
    assert lane.elevation is not None
    cells = {level: layer.cell for level, layer in lane.elevation.layers.items() if layer.box()}
    assert max(cells.values()) / min(cells.values()) == 4
    last = lane.elevation.read(
        lane.elevation.layer(min(cells)).window((views[-1].centre[0] - 1, views[-1].centre[0] + 1), (-1.0, 2.0))
    )
    assert last.trusted.mean() > 0.8
    assert np.median(np.abs(errors(last))) < 0.0025 * 5
    m = lane.snapshot()
    assert m is not None
    assert np.median(np.abs(errors(m))) < 0.0025 * 17


# -- faults of a flight


UP = 20.0


@cache
def level() -> tuple[View, ...]:
    return tuple(level_flight(16, UP))


def steps(lane: RecursiveMap, views: Iterable[View]) -> RecursiveMap:
    for v in views:
        lane.step([v])
    return lane


@cache
def _over_level_ground() -> RecursiveMap:
    return steps(lane_of(level()[:8]), level())


def over_level_ground() -> RecursiveMap:
    """A lane after a level flight, for a test of its own."""
    return copy.deepcopy(_over_level_ground())


def worth(lane: RecursiveMap, view: View) -> tuple[float, float, float]:
    """Share of trusted cells, median absolute error, share of errors within two sigma."""
    m = under(lane, view)
    e = np.abs(errors(m))
    return float(m.trusted.mean()), float(np.median(e)), float((e < 2 * m.sigma[m.trusted]).mean())


def test_a_hover_takes_nothing_away() -> None:
    """While it yaws on the spot for 25 keyframes, the window keeps its baseline, and heights and sigma stay good."""
    lane = over_level_ground()
    at = level()[-1].centre
    before = worth(lane, level()[-1])
    for k in range(25):
        lane.step([look(at + 0.02 * np.array([np.sin(k), np.cos(k), 0.3 * np.sin(0.3 * k)]), 100 + k, yaw=0.16 * k)])
    after = worth(lane, level()[-1])
    assert lane.estimator is not None
    centres = np.array([exposure[0].view.centre for exposure in lane.estimator.kept.values()])
    assert np.linalg.norm(centres - at, axis=1).max() > 0.1 * UP
    assert after[0] > before[0] - 0.02
    assert after[1] < 1.2 * before[1]
    assert after[2] > 0.93


def test_a_gap_without_common_views_starts_anew_and_keeps_the_map() -> None:
    """After 150 m the old map is unchanged, bit for bit, and the new place is mapped as well as the first."""
    lane = over_level_ground()
    first = under(lane, level()[-1])
    later = level_flight(16, UP, start=150.0, first=200)
    steps(lane, later)
    assert lane.elevation is not None
    again = lane.elevation.read(first.grid)
    for f in FIELDS:
        assert getattr(again, f).tobytes() == getattr(first, f).tobytes(), f
    known, error, covered = worth(lane, later[-1])
    assert known > 0.9
    assert error < 0.0025 * UP
    assert covered > 0.93


def test_a_map_begins_wherever_the_heights_of_its_frame_begin() -> None:
    """A flight that begins in the air has its origin there, and the ground far below the origin."""
    off = np.array([0.0, 0.0, -400.0])
    low = [replace(v, world_from_cam=Pose(v.world_from_cam.rotation, v.centre + off)) for v in level()]
    there, here = steps(lane_of(low[:8]), low), over_level_ground()
    a, b = (under(lane, views[-1]) for lane, views in ((there, low), (here, level())))
    assert a.trusted.mean() > b.trusted.mean() - 0.02
    assert b.trusted.mean() > 0.9
    assert np.nanmedian(np.abs(a.height - off[2] - b.height)[a.trusted & b.trusted]) < 0.0025 * UP


def test_poses_of_another_frame_do_not_mix() -> None:
    """The estimator begins anew and is 1.5 m off in height: older heights are dropped, new ones are right in the new
    frame. Otherwise views of both frames would be matched with each other."""
    off = np.array([0.0, 0.0, 1.5])
    moved = [
        replace(v, world_from_cam=Pose(v.world_from_cam.rotation, v.centre + off), t_ns=v.t_ns + 10**11)
        for v in level_flight(16, UP, start=3.0, first=50)
    ]
    lane = over_level_ground()
    old = under(lane, level()[-1])
    lane.begin_anew(off)
    assert lane.elevation is not None
    assert not lane.elevation.read(old.grid).trusted.any()
    steps(lane, moved)
    m = under(lane, moved[-1], share=0.5)
    assert m.trusted.mean() > 0.9
    assert np.median(errors(m)) == pytest.approx(1.5, abs=0.05)
    assert np.median(np.abs(errors(m) - 1.5)) < 0.0025 * UP
    mixed = steps(over_level_ground(), moved)  # the same without `begin_anew`
    m = under(mixed, moved[-1], share=0.5)
    assert not m.trusted.any() or np.median(np.abs(errors(m) - 1.5)) > 0.0025 * UP


def test_a_new_frame_remembers_what_moved_about_its_place() -> None:
    """The tie is known to 0.6 m: movement is remembered within 1.2 m of it, on all cells of 0.5 m reached."""
    lane = over_level_ground()
    lane.passed = lane.came = NOWHERE.with_seen(np.array([[4, 6]]), 7)
    lane.begin_anew(np.array([1.0, -2.0, 0.3]), sigma=0.6)
    for kept in (lane.passed, lane.came):
        assert (kept.t_ns == 7).all()
        np.testing.assert_array_equal(np.ptp(kept.cells, axis=0), [6, 6])
        np.testing.assert_array_equal(kept.cells.mean(axis=0), [6, 2])


def test_a_new_frame_leaves_no_tile_of_the_old_one_behind() -> None:
    far: dict[tuple[int, int, int], bytes] = {}
    lane = RecursiveMap(load_settings("", SMALL).stages(), far)
    assert lane.find_ground(list(level()[:8]))
    steps(lane, level_flight(25, UP, share=0.2))
    assert far
    lane.begin_anew(np.zeros(3))
    assert not far
    assert lane.snapshot() is None


def test_lost_late_and_repeated_keyframes() -> None:
    """Every third is lost, two come in the wrong order, one comes twice: the heights hardly change.

    New cells are swept over several keyframes: with a third of these lost, some cells at the rim still wait.
    """
    whole = worth(over_level_ground(), level()[-1])
    some = [v for k, v in enumerate(level()) if k % 3 != 1]
    some[3], some[4] = some[4], some[3]
    some.insert(7, some[6])
    lane = steps(lane_of(level()[:8]), some)
    assert lane.estimator is not None
    times = [exposure[0].view.t_ns for exposure in lane.estimator.kept.values()]
    assert times == sorted(set(times))
    found = worth(lane, level()[-1])
    assert found[0] > whole[0] - 0.07
    assert found[1] < 1.5 * whole[1]
    assert found[2] > 0.93


def test_a_long_way_holds_no_more_than_a_short_one() -> None:
    """The number of tiles and keyframes is the same after 20 and after 40 keyframes."""
    lane = lane_of(level()[:8], forget=True)
    held = []
    for v in level_flight(40, UP, share=0.2):
        lane.step([v])
        assert lane.elevation is not None
        assert lane.estimator is not None
        held.append((sum(len(x.near) for x in lane.elevation.layers.values()), len(lane.estimator.kept)))
    tiles, keyframes = np.array(held).T
    assert tiles[20:].max() <= tiles[:20].max() + 1
    assert keyframes.max() <= 7


def test_a_ground_that_was_found_wrong_is_found_again() -> None:
    """The first points lie 8 m too high: the ground is outside the searched range, and the lane searches again."""
    lane = lane_of(level()[:8])
    lane.points = lane.points + np.array([0.0, 0.0, 8.0])
    lane.ground = 8.0
    steps(lane, level()[:8])
    assert lane.out_of_range
    lane.find_ground_again(level()[:8], 0.08)
    assert lane.ground == pytest.approx(0.0, abs=0.6)
    assert not lane.out_of_range
    steps(lane, level()[8:])
    known, error, _ = worth(lane, level()[-1])
    assert known > 0.9
    assert error < 0.005 * UP
    assert not lane.out_of_range


def test_a_ground_that_was_found_wrong_is_found_again_where_nothing_lies_at_an_end_of_the_range() -> None:
    """Matches in a wrong range contradict each other, and no height is given out; once this lasted a whole flight."""
    lane = lane_of(level()[:8], load_settings("", [*SMALL, "tuning.mapping.beyond=1.0"]))
    lane.points = lane.points + np.array([0.0, 0.0, 12.0])
    lane.ground = 12.0
    steps(lane, level()[:8])
    assert lane.elevation is not None
    assert lane.out_of_range
    assert not under(lane, level()[7]).trusted.any()
    lane.find_ground_again(level()[:8], 0.08)
    steps(lane, level()[8:])
    assert worth(lane, level()[-1])[0] > 0.9
    assert not lane.out_of_range


@pytest.mark.parametrize("trees", [15.0, 6.0, 0.0])
def test_trees_are_sought_on_new_ground_beside_mapped_fields(trees: float) -> None:
    """The trusted heights of a field span two metres; a tree that comes into view may be half as high as a camera."""
    lane = steps(lane_of(level()[:8], load_settings("", [*SMALL, f"tuning.mapping.trees={trees}"])), level())
    m = under(lane, level()[-1])
    ground = float(np.median(m.height[m.trusted]))
    fields = lane.searched_heights(m.grid, UP, m)[1]
    if trees:
        assert fields == pytest.approx(ground + min(trees, 0.5 * (UP - ground)), abs=0.1)
    else:
        assert fields < ground + 5.0


def test_the_ground_is_not_found_over_a_baseline_that_is_too_short() -> None:
    lane = RecursiveMap(load_settings("", SMALL).stages())
    assert not lane.find_ground(level()[:3], 0.2)
    assert "hardly moved" in lane.reason
    assert lane.elevation is None
    assert lane.find_ground(level()[:8], 0.2)


def test_a_vehicle_on_the_ground_asks_for_no_endless_window() -> None:
    """If the map, or the ground, lies higher than the vehicle, the window must not be larger than a picture."""
    lane = over_level_ground()
    lane.ground_here = 25.0  # metres: above the camera
    lane.step([look(level()[-1].centre + np.array([0.8, 0.0, 0.0]), 300)])
    assert lane.ground_here is not None
    assert lane.elevation is not None
    assert lane.elevation.cell_at(lane.level) > 1.0 / 225.0
