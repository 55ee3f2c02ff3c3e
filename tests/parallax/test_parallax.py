"""Parallax on synthetic views: heights, edges, refused heights, the range. A parallax pixel is 0.5 m."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ground_views import DOWN, UP, Scene, Texture, box, plane
from length import first
from numpy.testing import assert_allclose, assert_array_equal
from parts import nothing_known, with_parts

from alight.geometry import Camera, Grid, Pose, so3_exp
from alight.parallax.batch import Images, match_tile
from alight.parallax.gauss_newton import Fit, Skyline
from alight.parallax.plane_sweep import parallax_per_metre
from alight.parallax.recursive import RecursiveParallax
from alight.parallax.sparse_points import ViewFeatures, find_points, height_range, pair_points, triangulate_pair
from alight.parallax.uncertainty import pooled
from alight.parallax.views import choose_views, colour_at, ground_sampling, may_see, prepare_view
from alight.records import REFUSED, Flag, Heights, View, is_trusted
from alight.settings import ParallaxSettings
from alight.settings.tuning.parallax import PointsTuning
from alight.spread import nmad

CELL = 0.2
GRID = Grid(-5.9, 4.5, CELL, 46, 60)
EAST, NORTH = np.meshgrid(*GRID.xy())
SPACING, COUNT = 1.6, 6
PX = CELL * UP / (SPACING * (COUNT - 1))  # metres of height that move the outermost views by one cell
LOW, HIGH = -1.5, 2.5
BOX = 2.5  # metres: five parallax pixels


def scene(**changes: object) -> Scene:
    return Scene(**({"spacing": SPACING} | changes))  # type: ignore[arg-type]


@cache
def level_views() -> tuple[View, ...]:
    return tuple(scene().views(COUNT))


@cache
def noisy_views() -> tuple[View, ...]:
    return tuple(scene(paint=Texture(1, contrast=12.0), noise=8.0, seed=1).views(COUNT))


@cache
def box_views() -> tuple[View, ...]:
    return tuple(scene(surface=box(BOX), top=BOX + 0.2).views(COUNT))


def heights(views: list[View] | tuple[View, ...], low: float = LOW, high: float = HIGH) -> Heights:
    found = match_tile(Images(list(views), CELL, 0.0), GRID, low, high, ParallaxSettings())
    assert found is not None
    assert set(found.chosen.tolist()) <= set(range(len(views)))
    return found.heights


def trusted(found: Heights) -> np.ndarray:
    return np.isfinite(found.height) & ((found.flags & np.uint16(REFUSED)) == 0)


# -- heights


@pytest.mark.parametrize("ground", [plane(), plane(level=0.8), plane(0.1, -0.08)], ids=["level", "raised", "slanted"])
def test_a_plane_is_found_to_a_twentieth_of_a_parallax_pixel(ground: object) -> None:
    s = scene(surface=ground, top=1.5)
    found = heights(s.views(COUNT))
    error = found.height - s.surface(EAST, NORTH)
    assert trusted(found).mean() > 0.98
    assert abs(np.median(error)) < 0.01 * PX
    assert nmad(error) < 0.05 * PX
    assert np.percentile(np.abs(error), 95) < 0.12 * PX


def test_a_box_is_found_and_its_walls_are_marked() -> None:
    """Two cells from the walls of the box heights are right again; nearer, STEP is set."""
    found = heights(box_views(), high=4.0)
    out = np.maximum(np.abs(EAST), np.abs(NORTH)) - 2.0  # metres outside the box
    error = np.abs(found.height - np.where(out < 0, BOX, 0.0))
    assert np.percentile(error[out < -0.8], 95) < 0.1 * PX
    assert np.percentile(error[out > 1.2], 95) < 0.1 * PX
    assert np.median(error[np.abs(out) < 0.8]) > np.median(error[out > 1.2])
    step = (found.flags & Flag.STEP) != 0
    assert step[(np.abs(out) < 0.8)].mean() > 0.4
    assert not step[out > 2.0].any()


def test_gain_and_offset_of_the_views_do_not_matter() -> None:
    changed = heights(scene().views(COUNT, gains=(1.0, 0.6, 1.3), offsets=(0.0, 30.0, -40.0)))
    same = heights(level_views())
    assert trusted(changed).mean() > 0.98
    assert nmad(changed.height) < 0.05 * PX
    assert np.percentile(np.abs(changed.height - same.height), 95) < 0.06 * PX


def test_the_same_views_give_the_same_bits() -> None:
    a, b = heights(level_views()), heights(level_views())
    for f in ("height", "sigma", "flags", "views", "rgb", "residual"):
        assert getattr(a, f).tobytes() == getattr(b, f).tobytes()


# -- unseen cells


def seeing(grid: Grid, margin: float) -> np.ndarray:
    """Number of views with level ground in their picture, or within `margin` pixels of it."""
    x, y = np.meshgrid(*grid.xy())
    ground = np.stack([x, y, np.zeros_like(x)], axis=-1)
    count = np.zeros(grid.shape, int)
    for v in level_views():
        uv = v.camera.project(v.world_from_cam.inverse.apply(ground))
        last = np.array([v.camera.width, v.camera.height]) - 1 + margin
        count += ((uv >= -margin) & (uv <= last)).all(-1)
    return count


def test_what_no_two_views_see_stays_unknown() -> None:
    """The grid reaches far beyond the pictures: it is NaN and UNSEEN there, never filled from the neighbours."""
    wide = Grid(-29.9, 4.5, CELL, 46, 300)
    matched = match_tile(Images(level_views(), CELL, 0.0), wide, LOW, HIGH, ParallaxSettings())
    assert matched is not None
    found = matched.heights
    count, about = seeing(wide, 0.0), seeing(wide, 2.0)
    nobody = count == 0
    assert nobody.mean() > 0.1
    assert np.isnan(found.height[nobody]).all()
    unseen = (found.flags & np.uint16(Flag.UNSEEN)) != 0
    assert unseen[nobody].all()
    assert_array_equal(found.views[nobody], 0)
    assert np.isfinite(found.height[count >= 3]).mean() > 0.99
    ok = trusted(found)
    assert not ok[about < 2].any()  # at the very border the height decides whether a second view sees the cell
    assert np.percentile(np.abs(found.height[ok]), 99) < PX
    few = (found.flags & np.uint16(Flag.FEW)) != 0
    assert few[(count == 2) & np.isfinite(found.height)].mean() > 0.8


def test_views_that_do_not_see_the_grid_are_ignored() -> None:
    v = list(level_views())
    away = replace(v[0], world_from_cam=Pose(DOWN, np.array([400.0, 0.0, UP])))
    up = replace(v[0], world_from_cam=Pose(np.eye(3), np.array([0.0, 0.0, UP])))
    together = heights([away, *v, up])
    assert together.height.tobytes() == heights(v).height.tobytes()
    for few in ([away, up, v[0]], []):
        assert match_tile(Images(few, CELL, 0.0), GRID, LOW, HIGH, ParallaxSettings()) is None


@pytest.mark.parametrize("high", [UP - 0.01, UP + 5.0])
def test_heights_as_high_as_the_cameras_are_not_swept(high: float) -> None:
    """Planes near a camera would need pictures a thousand times as wide as the ground."""
    found = heights(level_views(), LOW, high)
    assert np.nanmedian(np.abs(found.height[is_trusted(found.flags)])) < 0.5 * PX
    assert match_tile(Images(list(level_views()), CELL, UP), GRID, UP + 1.0, UP + 5.0, ParallaxSettings()) is None


@pytest.mark.parametrize("ground", [19.99, 20.0, 25.0])
def test_a_view_that_stands_no_higher_than_the_ground_can_still_be_made_ready(ground: float) -> None:
    """Seen in a campaign: a wrong height above a vehicle that had descended reduced its picture to nothing."""
    ready = prepare_view(level_views()[0], CELL, ground)
    assert min(ready.grey.shape) >= 4
    assert np.isfinite(ready.norm).all()


@pytest.mark.parametrize(("width", "height", "times"), [(641, 481, 2), (643, 483, 2), (500, 375, 4)])
def test_a_picture_with_odd_sides_is_made_coarser_without_a_shift(width: int, height: int, times: int) -> None:
    """Resized to half the pixels of an odd side, its far end would lie up to half a pixel beside the camera's."""
    camera = Camera(width, height, 400.0, 400.0, (width - 1) / 2, (height - 1) / 2)
    far = np.array([width - 24.0, height - 24.0])
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    dot = (250.0 * np.exp(-0.5 * ((u - far[0]) ** 2 + (v - far[1]) ** 2) / 25.0)).round().astype(np.uint8)
    view = View(0, 0, dot, camera, Pose(DOWN, np.array([0.0, 0.0, UP])))
    ready = prepare_view(view, times * UP / 400.0, 0.0)
    assert ready.grey.shape == (ready.camera.height, ready.camera.width) == (height // times, width // times)
    at = (far - [camera.cu, camera.cv]) / 400.0 * ready.camera.fu + [ready.camera.cu, ready.camera.cv]
    rows, cols = np.indices(ready.grey.shape)
    found = np.array([(ready.grey * i).sum() for i in (cols, rows)]) / ready.grey.sum()
    assert_allclose(found, at, atol=0.05)
    picture = np.repeat(np.minimum(u, 255)[..., None], 3, axis=2).astype(np.uint8)
    mapx, mapy = np.float32([[20.0, 50.0]]), np.float32([[10.0, 10.0]])
    ramp = colour_at(replace(view, image=picture), ready, mapx, mapy)[0, :, 0]
    assert_allclose(ramp, times * mapx[0] + 0.5 * (times - 1), atol=0.51)


def test_views_are_chosen_for_their_baseline() -> None:
    """Of thirty views three are chosen: both ends, and one about the middle."""
    first = level_views()[0]
    views = [replace(first, world_from_cam=Pose(DOWN, np.array([0.2 * k - 3.0, 0.0, UP]))) for k in range(30)]
    chosen = choose_views(views, GRID, 0.0, 3, 0.4)
    x = np.array([views[k].centre[0] for k in chosen])
    assert np.ptp(x) > 3.0
    assert np.diff(x).min() > 1.0


# -- refused heights


@pytest.mark.parametrize("slope", [0.05, 0.2])
def test_ground_beside_a_hole_is_as_sure_on_a_slope_as_elsewhere(slope: float) -> None:
    """Where nothing is known, the nearest height stands in; the middle of the map would be a step there."""
    n, tuning = 200, ParallaxSettings().uncertainty
    height = np.tile((slope * 0.05 * np.arange(n)).astype(np.float32), (n, 1))
    height[80:120, 150:190] = np.nan
    one = {k: np.full((n, n), v, np.float32) for k, v in (("precision", 50.0), ("noise", 0.02), ("px", 0.1))}
    mean, seen = np.random.default_rng(0).normal(0, 1, (n, n)).astype(np.float32), np.full((n, n), 7, np.uint8)
    fit = Fit(Grid(0.0, 0.0, 0.05, n, n), height, one["precision"], one["noise"], mean, seen, seen, one["px"])
    found = pooled(fit, tuning)
    beside = np.zeros((n // 2, n // 2), bool)
    beside[34:66, 69:101] = True
    beside &= np.isfinite(height[::2, ::2])
    away = float(np.median(found.sigma2_px[5:25, 5:25]))
    assert np.sqrt(found.sigma2_px[beside].max() / away) < 3.0
    steps = np.maximum(found.high - found.lowest, found.highest - found.low)[beside]
    assert steps.max() <= slope * 0.05 * (2 * (tuning.near // 2) * 2 + 2)


@pytest.mark.parametrize("places", first(1, [10, 40]))
def test_no_view_that_sees_a_place_is_lost_at_a_glance_and_most_others_are(places: int) -> None:
    """Views look in all directions over a kilometre; the choice from the preselected ones is that from all."""
    rng = np.random.default_rng(4)
    like = level_views()[0]
    views = []
    for k in range(300):
        centre = rng.uniform([-500, -500, 20], [500, 500, 60])
        turned = so3_exp(rng.normal(0, 0.4, 3)) @ like.world_from_cam.rotation
        views.append(replace(like, t_ns=k, world_from_cam=Pose(turned, centre)))
    for _ in range(places):
        grid = Grid(*rng.uniform(-400, 400, 2), 0.5, 40, 40)
        low, high = np.sort(rng.uniform(-5, 15, 2))
        near = may_see(views, grid, low, high)
        e, n = np.meshgrid(*grid.xy())
        for z in (low, 0.5 * (low + high), high):
            at = np.column_stack([e.ravel(), n.ravel(), np.full(e.size, z)])
            for i in sorted(set(range(len(views))) - set(near)):
                uv = like.camera.project(views[i].world_from_cam.inverse.apply(at))
                with np.errstate(invalid="ignore"):
                    inside = ((uv >= 0) & (uv <= [like.camera.width - 1, like.camera.height - 1])).all(axis=1)
                assert not inside.any()
            chosen = choose_views(views, grid, z, 8, 1.0)
            assert [near[j] for j in choose_views([views[j] for j in near], grid, z, 8, 1.0)] == chosen
        assert len(near) < 60


def test_ground_without_texture_is_not_trusted() -> None:
    texture = Texture(1)
    found = heights(scene(paint=lambda e, n, k: np.where(e > 0, 128.0, texture(e, n))).views(COUNT))
    inside, outside = EAST > 1.0, EAST < -1.0
    bad = (found.flags & np.uint16(Flag.TEXTURE | Flag.UNSURE)) != 0
    assert bad[inside].mean() > 0.99
    assert not trusted(found)[inside].any()
    assert trusted(found)[outside].mean() > 0.95


def test_ground_that_changes_in_every_view_is_not_trusted() -> None:
    """Water without a bed has another texture in each view: its heights are wrong, and not given out."""
    still, waves = Texture(1), [Texture(100 + k) for k in range(COUNT)]
    found = heights(scene(paint=lambda e, n, k: np.where(e > 0, waves[k](e, n), still(e, n))).views(COUNT))
    inside, outside = EAST > 1.4, EAST < -1.4
    assert np.nanmedian(np.abs(found.height[inside])) > 0.5 * PX  # the test is hard: the heights found are wrong
    assert trusted(found)[inside].mean() < 0.02
    assert trusted(found)[outside].mean() > 0.95
    assert np.median(found.residual[inside]) > 5 * np.median(found.residual[outside])


def test_a_burnt_out_picture_is_not_trusted() -> None:
    found = heights(scene().views(COUNT, offsets=(400.0,)))
    assert not trusted(found).any()
    assert ((found.flags & np.uint16(Flag.SATURATED)) != 0).all()


def test_heights_at_the_end_of_the_range_are_marked() -> None:
    """The ground lies at 0.8 m, above the range; a trusted height is within 1.96 sigma of it."""
    found = heights(scene(surface=plane(level=0.8), top=1.0).views(COUNT), low=-1.5, high=0.5)
    ok = trusted(found)
    assert ok.mean() < 0.001
    assert (np.abs(found.height[ok] - 0.8) < 1.96 * found.sigma[ok]).all()


# -- sigma


@pytest.mark.parametrize(("make", "largest"), [(level_views, 10), (noisy_views, 3)], ids=["quiet", "noisy"])
def test_sigma_covers_the_error_and_is_not_merely_large(make: Callable[[], tuple[View, ...]], largest: float) -> None:
    """Sigma covers the claimed share of errors, and is at least 0.03 cells, because a window is no point."""
    found = heights(make())
    ok = trusted(found)
    assert ok.mean() > 0.9
    error, sigma = found.height[ok], found.sigma[ok]
    assert (np.abs(error) < sigma).mean() > 0.68
    assert (np.abs(error) < 1.96 * sigma).mean() > 0.95
    assert sigma.min() >= 0.0299 * CELL
    assert np.median(sigma) < largest * nmad(error)


def test_sigma_grows_with_noise_and_shrinks_with_baseline() -> None:
    quiet = np.median(heights(level_views()).sigma)
    noisy = np.median(heights(noisy_views()).sigma)
    short = np.median(heights(level_views()[1:5]).sigma)  # three fifths of the baseline
    assert noisy > 1.2 * quiet
    assert short > 1.1 * quiet


# -- one step at a time


def test_the_recursive_estimator_finds_a_plane_and_a_second_step_does_not_lose_it() -> None:
    """Flat ground is found from nothing at the first baseline; every later keyframe starts from the map."""
    s = scene(surface=plane(0.05, 0.03, 0.4), top=1.2)
    truth = s.surface(EAST, NORTH)
    estimator = RecursiveParallax(ParallaxSettings(), CELL, 0.0)
    views, known = s.views(COUNT), nothing_known(GRID)
    estimator.push([views[0]])
    assert not estimator.step(GRID, known, LOW, HIGH)  # one view sees no parallax
    spread = []
    for v in views[1:]:
        estimator.push([v])
        parts = estimator.step(GRID, known, LOW, HIGH)
        if parts:  # no part while the baseline is too short
            known = with_parts(known, parts)
            spread.append(nmad(known.height - truth))
    assert len(spread) >= 4
    height = known.height
    assert trusted(known).mean() > 0.95
    assert spread[-1] < 0.7 * spread[0]
    assert spread[-1] < 0.08 * PX
    assert np.percentile(np.abs(height - truth), 95) < 0.25 * PX


def test_the_recursive_estimator_never_fills_what_it_does_not_see() -> None:
    wide = Grid(-29.9, 4.5, CELL, 46, 300)
    estimator = RecursiveParallax(ParallaxSettings(), CELL, 0.0)
    for v in level_views():
        estimator.push([v])
    known = nothing_known(wide)
    parts = estimator.step(wide, known, LOW, HIGH)
    found = with_parts(known, parts)
    assert parts
    assert np.isnan(found.height[:, :60]).all()
    assert ((found.flags[:, :60] & np.uint16(Flag.UNSEEN)) != 0).all()


def test_a_seam_starts_from_the_heights_beside_it_and_a_wide_hole_does_not() -> None:
    """Without a baseline for a sweep, only narrow gaps that the first sweep left can be filled."""
    s = scene(surface=plane(0.05, 0.03, 0.4), top=1.2)
    truth = s.surface(EAST, NORTH).astype(np.float32)
    seam, hole = np.zeros(GRID.shape, np.bool_), np.zeros(GRID.shape, np.bool_)
    seam[:, 20:23], hole[10:30, 35:60] = True, True
    known, seen = nothing_known(GRID), ~(seam | hole)
    values = {"height": truth, "sigma": 0.02, "flags": 0, "views": 5, "residual": 0.1, "sampling": CELL}
    fields = {k: np.where(seen, v, getattr(known, k)).astype(getattr(known, k).dtype) for k, v in values.items()}
    rgb = np.where(seen[..., None], np.uint8(90), np.uint8(0))
    never = ParallaxSettings().recursive.model_copy(update={"first_baseline": 9.0})
    estimator = RecursiveParallax(ParallaxSettings().model_copy(update={"recursive": never}), CELL, 0.0)
    for v in s.views(COUNT)[:3]:
        estimator.push([v])
    before = replace(known, rgb=rgb, **fields)
    found = with_parts(before, estimator.step(GRID, before, LOW, HIGH))
    inner = seam & (np.arange(GRID.rows)[:, None] > 5) & (np.arange(GRID.rows)[:, None] < GRID.rows - 6)
    assert np.isfinite(found.height[inner]).all()
    assert np.abs(found.height - truth)[inner].max() < 0.25 * PX
    assert np.isnan(found.height[18:22, 44:50]).all()


# -- position of the ground


def test_points_of_the_ground_and_the_range_to_search() -> None:
    flat = find_points(level_views(), PointsTuning())
    assert len(flat) > 300
    assert np.percentile(np.abs(flat[:, 2]), 90) < 0.25
    low, high = height_range(flat, UP)
    assert -2.5 < low < -0.3
    assert 0.3 < high < 3.0
    stands = find_points(box_views(), PointsTuning())
    assert height_range(stands, UP)[1] > BOX + 0.5
    assert np.percentile(stands[:, 2], 98) == pytest.approx(BOX, abs=0.4)


def test_plain_ground_has_faint_points() -> None:
    """The contrast is a twentieth, two grey levels, as of gravel or sand from high up."""
    faint = [replace(v, image=np.round(100 + 0.05 * (v.image.astype(float) - 100)).astype(np.uint8))
             for v in level_views()]  # fmt: skip
    found = find_points(faint, PointsTuning())
    assert len(found) > 300
    assert np.percentile(np.abs(found[:, 2]), 90) < 0.5


def test_the_range_of_a_place_is_that_of_its_own_points() -> None:
    rng = np.random.default_rng(0)
    here = np.c_[rng.uniform(-5, 5, (200, 2)), rng.normal(0, 0.05, 200)]
    hill = here + np.array([100.0, 0.0, 15.0])
    points = np.concatenate([here, hill])
    assert height_range(points, 40.0)[1] > 15.0
    assert height_range(points, 40.0, (0.0, 0.0, 10.0))[1] < 5.0
    assert height_range(points, 40.0, (500.0, 0.0, 10.0)) == height_range(points, 40.0)  # no point is near: all count


@pytest.mark.parametrize(("share", "found"), [(0.3, 0), (0.7, 70)])
def test_a_pair_whose_rays_mostly_meet_at_too_small_an_angle_gives_no_points(share: float, found: int) -> None:
    """The few other rays are wrong matches, all of them too high: once a whole flight was searched at their height."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-8, 8, (100, 2)), np.full(100, -100.0)])
    ground[: round(100 * share), 2] = -40.0  # a base of 1 m: angles of 0.01 and 0.025 rad

    def seen(centre: np.ndarray) -> ViewFeatures:
        rays = ground - centre
        unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return ViewFeatures(centre, unit, 100 * np.eye(100, 128, dtype=np.float32))

    points, _ = pair_points(seen(np.zeros(3)), seen(np.array([1.0, 0.0, 0.0])), PointsTuning())
    assert len(points) == found


def test_nothing_moves_nothing_is_found() -> None:
    still = [replace(v, world_from_cam=level_views()[0].world_from_cam, image=level_views()[0].image)
             for v in level_views()]  # fmt: skip
    assert len(find_points(still, PointsTuning())) == 0
    blank = [replace(v, image=np.full_like(v.image, 100)) for v in level_views()]
    assert len(find_points(blank, PointsTuning())) == 0


def test_triangulation_meets_points_and_sees_what_cannot_meet() -> None:
    rng = np.random.default_rng(1)
    X = rng.uniform([-5, -5, -1], [5, 5, 1], (20, 3))
    a, b = np.array([-1.0, 0, 20.0]), np.array([1.0, 0.5, 19.0])
    ra, rb = ((X - c) / np.linalg.norm(X - c, axis=1)[:, None] for c in (a, b))
    points, angle, miss = triangulate_pair(a, ra, b, rb)
    assert_allclose(points, X, atol=1e-9)
    assert_allclose(angle, np.arccos((ra * rb).sum(1)), rtol=5e-3)  # approximated by its sine: small angles
    assert (miss < 1e-9).all()
    assert np.isinf(triangulate_pair(a, -ra, b, -rb)[2]).all()
    skewed = rb + np.array([0.0, 0.05, 0.0])
    aside = triangulate_pair(a, ra, b, skewed / np.linalg.norm(skewed, axis=1)[:, None])[2]
    assert np.median(aside) > 0.02


def test_the_size_of_a_pixel_on_the_ground() -> None:
    v = level_views()[0]
    straight = replace(v, world_from_cam=Pose(DOWN, np.array([0.0, 0.0, UP])))
    assert ground_sampling(straight, 0.0) == pytest.approx(UP / 150.0)
    assert ground_sampling(straight, 5.0) == pytest.approx((UP - 5.0) / 150.0)
    tilted = replace(v, world_from_cam=Pose(so3_exp([np.pi / 3, 0, 0]) @ DOWN, np.array([0.0, 0.0, UP])))
    assert ground_sampling(tilted, 0.0) == pytest.approx(2 * UP / 150.0)


def test_parallax_per_metre_is_the_widest_baseline_over_the_height() -> None:
    centres = np.array([[x, y, UP] for x, y in [(0, 0), (3, 4), (1, 1)]], float)
    assert parallax_per_metre(centres, 0.0) == pytest.approx(5.0 / UP)
    assert parallax_per_metre(centres, 10.0) == pytest.approx(5.0 / (UP - 10.0))


def test_a_height_above_a_camera_hides_all_below_it_and_asks_for_no_more_memory_than_the_map() -> None:
    """A spike above the cameras has rays of any length; their reach is limited to the map."""
    grid = Grid(0.0, 0.0, 0.1, 64, 80)
    height = np.zeros(grid.shape, np.float32)
    height[30:38, 40:48] = 500.0
    centres = np.array([[2.0, -3.0, 6.0], [5.0, -3.0, 6.0]])
    seen = Skyline.of(height, grid, centres)
    assert (seen.tops == 500.0).all()  # the dilation reached the whole map
