"""Hazards against closed forms, and against the truth of a rendered scene."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from ground import GREY, covered, ground, land_cover, plane, textured
from numpy.testing import assert_allclose
from scipy.special import logit

from alight.arrays import F32
from alight.geometry import Grid
from alight.hazards import assess
from alight.hazards.evidence import green_spots, ground_odds, picture_spots
from alight.hazards.touchdown import measured_height
from alight.learned import read_floors
from alight.learned.terms import NearTerm
from alight.raster import clearance_of
from alight.records import Datum, ElevationMap, Flag, Hazard, HazardMap
from alight.settings import HazardsSettings, Lander

EXACT = HazardsSettings(tilt_sigma=0.0, smoothed=False)
MID = (40, 40)


def judge(height: np.ndarray, lander: Lander | None = None, settings: HazardsSettings = EXACT) -> HazardMap:
    return assess(ground(height), None, lander or Lander(radius=1.0), settings)


def refused(h: HazardMap, at: tuple[int, int] = MID) -> Hazard:
    return Hazard(int(h.reasons[at]))


def flat() -> np.ndarray:
    return np.zeros((81, 81))


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (0.1, 0.0), (0.0, -0.15), (0.1, 0.12), (0.3, 0.2)])
def test_a_plane_has_its_slope_and_no_roughness(east: float, north: float) -> None:
    h = judge(plane(81, 81, east, north))
    inside = (h.reasons & Hazard.EDGE) == 0
    assert_allclose(h.slope[inside], math.atan(math.hypot(east, north)), atol=1e-5)
    assert_allclose(h.roughness[inside], 0.0, atol=1e-5)
    steep = math.hypot(east, north) > math.tan(math.radians(10))
    assert (refused(h) == Hazard.SLOPE) if steep else (refused(h) == Hazard(0))
    assert_allclose(h.p_safe[MID], 0.0 if steep else 1.0)


def test_a_single_rock_deviates_by_its_height_less_what_the_plane_takes() -> None:
    z = flat()
    z[MID] = 0.2
    h = judge(z)
    n = 317  # cells within 10 cells
    assert_allclose(h.roughness[MID], 0.2 * (1 - 1 / n), atol=1e-5)
    assert refused(h) == Hazard.ROUGHNESS
    r, c = np.mgrid[:81, :81]
    inside = (h.reasons & Hazard.EDGE) == 0
    rocky = np.hypot(r - 40, c - 40) <= 10
    assert (((h.reasons & Hazard.ROUGHNESS) > 0) == rocky)[inside].all()


def test_a_step_is_as_high_as_it_is() -> None:
    z = flat()
    z[:, 41:] = 0.12
    lander = Lander(radius=1.0, max_step=0.1)
    h = judge(z, lander)
    assert_allclose(h.step[MID], 0.12, atol=1e-6)
    assert Hazard.STEP in refused(h)
    assert_allclose(h.step[40, 20], 0.0, atol=1e-6)
    assert refused(h, (40, 20)) == Hazard(0)


def test_a_crater_is_refused_on_its_wall_and_rim_and_not_far_away() -> None:
    r, c = np.mgrid[:201, :201]
    away = np.hypot(r - 100, c - 100) * 0.1
    z = np.where(away < 4, -1.0 * (1 - (away / 4) ** 2), 0.0)  # paraboloid: wall slope 2 d / R^2 x = 0.5 at the rim
    h = judge(z)
    assert_allclose(
        h.slope[100, 130], math.atan(2 * 1.0 * 3.0 / 16), atol=2e-3
    )  # slope of the paraboloid at its middle
    assert Hazard.SLOPE in refused(h, (100, 130))
    assert refused(h, (100, 100)) == Hazard(0)  # the bottom bends by d (r / R)^2 = 0.0625 m only
    assert_allclose(h.roughness[100, 100], 0.5 * 1.0 * (1.0 / 4) ** 2, rtol=0.06)
    assert refused(h, (100, 160)) == Hazard(0)


def test_unknown_ground_is_never_safe() -> None:
    z = flat()
    z[MID] = np.nan
    none = judge(z, settings=HazardsSettings(tilt_sigma=0.0, smoothed=False, unknown_share=0.0))
    r, c = np.mgrid[:81, :81]
    near = np.hypot(r - 40, c - 40) <= 10
    inside = (none.reasons & Hazard.EDGE) == 0
    assert (((none.reasons & Hazard.UNKNOWN) > 0) == near)[inside].all()
    few = judge(z, settings=HazardsSettings(tilt_sigma=0.0, smoothed=False, unknown_share=0.02))
    assert refused(few) == Hazard.UNKNOWN  # the centre's own cell
    assert refused(few, (40, 41)) == Hazard(0)  # one unknown cell of 317 beside the centre is allowed
    assert (judge(np.full((81, 81), np.nan)).reasons != 0).all()
    assert np.isnan(judge(np.full((81, 81), np.nan)).p_safe).all()


@pytest.mark.parametrize("flag", [Flag.MOVING, Flag.UNSEEN, Flag.RANGE, Flag.SATURATED, Flag.AMBIGUOUS])
def test_a_height_that_a_flag_refuses_is_unknown(flag: Flag) -> None:
    e = ground(flat())
    e.flags[30:50, 30:50] = flag
    assert Hazard.UNKNOWN in refused(assess(e, None, Lander(radius=1.0), EXACT))


def test_a_narrow_doubtful_gap_counts_as_known_only_if_it_agrees() -> None:
    agrees, differs, moves = (ground(flat()) for _ in range(3))
    for e in (agrees, differs):
        e.flags[38:40, 30:50] = Flag.AMBIGUOUS
    moves.flags[38:40, 30:50] = Flag.MOVING
    differs.height[38:40, 30:50] = 0.1
    lander = Lander(radius=1.0)
    assert refused(assess(agrees, None, lander, EXACT)) == Hazard(0)
    assert Hazard.UNKNOWN in refused(assess(differs, None, lander, EXACT))
    assert Hazard.UNKNOWN in refused(assess(moves, None, lander, EXACT))
    assert Hazard.UNKNOWN in refused(
        assess(agrees, None, lander, HazardsSettings(tilt_sigma=0.0, smoothed=False, bridge=0.0))
    )


def test_the_footprint_must_lie_on_the_map() -> None:
    h = judge(flat())
    edge = (h.reasons & Hazard.EDGE) > 0
    assert not edge[10:-10, 10:-10].any()
    assert edge.sum() == 81 * 81 - 61 * 61
    assert_allclose(h.clearance[MID], 3.05, atol=1e-5)  # 31 cells to the nearest refused centre, less half a cell


def test_what_rises_under_the_rotor_is_refused() -> None:
    z = flat()
    z[40, 58] = 1.0  # 1.8 m away
    assert refused(judge(z, Lander(radius=1.0))) == Hazard(0)
    assert refused(judge(z, Lander(radius=1.0, rotor_radius=1.9))) == Hazard.CLEARANCE
    assert refused(judge(z, Lander(radius=1.0, rotor_radius=1.7))) == Hazard(0)
    assert refused(judge(z, Lander(radius=1.0, rotor_radius=1.9, rotor_rise=1.1))) == Hazard(0)


def test_cover_may_refuse_and_never_permit() -> None:
    steep = ground(plane(81, 81, 0.3, 0.0))
    assert Hazard.SLOPE in refused(assess(steep, covered(steep, 1.0), Lander(radius=1.0), EXACT))
    e = ground(flat())
    p = np.ones((81, 81))
    p[40, 48] = 0.1
    cover = covered(e, p)
    assert refused(assess(e, cover, Lander(radius=1.0), EXACT)) == Hazard.TERRAIN
    assert refused(assess(e, cover, Lander(radius=0.7), EXACT)) == Hazard(0)
    assert refused(assess(e, covered(e, np.nan), Lander(radius=1.0), EXACT)) == Hazard(0)  # no evidence, no veto


FEET = ((0.6, 0.6), (0.6, -0.6), (-0.6, 0.6), (-0.6, -0.6))


def test_a_belly_on_a_rock_is_refused_and_beside_it_is_not() -> None:
    z = flat()
    z[MID] = 0.3
    lander = Lander(radius=0.9, feet=FEET, belly_clearance=0.25)
    h = judge(z, lander)
    assert refused(h) == Hazard.CLEARANCE
    assert refused(h, (40, 50)) == Hazard(0)
    taller = Lander(radius=0.9, feet=FEET, belly_clearance=0.35)
    assert refused(judge(z, taller)) == Hazard(0)


def test_a_foot_on_a_rock_tilts_the_lander_by_the_closed_form() -> None:
    z = flat()
    z[34, 46] = 0.2  # exactly under the north-eastern foot at heading north
    lander = Lander(radius=0.9, feet=FEET, headings=1, max_slope=math.radians(5))
    h = judge(z, lander)
    # at rest the lander stands on the rock, the opposite foot and one of the two others: 0.2 m in 1.2 m
    assert_allclose(h.slope[MID], math.atan(0.2 / 1.2), atol=1e-4)
    assert Hazard.SLOPE in refused(h)
    # any three: the foot opposite the rock is in the ground, and both legs climb 0.2 m in 1.2 m
    strict = judge(z, lander.model_copy(update={"support": "any"}))
    assert_allclose(strict.slope[MID], math.atan(0.2 / 1.2 * math.sqrt(2)), atol=1e-4)


def test_feet_that_sink_in_stand_on_the_mean_of_their_ground() -> None:
    z = flat()
    z[34, 46] = 0.9
    lander = Lander(radius=0.9, feet=FEET, foot_radius=0.1, foot_contact="mean", headings=1)
    assert_allclose(judge(z, lander).slope[MID], math.atan(0.9 / 5 / 1.2), atol=1e-4)  # five cells under a foot


@pytest.mark.parametrize("gear", [{"feet": FEET}, {"skids": (1.2, 1.0)}])
def test_gear_on_a_plane_tilts_with_it(gear: dict[str, object]) -> None:
    h = judge(plane(81, 81, 0.1, 0.05), Lander(radius=0.9, headings=4, **gear))  # type: ignore[arg-type]
    assert_allclose(h.slope[MID], math.atan(math.hypot(0.1, 0.05)), atol=1e-4)


def test_a_skid_on_an_edge_rolls_by_step_over_gauge() -> None:
    z = flat()
    z[:, 41:] = 0.1  # the right rail of a lander with its nose to the north stands on it
    h = judge(z, Lander(radius=0.9, skids=(1.2, 1.0), headings=1))
    assert_allclose(h.slope[MID], math.atan(0.1 / 1.0), atol=1e-4)
    along = judge(z, Lander(radius=0.9, skids=(1.2, 1.0), headings=2))
    assert_allclose(along.slope[MID], math.atan(0.1 / 1.0), atol=1e-4)  # south: the other rail


def test_a_skid_across_an_edge_pitches_on_it() -> None:
    z = flat()
    z[:37] = 0.1  # rows 34 to 36 of each rail (rows 34 to 46) are high: it rests on row 36 and on its rear end
    h = judge(z, Lander(radius=0.9, skids=(1.2, 1.0), headings=1))
    assert_allclose(h.slope[MID], math.atan(0.1 / 1.0), atol=1e-4)


def test_noise_makes_doubt_and_not_refusal() -> None:
    noise = np.random.default_rng(0).normal(0, 0.035, (81, 81))
    sure = assess(ground(flat(), sigma=0.01), None, Lander(radius=1.0), HazardsSettings(smoothed=False))
    unsure = assess(ground(noise, sigma=0.035), None, Lander(radius=1.0), HazardsSettings(smoothed=False))
    assert sure.p_safe[MID] > 0.99
    assert refused(sure) == Hazard(0)
    assert 0.3 < unsure.p_safe[MID] < 0.99
    assert refused(unsure) == Hazard.DOUBT


def test_a_belly_at_its_clearance_is_even_odds() -> None:
    z = flat()
    z[MID] = 0.2499
    lander = Lander(radius=0.9, feet=FEET, belly_clearance=0.25)
    p = assess(ground(z, sigma=0.02), None, lander, EXACT).p_safe
    assert_allclose(p[MID], 0.5, atol=0.02)
    assert p[40, 60] > 0.999  # the rock is not under it


def test_what_was_not_seen_costs_probability() -> None:
    z = flat()
    z[40, 44] = np.nan
    p = judge(z, settings=HazardsSettings(tilt_sigma=0.0, smoothed=False, bridge=0.0, hidden_hazard=0.5)).p_safe
    assert_allclose(p[MID], 1 - 0.5 / 317, atol=1e-6)
    assert p[60, 20] == 1.0


def test_a_slope_at_the_limit_is_even_odds() -> None:
    tan = math.tan(math.radians(10) - 1e-4)
    h = assess(ground(plane(81, 81, tan, 0.0), sigma=0.02), None, Lander(radius=1.0), HazardsSettings(smoothed=False))
    assert_allclose(h.p_safe[MID], 0.51, atol=0.02)


def test_quality_falls_with_slope_roughness_cover_and_doubt() -> None:
    lander = Lander(radius=1.0)
    e = ground(flat())
    best = assess(e, covered(e, 1.0), lander, EXACT).quality[MID]
    assert_allclose(best, 0.0, atol=1e-6)
    tilted = assess(ground(plane(81, 81, math.tan(math.radians(5)), 0.0)), None, lander, EXACT).quality[MID]
    assert_allclose(tilted, -0.25, atol=1e-3)
    assert_allclose(assess(e, covered(e, 0.8), lander, EXACT).quality[MID], -0.2, atol=1e-5)
    doubtful = assess(ground(flat(), sigma=0.075), None, lander, EXACT).quality[MID]
    assert_allclose(doubtful, -0.25, atol=1e-4)


def test_quality_is_less_where_ground_is_dark_or_patchy() -> None:
    """A wet patch and the rim of a light one lower the quality; texture of 5 % costs little; no place is refused."""
    lander, shape = Lander(radius=0.5), (141, 141)
    rgb = textured(GREY, shape, 0.05, 1)
    wet, light = np.s_[20:35, 20:35], np.s_[80:105, 80:105]
    rgb[wet] = (rgb[wet] * 0.65).astype(np.uint8)
    rgb[light] = (rgb[light] * 1.4).astype(np.uint8)
    h = assess(ground(np.zeros(shape), rgb=rgb), None, lander, EXACT)
    assert -2.0 < h.quality[27, 27] < -0.9
    assert h.quality[92, 92] > -0.1
    assert -1.2 < h.quality[92, 80] < -0.4
    assert np.median(h.quality[10:-10, 10:-10]) > -0.1
    assert (h.reasons[10:-10, 10:-10] == 0).all()
    unseen = assess(ground(np.zeros(shape), rgb=(0, 0, 0)), None, lander, EXACT)
    assert_allclose(unseen.quality[60, 60], 0.0, atol=1e-6)


def test_one_small_dark_patch_costs_a_footprint_as_much_as_a_large_one() -> None:
    """A puddle of 0.4 m covers only 2 % of a footprint of 3 m."""
    lander, shape = Lander(radius=1.5), (161, 161)
    rgb = textured(GREY, shape, 0.05, 1)
    rgb[78:82, 78:82] = (rgb[78:82, 78:82] * 0.65).astype(np.uint8)  # cells of 0.1 m
    quality = assess(ground(np.zeros(shape), rgb=rgb), None, lander, EXACT).quality
    assert quality[80, 80] < -0.8
    assert quality[80, 92] < -0.8  # at the rim of its footprint
    assert quality[80, 120] > -0.1


def test_maps_of_two_grids_are_refused() -> None:
    e = ground(flat())
    with pytest.raises(ValueError, match="one grid"):
        assess(e, covered(ground(np.zeros((5, 5))), 1.0), Lander(), EXACT)


def test_landers_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="not both"):
        Lander(feet=FEET, skids=(1.0, 1.0))
    with pytest.raises(ValueError, match="one line"):
        Lander(feet=((0, 0), (1, 1), (2, 2)))
    with pytest.raises(ValueError, match="above 0"):
        Lander(skids=(1.0, 0.0))


def test_the_rule_of_the_rendered_scene_is_reproduced(shared_data: Path) -> None:
    truth = shared_data / "sample" / "truth"
    with rasterio.open(truth / "dem.tif") as d, rasterio.open(truth / "class.tif") as c:
        height, classes = d.read(1), c.read(1)
    e = ground(height - 301)
    h = assess(e, covered(e, np.isin(classes, [1, 2, 7])), Lander(), EXACT)
    # scene.yaml has 0.196248 of 2,250,000 cells: six decimals, cut (441,560 cells are 0.1962489)
    assert abs((h.reasons == 0).mean() - 0.196248) < 1e-6
    row, col = 834, 921  # its best site, east 17.15 north -8.45
    assert_allclose(h.clearance[row, col], 6.47, atol=0.005)
    assert_allclose(math.degrees(h.slope[row, col]), 0.97, atol=0.005)
    assert_allclose(h.roughness[row, col], 0.043, atol=0.0005)


def pictured(stone: bool, cell: float = 0.1) -> ElevationMap:
    """Level, accurately measured ground, evenly grey on pixels of half a cell; the stone is not in the heights."""
    fine = np.full((162, 162, 3), 150, np.uint8)
    if stone:
        fine[80:83, 82:85] = 40
    return replace(ground(flat(), sigma=0.005, rgb=(150, 150, 150), cell=cell), fine=fine)


def test_a_stone_that_the_heights_do_not_show_costs_probability_where_they_are_matched() -> None:
    seen, clear = (assess(pictured(s), None, Lander(radius=1.0), HazardsSettings()).p_safe for s in (True, False))
    assert logit(clear[MID]) - logit(seen[MID]) > 0.5  # by how much, depends on the fit and the other terms
    r, c = np.mgrid[:81, :81]
    assert seen[np.hypot(r - 40, c - 41) <= 7].max() < clear[MID]
    assert_allclose(seen[40, 15], clear[40, 15], atol=1e-6)
    assert_allclose(assess(pictured(True), None, Lander(radius=1.0), EXACT).p_safe[MID], 1.0)  # as measured exactly


@pytest.mark.parametrize(
    ("sigma", "high", "counts"),
    [(0.02, 0.3, True), (0.2, 0.3, True), (0.3, 1.5, True), (0.24, 0.6, True), (0.6, 1.5, True), (0.3, 0.3, False)],
)
def test_a_doubtful_height_tells_of_an_obstacle_unless_its_sigma_says_that_it_is_noise(
    sigma: float, high: float, counts: bool
) -> None:
    """A stone of 0.4 m stands 0.6 m from the middle of the footprint, on level ground that was sampled finely."""
    r, c = np.mgrid[:81, :81]
    stone = np.hypot(r - 40, c - 46) * 0.1 < 0.2
    level = ground(flat(), sigma=0.005, cell=0.1)
    fine = {"sampling": np.full_like(level.height, 0.02), "fine_sampling": np.full_like(level.height, 0.01)}
    level = replace(level, **fine)
    doubtful = replace(
        level, height=np.where(stone, np.float32(high), level.height),
        sigma=np.where(stone, np.float32(sigma), level.sigma),
        flags=np.where(stone, np.uint16(Flag.UNSURE), level.flags),
    )  # fmt: skip
    clear, seen = (assess(e, None, Lander(radius=1.0), HazardsSettings()) for e in (level, doubtful))
    measured = measured_height(doubtful, Lander(radius=1.0), HazardsSettings())
    assert np.isfinite(measured[stone]).all() == counts
    assert np.isfinite(measured[~stone]).all()
    assert (seen.p_safe[MID] < 0.7 * clear.p_safe[MID]) == counts


def test_rock_counts_as_ground_that_bears_where_the_classes_say_so() -> None:
    grid, label = Grid(0.0, 0.0, 0.1, 1, 1), np.ones((1, 1), np.uint8)
    landable, bears = (np.full((1, 1), p, np.float32) for p in (0.6, 0.99))
    assert_allclose(ground_odds(land_cover(grid, label, landable, bears=bears), (1, 1)), logit(0.01), atol=0.01)
    assert ground_odds(None, (1, 1))[0, 0] < logit(0.001)


def test_a_brighter_exposure_has_the_same_spots() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(40, 80, (81, 81, 3)).astype(np.uint8)
    dim, bright = (picture_spots(ground(flat(), rgb=k * rgb), 0.15) for k in (1, 3))
    assert_allclose(bright.dark, dim.dark, atol=0.03)
    assert dim.dark.max() > 0.05
    assert_allclose(bright.power.mean(), dim.power.mean(), rtol=0.1)


def tuft(colour: tuple[int, int, int], gain: float = 1.0) -> ElevationMap:
    """Grey ground with a spot of 0.3 m in another colour."""
    rgb = np.full((81, 81, 3), (60, 60, 60), np.float32)
    rgb[39:42, 39:42] = colour
    return ground(flat(), rgb=(gain * rgb).astype(np.uint8))


def test_a_green_spot_stands_out_at_any_exposure_and_a_brown_one_does_not() -> None:
    green, brighter, brown = (
        green_spots(e, 0.15) for e in (tuft((50, 70, 40)), tuft((50, 70, 40), 3.0), tuft((80, 60, 40)))
    )
    assert green[MID] > 0.1
    assert green[10, 10] < 0.01
    assert_allclose(brighter, green, atol=0.01)
    assert brown.max() < 0.02


def test_a_grey_picture_does_not_count_as_one_without_green() -> None:
    assert (green_spots(tuft((90, 90, 90)), 0.15) == 0.02).all()


def test_what_was_not_seen_is_no_green_spot() -> None:
    e = tuft((50, 70, 40))
    e.rgb[:20] = 0
    spots = green_spots(e, 0.15)
    assert (spots[:20] == 0).all()
    assert np.abs(spots[20:30]).max() < 0.02


def ground_factor(found: HazardMap) -> F32:
    assert np.isnan(found.p_ground).all()  # the kind of ground was not judged; what the heights tell of it counts
    return np.asarray(found.p_safe / (found.p_relief * found.p_obstacle))


def test_a_tuft_that_matching_has_flattened_is_evidence_against_the_ground_from_near_by() -> None:
    near = [
        replace(e, sampling=np.full_like(e.height, 0.04), fine_sampling=np.full_like(e.height, 0.02))
        for e in (tuft((62, 61, 60)), tuft((50, 70, 40)))
    ]
    bare, green = (assess(e, None, Lander(radius=1.0), HazardsSettings()) for e in near)
    assert 1 - ground_factor(green)[MID] > 10 * (1 - ground_factor(bare)[MID])


def test_ground_seen_from_far_is_less_sure_than_the_same_ground_seen_from_near() -> None:
    """The raster is the same; only samplings and pixels differ."""
    e = pictured(False)
    near, far, farther = (
        assess(
            replace(e, sampling=np.full_like(e.height, 2 * g), fine_sampling=np.full_like(e.height, g)),
            None, Lander(radius=1.0), HazardsSettings(),
        )
        for g in (0.02, 0.08, 0.16)
    )  # fmt: skip
    assert near.p_safe[MID] > far.p_safe[MID] > farther.p_safe[MID]
    assert near.resolved[MID] < 0.3 * far.resolved[MID]
    assert_allclose(ground_factor(farther), ground_factor(far), rtol=1e-4)
    assert ground_factor(near)[MID] > ground_factor(far)[MID]


def test_a_finer_raster_never_makes_coarse_ground_look_smooth() -> None:
    """A map is interpolated to half its cell size, with its coarse samplings: P may be lower, but not higher."""
    rng = np.random.default_rng(2)
    coarse = ground(
        cv2.GaussianBlur(rng.normal(0, 0.1, (81, 81)).astype(np.float32), (0, 0), 2.0), cell=0.1, sigma=0.01
    )
    coarse = replace(
        coarse, sampling=np.full_like(coarse.height, 0.12), fine_sampling=np.full_like(coarse.height, 0.08)
    )
    big = (162, 162)
    fine = ground(cv2.resize(coarse.height, big, interpolation=cv2.INTER_LINEAR), cell=0.05, sigma=0.01)
    fine = replace(fine, sampling=np.full_like(fine.height, 0.12), fine_sampling=np.full_like(fine.height, 0.08))
    p, q = (assess(m, None, Lander(radius=1.0), HazardsSettings()) for m in (coarse, fine))
    assert q.p_obstacle[80, 80] <= p.p_obstacle[40, 40] + 0.03
    assert_allclose(q.resolved[80, 80], p.resolved[40, 40], rtol=1e-5)


def test_the_view_that_settles_a_doubt_about_obstacles_has_the_pixel_that_shows_them() -> None:
    e = pictured(False)
    far = replace(e, sampling=np.full_like(e.height, 0.2), fine_sampling=np.full_like(e.height, 0.1))
    found = assess(far, None, Lander(radius=1.0), HazardsSettings())
    assert found.p_obstacle[MID] < min(found.p_relief[MID], ground_factor(found)[MID])
    assert 0.005 < found.settles_at[MID] < 0.1
    assert found.settles_at[MID] < far.picture_sampling[MID]


def test_single_heights_far_beyond_their_sigma_refuse_even_where_their_mean_is_level() -> None:
    z = flat()
    z[MID] = 0.3
    assert Hazard.ROUGHNESS in refused(assess(ground(z, sigma=0.03), None, Lander(radius=1.0), HazardsSettings()))
    assert Hazard.ROUGHNESS not in refused(assess(ground(z, sigma=0.06), None, Lander(radius=1.0), HazardsSettings()))


def test_ground_that_nobody_could_measure_is_not_safe_and_what_nobody_saw_even_less() -> None:
    e = ground(flat(), sigma=0.005)
    flags = e.flags.copy()
    flags[30:51, 25:56] = Flag.UNSURE
    half = replace(e, flags=flags)
    assert Hazard.UNKNOWN in refused(assess(half, None, Lander(radius=1.0), HazardsSettings(bridge=0.0)))
    few = e.flags.copy()
    few[38:42, 38:42] = Flag.UNSURE  # 5 % of the footprint
    assert Hazard.UNKNOWN not in refused(
        assess(replace(e, flags=few), None, Lander(radius=1.0), HazardsSettings(bridge=0.0))
    )
    few[38:42, 38:42] = Flag.UNSEEN
    assert Hazard.UNKNOWN in refused(
        assess(replace(e, flags=few), None, Lander(radius=1.0), HazardsSettings(bridge=0.0))
    )


def test_a_map_that_may_lean_makes_a_slope_near_the_limit_less_sure() -> None:
    """Exact poses give no tilt; the tilt of the map's poses counts, and the user's tilt is added."""
    near = ground(plane(81, 81, math.tan(math.radians(9.6)), 0.0))
    level = Datum(0.0, 0.0, np.diag([0.1, 1e-3, 1e-3]) ** 2)
    leaning = replace(level, covariance=np.diag([0.1, 5e-3, 20e-3]) ** 2)
    assert leaning.tilt_sigma == pytest.approx(20e-3)

    def p(datum: Datum | None, said: float = 0.0) -> float:
        settings = HazardsSettings(tilt_sigma=said, smoothed=False)
        return float(assess(replace(near, datum=datum), None, Lander(radius=1.0), settings).p_safe[MID])

    assert p(None) >= p(level) > p(leaning)
    assert p(level) > 0.999
    assert 0.55 < p(leaning) < 0.75  # the limit is 0.35 sigma away
    assert p(None, 20e-3) == pytest.approx(p(leaning), abs=1e-3)
    both = replace(level, covariance=np.diag([0.1, 5e-3, 25e-3]) ** 2)
    assert p(leaning, 15e-3) == pytest.approx(p(both), abs=1e-3)


def test_clearance_has_the_same_bits_whatever_else_the_machine_does() -> None:
    """A verdict made beside other work must be that of a replay."""
    safe = np.random.default_rng(1).uniform(size=(143, 187)) > 0.02
    found, before = [], cv2.getNumThreads()
    for threads in (1, 2, 4):
        cv2.setNumThreads(threads)
        found.append(clearance_of(safe, 0.1).tobytes())
    cv2.setNumThreads(before)
    assert len(set(found)) == 1


def test_a_broad_deviation_counts_at_the_limit_and_a_narrow_one_from_half_of_it() -> None:
    """The rim of a ditch is as high as measured, whereas a stone may be higher."""
    over = np.array([0.3, 0.67, 0.8, 0.9, 1.0, 1.1, 2.0], np.float32)

    def expected(narrow: float) -> np.ndarray:
        terms = {NearTerm.RISE: np.log(over), NearTerm.NARROW: np.full_like(over, narrow)}
        return read_floors()["deviation"].expected(terms)

    assert_allclose(expected(0.2), [0, 0, 0, 0, 0.39, 0.78, 0.78], atol=1e-6)
    assert_allclose(expected(1.0)[[0, 2, -1]], [0, 0.39, 0.78], atol=1e-6)
    between = expected(0.75)
    assert_allclose(between, (expected(0.2) + expected(1.0)) / 2, atol=1e-6)
    assert (np.diff(between) >= 0).all()
