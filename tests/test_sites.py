"""Sites: order, distance between them, and the sentence when there is none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ground import covered, ground, plane
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.landing import sites
from alight.landing.next_view import next_view
from alight.landing.reserve import Reserve
from alight.records import ElevationMap, Hazard, HazardMap, Sites, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander, SitesSettings

LANDER = Lander(radius=1.0)
EXACT = HazardsSettings(tilt_sigma=0.0)


def choose(
    e: ElevationMap, t: TerrainMap | None = None, settings: SitesSettings | None = None, vehicle: object = None
) -> Sites:
    return sites.choose_sites(assess(e, t, LANDER, EXACT), t, e, settings or SitesSettings(), LANDER, vehicle)  # type: ignore[arg-type]


def rocky(rows: int = 101, cols: int = 151) -> np.ndarray:
    """A wall of rocks on the left, and open ground on the right."""
    z = np.zeros((rows, cols))
    z[::3, :70:3] = 1.0
    return z


def test_the_roomiest_place_comes_first_and_all_are_safe() -> None:
    e = ground(rocky())
    found = choose(e)
    assert [s.rank for s in found.sites] == list(range(1, len(found.sites) + 1))
    assert found.reason == ""
    best = found.sites[0]
    assert best.east > 9.0
    assert_allclose(best.radius, 1.0 + best.clearance)
    assert best.clearance >= max(s.clearance for s in found.sites) - 1e-6
    h = assess(e, None, LANDER, EXACT)
    for s in found.sites:
        r, c = (round(float(v)) for v in e.grid.index(np.array(s.east), np.array(s.north)))
        assert h.reasons[r, c] == 0
        assert s.clearance >= 0.5
        assert 1.0 >= s.p_safe >= 0.99


def test_sites_keep_apart() -> None:
    e = ground(np.zeros((121, 121)))
    found = choose(e, settings=SitesSettings(count=6, separation=3.0)).sites
    assert len(found) == 6
    at = np.array([[s.east, s.north] for s in found])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=2)[~np.eye(6, dtype=bool)]
    assert gaps.min() > 3.0
    assert len(choose(e, settings=SitesSettings(count=1)).sites) == 1


def test_gentler_ground_ranks_higher_at_equal_room() -> None:
    z = plane(61, 121, 0.0, 0.0)
    z[:, 61:] = plane(61, 60, 0.12, 0.0)
    best = choose(ground(z)).sites[0]
    assert best.east < 6.0
    assert best.slope < 0.01


def test_a_site_tells_its_height_cover_sigma_and_approach() -> None:
    e = ground(np.full((81, 81), 3.5), sigma=0.01)
    t = covered(e, 1.0, Terrain.PAVED)
    at = choose(e, t, vehicle=np.array([4.0, -20.0, 30.0])).sites[0]
    assert_allclose([at.up, at.height_sigma], [3.5, 0.01], rtol=1e-5)
    assert at.terrain == Terrain.PAVED
    assert_allclose(at.heading, math.atan2(at.east - 4.0, at.north + 20.0) % (2 * math.pi))
    assert choose(e, t).sites[0].heading == 0.0
    assert choose(e).sites[0].terrain == Terrain.UNKNOWN


def test_a_near_site_wins_when_distance_counts() -> None:
    e = ground(np.zeros((61, 301)))
    vehicle = np.array([28.0, 3.0, 20.0])
    far = choose(e, vehicle=vehicle, settings=SitesSettings(distance_weight=1.0)).sites[0]
    assert abs(far.east - 28.0) < 1.0


@pytest.mark.parametrize(
    ("height", "words"),
    [
        (np.full((81, 81), np.nan), "no ground was seen"),
        (np.random.default_rng(0).normal(0, 0.3, (81, 81)), "100 % is too rough"),
        (plane(81, 81, 0.4, 0.0), "is too steep"),
        (np.zeros((15, 15)), "smaller than the footprint"),
        (np.zeros((23, 23)), "the most room there is"),
    ],
)
def test_no_site_comes_with_its_reason(height: np.ndarray, words: str) -> None:
    found = choose(ground(height))
    assert found.sites == ()
    assert found.reason.startswith("no safe site: ")
    assert words in found.reason


def test_ground_that_may_not_be_landed_on_is_named() -> None:
    e = ground(np.zeros((81, 81)))
    found = choose(e, covered(e, 0.0, Terrain.WATER))
    assert found.sites == ()
    assert "100 % is covered by what cannot be landed on" in found.reason


def doubtful(e: ElevationMap, p: np.ndarray, reasons: np.ndarray | None = None) -> HazardMap:
    """A verdict with these probabilities, undecided everywhere or for these reasons."""
    h = assess(e, None, LANDER, EXACT)
    why = np.full(e.grid.shape, Hazard.DOUBT, np.uint8) if reasons is None else reasons
    return replace(h, p_safe=p.astype(np.float32), reasons=why)


def test_the_next_look_is_above_the_most_promising_doubt_and_from_nearer() -> None:
    e = ground(np.full((101, 101), 3.0))
    r, c = np.mgrid[:101, :101]
    p = 0.5 + 0.4 * np.exp(-(np.hypot(r - 30, c - 70) ** 2) / 200)
    look = next_view(doubtful(e, p), e, SitesSettings(), LANDER, height_above_ground=40.0)
    assert look is not None
    assert_allclose(look.place_world, [7.0, 7.0, 3.0], atol=0.3)
    assert_allclose(look.position_world - look.place_world, [0, 0, 20.0])
    assert look.p_safe == pytest.approx(0.9, abs=0.01)
    low = next_view(doubtful(e, p), e, SitesSettings(), LANDER, height_above_ground=10.0)
    assert low is not None
    assert low.height == 8.0


def test_there_is_nothing_to_look_at_where_all_is_refused_or_one_place_is_safe() -> None:
    e = ground(np.zeros((101, 101)))
    refused = np.full((101, 101), Hazard.TERRAIN, np.uint8)
    assert next_view(doubtful(e, np.zeros((101, 101)), refused), e, SitesSettings(), LANDER, 40.0) is None
    refused[50, 50] = 0
    assert next_view(doubtful(e, np.full((101, 101), 0.9), refused), e, SitesSettings(), LANDER, 40.0) is None


def test_reserve_sites_follow_the_newest_map_and_say_why_they_fell_out() -> None:
    e = ground(np.zeros((101, 151)))
    first = choose(e)
    reserve = Reserve().updated(first, assess(e, None, LANDER, EXACT), apart=1.0)
    assert reserve.sites == first.sites
    assert reserve.lost == ()
    steep = ground(plane(101, 151, 0.4, 0.0))
    none = Reserve(first.sites).updated(choose(steep), assess(steep, None, LANDER, EXACT), apart=1.0)
    assert none.sites == ()
    assert [why for _, why in none.lost] == ["is too steep"] * len(first.sites)


def test_reserve_sites_that_the_newer_map_does_not_see_are_kept_behind_those_that_it_does() -> None:
    e = ground(np.zeros((101, 151)))
    here = choose(e, settings=SitesSettings(count=2))
    far = tuple(replace(s, east=s.east + 500.0) for s in here.sites)
    both = Reserve(far).updated(here, assess(e, None, LANDER, EXACT), apart=1.0)
    assert both.sites[:2] == here.sites
    assert [s.east for s in both.sites[2:]] == [s.east for s in far]
    assert [s.rank for s in both.sites] == [1, 2, 3, 4]


def test_terms_that_a_user_adds_move_the_choice_and_their_gaps_refuse() -> None:
    e = ground(np.zeros((101, 151)))
    h = assess(e, None, LANDER, EXACT)
    east = np.broadcast_to(np.linspace(0, 1, 151, dtype=np.float32), (101, 151)).copy()

    def first(values: np.ndarray) -> float:
        found = sites.choose_sites(h, None, e, SitesSettings(), LANDER, extra=[(100.0, values)]).sites
        return found[0].east if found else math.nan

    assert first(east) < 3.0
    assert first(-east) > 12.0
    assert math.isnan(first(np.full_like(east, np.nan)))
