"""Sweeps from coarse to fine: the heights that each ray tries, and the images that are kept for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ground_views import UP, Scene, box
from numpy.testing import assert_array_equal

from alight.geometry import Grid
from alight.parallax import batch
from alight.parallax import plane_sweep as sweeps
from alight.parallax.batch import Images, match_tile
from alight.parallax.plane_sweep import Spans, narrowed, upright
from alight.parallax.views import ground_sampling
from alight.pipeline.mapping.batch_map import MARGIN, BatchMap
from alight.pipeline.mapping.ground_map import cell_size
from alight.records import is_trusted
from alight.settings import ParallaxSettings, load_settings

CELL = 0.2
GRID = Grid(-9.9, 9.9, CELL, 100, 100)
LEVELS = np.linspace(-1.0, 3.0, 41).astype(np.float32)  # 0.1 m apart


def test_a_ray_tries_the_planes_about_what_was_found_beside_it() -> None:
    found = np.zeros((20, 20), np.float32)
    found[:, 12:] = 2.0
    spans = Spans.about(found, (40, 39), LEVELS, sweeps.NARROW)
    assert spans.low.shape == (40, 39)
    flat, step = (5, 5), (5, 23)  # the step lies between columns 23 and 24
    assert (LEVELS[spans.low[flat]], LEVELS[spans.high[flat]]) == pytest.approx((-0.2, 0.2), abs=0.11)
    assert (LEVELS[spans.low[step]], LEVELS[spans.high[step]]) == pytest.approx((-0.2, 2.2), abs=0.11)


def test_between_coarse_and_fine_a_ray_tries_what_was_found_some_cells_away() -> None:
    """A beam or a twig, too small for coarse cells, stands near something that they show."""
    found = np.zeros((20, 30), np.float32)
    found[:, 20:] = 2.0
    spans = Spans.about(found, (40, 60), LEVELS, sweeps.BROAD)
    near, far = (20, 26), (20, 22)  # 7 and 9 coarse cells from the step
    assert (LEVELS[spans.low[near]], LEVELS[spans.high[near]]) == pytest.approx((-0.8, 2.8), abs=0.11)
    assert (LEVELS[spans.low[far]], LEVELS[spans.high[far]]) == pytest.approx((-0.8, 0.8), abs=0.11)


def test_at_the_border_of_a_picture_a_ray_tries_the_nearest_heights() -> None:
    """Small pixels lie closer to the border than large ones; once the lowest plane was given out there."""
    found = np.full((20, 20), 1.5, np.float32)
    found[:, :4] = np.nan
    spans = Spans.about(found, (40, 40), LEVELS, sweeps.NARROW)
    assert (np.abs(LEVELS[spans.low] - 1.5) < 0.4).all()
    nothing = Spans.about(np.full((20, 20), np.nan, np.float32), (40, 40), LEVELS, sweeps.NARROW)
    assert (nothing.high - nothing.low).max() <= sweeps.NARROW.slack


def test_costs_lie_one_ray_after_the_other() -> None:
    low, high = np.array([[0, 3]], np.int32), np.array([[2, 3]], np.int32)
    spans = Spans(low, high)
    assert_array_equal(spans.first, [[0, 3]])


def test_the_search_narrows_to_what_was_found_and_never_widens() -> None:
    found = np.random.default_rng(0).uniform(0.0, 1.0, (50, 50)).astype(np.float32)
    found[0, 0] = 40.0  # one ray does not widen the range
    low, high = narrowed(found, (-5.0, 50.0), 0.5)
    assert (low, high) == pytest.approx((-0.7, 1.7), abs=0.05)
    assert narrowed(found, (-0.1, 0.9), 0.5) == (-0.1, 0.9)
    assert narrowed(np.full((3, 3), np.nan, np.float32), (-5.0, 50.0), 0.5) == (-5.0, 50.0)


def test_a_box_is_as_high_as_with_all_planes_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    views = Scene(spacing=1.6, surface=box(2.5), top=2.7).views(6)
    monkeypatch.setattr(batch, "LEAST_ACROSS", 16)  # these pictures are small
    cells, along = list[float](), sweeps.along_rays

    def watched(registered: sweeps.Registered, rays: Grid, *rest: Any) -> sweeps.Swept:
        cells.append(rays.cell)
        return along(registered, rays, *rest)

    monkeypatch.setattr(sweeps, "along_rays", watched)
    both = []
    for halvings, coarsest in ((0, CELL), (2, 4 * CELL)):
        cells.clear()
        tuning = ParallaxSettings.model_validate({"sweep": {"halvings": halvings}})
        found = match_tile(Images(views, CELL, 0.0), GRID, -1.5, 4.0, tuning)
        assert found is not None
        assert max(cells) == pytest.approx(coarsest)
        both.append(found.heights)
    whole, quick = both
    given = [np.isfinite(h.height) & is_trusted(h.flags) for h in both]
    assert given[1].sum() > 0.97 * given[0].sum()
    assert np.percentile(np.abs(whole.height - quick.height)[given[0] & given[1]], 99) < 0.1


def test_views_that_are_ready_are_bounded_by_bytes() -> None:
    views = Scene(spacing=0.2).views(24)
    images = Images(views, CELL, 0.0, most_bytes=1)
    first = images.get(0, 1)
    assert first.camera.width == images.get(0).camera.width // 2
    for k in range(24):
        images.get(k)
    assert images.get(0, 1) is not first  # made anew
    assert images.get(23) is images.get(23)


@pytest.mark.parametrize(("quality", "finest"), [("fast", 0.105), ("normal", 0.0525), ("fine", 0.0)])
def test_cells_are_no_finer_than_the_lander_needs(quality: str, finest: float) -> None:
    view = Scene(spacing=1.0).views(1)[0]
    settings = load_settings("", [f"parallax.quality={quality}"]).stages()
    pixels = 2 if quality == "fast" else 1
    for up in (0.2, 1.0, UP):
        ground = float(view.centre[2]) - up
        want = max(1.8 * pixels * ground_sampling(view, ground), finest)
        assert cell_size(view, ground, settings, by_quality=True) == pytest.approx(want)


def test_tiles_are_matched_in_blocks_where_the_pictures_are_large() -> None:
    """Every cell under the views lies in exactly one block, not counting the margins."""
    views = Scene(spacing=2.0).views(4)
    lane = BatchMap(load_settings("", ["tuning.elevation.tile=64", "parallax.cell=0.01"]).stages())
    assert lane.find_ground(views), lane.reason
    for level, block in ((0, 2), (6, 1)):  # cells of 0.01 and of 0.64 m
        grids = lane.tile_grids(views, (-1.0, 1.0), (-1.0, 1.0), level)
        size = block * 64
        assert {g.shape for g in grids} == {(size + 2 * MARGIN,) * 2}
        corners = {(round(g.east / g.cell), round(g.north / g.cell)) for g in grids}
        assert len(corners) == len(grids)
        assert all((a - b) % size == 0 for a, _ in corners for b, _ in corners)


def test_every_swept_height_has_a_cost_ratio() -> None:
    """A recursive map sweeps cells without one anew: those behind a wall would never be refined."""
    rays, about = Grid(0.0, 0.0, 0.1, 40, 60), np.array([-8.0, -2.0, 30.0])
    found = np.zeros(rays.shape, np.float32)
    found[10:30, 20:30] = 1.2
    height, ratio = upright(found, np.full(rays.shape, 0.5, np.float32), rays, 0.0, about, rays, 2)
    assert (ratio == 1.0).sum() > 40  # the ground that the wall hides
    assert_array_equal(np.isfinite(ratio), np.isfinite(height))
