"""The standard ladder: what its rungs are called, what they fly, and that tuning and test never meet."""

from __future__ import annotations

import ladder as steps
import numpy as np
import pytest
from ladder import HEIGHTS, SCENES, Rung, ladder, rung

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
    assert 2.0 < r.speed < 15.0


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
        (f"{SCENES[0]}/35m/test-1", "use one of: 20, 40, 50, 60, 100, 150"),
        (f"{SCENES[0]}/50m/test-0", "use tuning-1 or test-1"),
        (f"{SCENES[0]}/50m/practice-1", "no rung"),
    ],
)
def test_a_rung_that_is_not_there_is_refused_by_name(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        rung(name)


def test_a_ladder_of_something_else_is_refused() -> None:
    with pytest.raises(InputError, match="the height is not on the ladder"):
        ladder("test", heights=(20, 30))
    with pytest.raises(InputError, match="the scene is not on the ladder"):
        ladder("test", scenes=("atlantis",))
