"""The standard ladder: names of the rungs, their flights, and the separation of tuning and test."""

from __future__ import annotations

import ladder as steps
import numpy as np
import pytest
from ladder import FAMILIES, HEIGHTS, SCENES, Rung, ladder, rung

from alight.records import InputError
from alight_sim.scene import built_in, read_scene


def test_the_ladder_is_scenes_by_heights_by_seeds_and_names_are_read_back() -> None:
    rungs = ladder("test")
    assert len(rungs) == len(SCENES) * len(HEIGHTS) * 3
    assert HEIGHTS == (20, 50, 100, 150)
    names = [r.name for r in rungs]
    assert len(set(names)) == len(names)
    assert names[2] == f"{SCENES[0]}/20m/test-3"
    assert [rung(n) for n in names] == list(rungs)


@pytest.mark.parametrize("scene", SCENES)
def test_the_longest_way_stays_in_every_scene(scene: str) -> None:
    ground = read_scene(built_in()[scene]).ground
    longest = max(r.speed * r.duration for r in ladder("test", scenes=[scene]))
    assert 0.5 * longest + 10.0 < min(ground.extent[2:])


def test_quick_rungs_are_fewer_and_shorter_and_say_so() -> None:
    quick = ladder("tuning", quick=True)
    assert len(quick) == len(SCENES) * len(HEIGHTS)
    for r in quick:
        assert r.name.endswith("-quick")
        assert rung(r.name) == r
        assert r.duration < 0.3 * Rung(r.scene, r.height, r.kind, r.number).duration


def test_no_seed_is_both_for_tuning_and_for_testing() -> None:
    most = steps.MOST_SEEDS
    tuning, test = ({r.seed for r in ladder(k, seeds=most)} for k in steps.KINDS)
    assert len(tuning) == len(test) == most
    assert not tuning & test


@pytest.mark.parametrize("height", steps.RATES)
def test_a_ring_of_7_to_10_frames_spans_a_tenth_to_a_fifth_of_the_height(height: int) -> None:
    r = Rung(SCENES[0], height, "test", 1)
    spacing = r.speed / r.rate_hz / height
    assert 6 * spacing > 0.1
    assert 9 * spacing < 0.2
    assert 1.2 < r.speed < 15.0


def test_courses_differ_from_seed_to_seed() -> None:
    courses = np.array([r.course_deg for r in ladder("test", heights=(20,), scenes=SCENES[:1], seeds=7)])
    apart = np.abs((courses[:, None] - courses + 180.0) % 360.0 - 180.0) + 360.0 * np.eye(len(courses))
    assert apart.min() > 15.0


@pytest.mark.parametrize("height", [HEIGHTS[0], HEIGHTS[-1]])
def test_a_rung_flies_what_it_says(height: int) -> None:
    r = Rung(SCENES[0], height, "test", 2, quick=True)
    flight = r.fly()
    assert flight.seed == r.seed
    assert flight.length == steps.QUICK_FRAMES
    centres = np.array([flight.pose(int(t)).translation for t in flight.frame_times])
    gaps = np.linalg.norm(np.diff(centres, axis=0), axis=1) / height
    assert gaps.mean() == pytest.approx(steps.SPACING, rel=0.1)
    way = centres[-1] - centres[0]
    assert np.degrees(np.arctan2(way[0], way[1])) % 360.0 == pytest.approx(r.course_deg, abs=8.0)
    above = centres[:, 2] - [flight.world.height_at(e, n) for e, n in centres[:, :2]]
    assert np.median(above) == pytest.approx(height, rel=0.25)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("meadow", "write one like meadow/50m/test-3"),
        ("nowhere/50m/test-1", "nowhere/50m/test-1: the scene is not on the ladder; use one of: "),
        (f"{SCENES[0]}/35m/test-1", "use one of: 8, 10, 12, 15, 20, 30, 40"),
        (f"{SCENES[0]}/50m/test-0", "use tuning-1 or test-1"),
        (f"{SCENES[0]}/50m/practice-1", "no rung"),
    ],
)
def test_a_rung_that_is_not_there_is_refused_by_name(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rung(name)


def test_a_ladder_of_something_else_is_refused() -> None:
    with pytest.raises(InputError, match="the height is not on the ladder"):
        ladder("test", heights=(20, 35))
    with pytest.raises(InputError, match="the scene is not on the ladder"):
        ladder("test", scenes=("atlantis",))


# -- flights that change their height, and families of scenes


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("gravel/40-8m/tuning-1", "approach"),
        ("gravel/8-40m/test-2", "climb"),
        ("pasture/15+45m/tuning-3-quick", "two_heights"),
        ("meadow/60-6m/test-1", "approach"),
    ],
)
def test_flights_that_change_their_height_are_read_back_by_name(name: str, pattern: str) -> None:
    r = rung(name)
    assert r.name == name
    assert r.plan().flight.kind == pattern


def above_ground(name: str) -> np.ndarray:
    """(N, 3) east, north and height above the ground of all exposures."""
    flight = rung(name).fly()
    places = np.array([flight.pose(int(t)).translation for t in flight.frame_times])
    places[:, 2] -= [flight.world.height_at(e, n) for e, n in places[:, :2]]
    return places


def test_an_approach_is_level_and_then_comes_down_over_one_place() -> None:
    flight = rung("gravel/40-8m/tuning-1").fly()
    assert 15.0 < flight.seconds < 25.0
    assert 80 < flight.length < 160
    places = above_ground("gravel/40-8m/tuning-1")
    level = np.abs(places[:, 2] - 40.0) < 3.0
    assert 0.3 < level.mean() < 0.7
    assert places[-1, 2] == pytest.approx(8.0, abs=1.5)
    assert np.ptp(places[level][:, :2], axis=0).max() > 10.0
    down = places[places[:, 2] < 35.0]
    assert np.hypot(*(down[:, :2] - down[-1, :2]).T).max() < 7.0
    assert (np.diff(down[:, 2]) < 0.3).all()


def test_a_climb_goes_up_and_two_heights_see_the_same_ground() -> None:
    up = above_ground("gravel/8-40m/tuning-1-quick")
    assert up[0, 2] == pytest.approx(8.0, abs=1.0)
    assert up[-1, 2] == pytest.approx(40.0, abs=4.0)
    both = above_ground("gravel/15+45m/tuning-1-quick")
    low, high = both[np.abs(both[:, 2] - 15) < 2], both[np.abs(both[:, 2] - 45) < 4]
    assert min(len(low), len(high)) > 4
    assert np.hypot(*(low[:, :2].mean(axis=0) - high[:, :2].mean(axis=0))) < 6.0


def test_a_descent_ends_over_open_ground_where_the_scene_has_trees() -> None:
    places = above_ground("forest/40-8m/tuning-1-quick")
    assert places[-1, 2] == pytest.approx(8.0, abs=2.0)


@pytest.mark.parametrize("scene", FAMILIES)
def test_a_family_is_flown_with_another_scene_for_every_seed(scene: str) -> None:
    plans = [rung(f"{scene}/40m/tuning-{n}").plan() for n in (1, 2)]
    assert plans[0].light != plans[1].light
    assert plans[0].ground.layers != plans[1].ground.layers
    assert rung(f"{scene}/40m/tuning-1").plan() == plans[0]


@pytest.mark.parametrize("name", ["gravel/40-40m/test-1", "gravel/40-3m/test-1", "gravel/150-8m/test-1"])
def test_heights_that_no_flight_has_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="use two different heights from 6 to 100 m"):
        rung(name)
