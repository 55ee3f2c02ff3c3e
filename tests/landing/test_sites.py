"""Sites: their order, the distance between them, and the sentence if there is none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ground import covered, ground, plane
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.landing import sites
from alight.landing.reserve import Reserve
from alight.landing.sites import Observer, next_view
from alight.raster import clearance_of
from alight.records import ElevationMap, Flag, Hazard, HazardMap, NextView, Sites, Terrain, TerrainMap
from alight.settings import HazardsSettings, Lander, SitesSettings

LANDER = Lander(radius=1.0)
EXACT = HazardsSettings(tilt_sigma=0.0, smoothed=False)


def choose(
    e: ElevationMap,
    t: TerrainMap | None = None,
    settings: SitesSettings | None = None,
    vehicle: np.ndarray | None = None,
) -> Sites:
    seen = None if vehicle is None else Observer(vehicle, float(vehicle[2]), focal=600.0, stereo=False)
    return sites.choose_sites(assess(e, t, LANDER, EXACT), t, e, settings or SitesSettings(), LANDER, seen)


def rocky(rows: int = 101, cols: int = 151) -> np.ndarray:
    """Return heights with a field of rocks on the left and open ground on the right."""
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


def test_of_even_ground_the_dry_part_comes_before_a_wet_patch() -> None:
    """The middle has the most room around it, but it is wet."""
    rgb = np.full((101, 101, 3), 130, np.uint8)
    dry = choose(ground(np.zeros((101, 101)), rgb=rgb)).sites[0]
    assert math.hypot(dry.east - 5.0, dry.north - 5.0) < 0.2
    rgb[40:61, 40:61] = 85
    beside = choose(ground(np.zeros((101, 101)), rgb=rgb)).sites[0]
    assert math.hypot(beside.east - 5.0, beside.north - 5.0) > 1.4


def test_sites_keep_apart() -> None:
    e = ground(np.zeros((121, 121)))
    found = choose(e, settings=SitesSettings(count=6, separation=4.5)).sites
    assert len(found) == 5
    at = np.array([[s.east, s.north] for s in found])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=2)[~np.eye(5, dtype=bool)]
    assert gaps.min() > 4.5
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
    """A hazard map with these probabilities of obstacles, undecided everywhere or for these reasons."""
    h = assess(e, None, LANDER, EXACT)
    why = np.full(e.grid.shape, Hazard.DOUBT, np.uint16) if reasons is None else reasons
    one, p = np.ones(e.grid.shape, np.float32), p.astype(np.float32)
    return replace(
        h,
        p_safe=p,
        p_relief=one,
        p_obstacle=p,
        p_ground=one,
        reasons=why,
        clearance=clearance_of(why == 0, e.grid.cell),
    )


def undecided(h: HazardMap, e: ElevationMap, observer: Observer | None = None, **settings: float) -> Sites:
    return sites.choose_sites(h, None, e, SitesSettings(**settings), LANDER, observer)  # type: ignore[arg-type]


def hill_of_chance(row: int, col: int, height: float = 0.4) -> np.ndarray:
    """Probabilities (101, 101) of 0.5, higher about one cell."""
    r, c = np.mgrid[:101, :101]
    return np.asarray(0.5 + height * np.exp(-(np.hypot(r - row, c - col) ** 2) / 200))


def test_candidates_are_what_nothing_refuses_the_surest_first_and_apart() -> None:
    e = ground(np.full((101, 101), 3.0))
    why = np.full((101, 101), Hazard.DOUBT, np.uint8)
    why[:, 60:] = Hazard.ROUGHNESS | Hazard.DOUBT  # refused for good, for any probability
    found = undecided(doubtful(e, hill_of_chance(30, 40), why), e)
    assert found.sites == ()
    assert found.reason.startswith("no safe site: ")
    first = found.candidates[0]
    assert [c.rank for c in found.candidates] == list(range(1, len(found.candidates) + 1))
    assert math.hypot(first.east - 4.0, first.north - 7.0) < 1.0
    assert all(c.kind == "candidate" and c.doubt == "obstacle" and c.east < 5.5 for c in found.candidates)
    assert first.p_safe > found.candidates[-1].p_safe + 0.1
    assert_allclose(first.clearance, (60 - first.east / 0.1 - 0.5) * 0.1, atol=1e-5)
    assert first.look is None  # no observer is given


def test_candidates_are_spread_over_the_ground() -> None:
    """The chance is best on a patch of 6 m that has room for the whole list, and fair everywhere else."""
    p = np.full((301, 301), 0.7)
    p[20:80, 20:80] = 0.9
    e = ground(np.zeros((301, 301)))
    found = undecided(doubtful(e, p), e, count=5).candidates
    at = np.array([[c.east, c.north] for c in found])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=2)[~np.eye(len(at), dtype=bool)]
    assert len(found) == 5
    assert gaps.min() > 10.0
    assert found[0].p_safe == pytest.approx(0.9)  # the best one is listed first
    assert len(undecided(doubtful(e, p), e, count=40).candidates) == 40  # a long list is filled with nearer ones


def test_one_lucky_cell_is_no_good_candidate() -> None:
    e = ground(np.zeros((101, 101)))
    p = hill_of_chance(30, 70, 0.2)
    p[80, 20] = 0.94
    first = undecided(doubtful(e, p), e).candidates[0]
    assert math.hypot(first.east - 7.0, first.north - 7.0) < 1.0


def test_quality_ranks_candidates_of_equal_chance() -> None:
    z = plane(61, 121, 0.0, 0.0)
    z[:, 61:] = plane(61, 60, 0.12, 0.0)
    e = ground(z)
    assert undecided(doubtful(e, np.full((61, 121), 0.7)), e).candidates[0].east < 6.0


def test_sites_and_candidates_share_the_list_and_keep_four_radii_apart() -> None:
    e = ground(np.zeros((101, 201)))
    why = np.full((101, 201), Hazard.DOUBT, np.uint8)
    why[:, :60] = 0
    p = np.where(why == 0, 0.99, 0.7)
    found = undecided(doubtful(e, p, why), e, count=12)
    assert found.sites
    assert found.candidates
    assert found.reason == ""
    assert [s.rank for s in found.listed] == list(range(1, len(found.listed) + 1))
    assert len(found.listed) <= 12
    at = np.array([[s.east, s.north] for s in found.listed])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=2)[~np.eye(len(at), dtype=bool)]
    assert gaps.min() > 4.0


def test_a_separation_below_four_radii_does_not_hold() -> None:
    assert sites.separation(SitesSettings(separation=1.0), LANDER) == 4.0
    assert sites.separation(SitesSettings(separation=9.0), LANDER) == 9.0
    assert sites.separation(SitesSettings(), LANDER) == 4.0


def test_a_verdict_on_coarser_cells_than_the_heights_has_the_same_places() -> None:
    """Height, sigma and class of a site are those of its footprint, each on its own grid."""
    fine = ground(np.add.outer(np.zeros(160), 0.02 * np.arange(160)), cell=0.05)
    coarse = fine.grid.coarser(4)
    judged = ground(np.add.outer(np.zeros(40), 0.08 * np.arange(40)), cell=0.2)
    judged = replace(judged, grid=coarse)
    t = covered(fine, 1.0, Terrain.PAVED)
    steep = Lander(radius=1.0, max_slope=0.6, max_roughness=0.8)
    found = sites.choose_sites(assess(judged, None, steep, EXACT), t, fine, SitesSettings(), steep).sites
    assert found
    for s in found:
        assert_allclose(s.up, 0.02 * (s.east - fine.grid.east) / 0.05, atol=0.02)
        assert s.terrain == Terrain.PAVED


# -- the next view


def watcher(height: float = 40.0, stereo: bool = False, east: float = -20.0) -> Observer:
    return Observer(np.array([east, 7.0, 3.0 + height]), height, focal=600.0, stereo=stereo)


def look_of(observer: Observer, settles_at: float) -> NextView | None:
    """Return the view of the first candidate, at (7, 7, 3)."""
    e = ground(np.full((101, 101), 3.0))
    h = replace(doubtful(e, hill_of_chance(30, 70)), settles_at=np.full((101, 101), settles_at, np.float32))
    return undecided(h, e, observer).candidates[0].look


def test_the_next_view_is_as_low_as_the_pixel_has_to_be_fine() -> None:
    """Pixels of 2 cm at a focal length of 600 need 12 m; one camera needs 0.12 of it as baseline, to the vehicle."""
    look = look_of(watcher(), 0.02)
    assert look is not None
    assert look.height == pytest.approx(12.0)
    assert look.settles
    assert look.position_world[2] == pytest.approx(15.0, abs=1e-6)
    assert look.position_world[0] == pytest.approx(7.0 - 0.12 * 12.0, abs=0.3)


def test_two_cameras_look_from_straight_above() -> None:
    e = ground(np.full((101, 101), 3.0))
    h = replace(doubtful(e, hill_of_chance(30, 70)), settles_at=np.full((101, 101), 0.02, np.float32))
    first = undecided(h, e, watcher(stereo=True)).candidates[0]
    assert first.look is not None
    assert_allclose(first.look.position_world, [first.east, first.north, 15.0], atol=1e-5)


@pytest.mark.parametrize(("settles_at", "height", "settles"), [(1.0, 40.0, True), (0.005, 8.0, False)])
def test_the_next_view_is_not_above_the_vehicle_nor_below_the_least_height(
    settles_at: float, height: float, settles: bool
) -> None:
    look = look_of(watcher(), settles_at)
    assert look is not None
    assert (look.height, look.settles) == (height, settles)


def test_there_is_no_next_view_where_no_pixel_settles_the_doubt() -> None:
    assert look_of(watcher(), math.nan) is None


def test_a_vehicle_overhead_looks_from_beside_the_place_too() -> None:
    look = next_view(np.zeros(3), 0.02, watcher(east=0.0), SitesSettings())
    overhead = next_view(np.array([0.0, 7.0, 0.0]), 0.02, watcher(east=0.0), SitesSettings())
    for view, place in ((look, np.zeros(2)), (overhead, np.array([0.0, 7.0]))):
        assert view is not None
        assert np.hypot(*(view.position_world[:2] - place)) == pytest.approx(0.12 * 12.0)


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


def test_a_small_footprint_on_doubtful_ground_has_a_height() -> None:
    """A plain gap between trusted cells is bridged (G0); the footprint of a small lander may lie in it."""
    e, lander = ground(np.full((41, 41), 2.0), sigma=0.01), Lander(radius=0.3)
    e.flags[14:27, 14:27] = Flag.TEXTURE
    e = replace(e, sigma=np.where(e.trusted, e.sigma, np.float32(0.005)))
    h = assess(e, None, lander, EXACT)
    middle = np.zeros(h.reasons.shape, np.bool_)
    middle[20, 20] = True
    reasons = np.where(middle, h.reasons, np.uint16(Hazard.SLOPE))
    h = replace(h, reasons=reasons, clearance=np.full_like(h.clearance, 2.0))
    (found,) = sites.choose_sites(h, None, e, SitesSettings(), lander).sites
    assert_allclose((found.up, found.height_sigma), (2.0, 0.005), atol=1e-6)


def test_a_height_may_lie_just_beyond_the_footprint_on_finer_cells() -> None:
    fine = ground(np.full((80, 80), 2.0), cell=0.05)
    fine.height[30:50, 30:50] = np.nan
    fine.height[40, 40] = 3.0
    judged = replace(ground(np.full((20, 20), 2.0), cell=0.2), grid=fine.grid.coarser(4))
    h, lander = assess(judged, None, Lander(radius=0.4), EXACT), Lander(radius=0.05)
    only = np.where(np.arange(400).reshape(20, 20) == 210, 0, int(Hazard.SLOPE)).astype(np.uint16)  # row 10, column 10
    (found,) = sites.choose_sites(
        replace(h, reasons=only, clearance=np.full_like(h.clearance, 2.0)), None, fine, SitesSettings(), lander
    ).sites
    assert found.up == 3.0


def test_no_site_on_coarser_cells_than_the_heights_comes_with_its_reason() -> None:
    fine, lander = ground(np.zeros((80, 80)), cell=0.05), Lander(radius=1.0)
    judged = replace(ground(plane(40, 40, 0.5, 0.0)), grid=fine.grid.coarser(2))
    found = sites.choose_sites(assess(judged, None, lander, EXACT), None, fine, SitesSettings(), lander)
    assert found.sites == ()
    assert "too steep" in found.reason
