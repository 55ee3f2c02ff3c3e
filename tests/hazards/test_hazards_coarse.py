"""Cells that are wide for the lander: what they cannot show is not called safe, and the reasons say so."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ground import ground
from numpy.testing import assert_allclose

from alight.hazards import assess
from alight.hazards.touchdown import smoothed_roughness
from alight.landing.sites import choose_sites
from alight.records import Hazard, HazardMap
from alight.runner.judge import for_surveyed_heights, judge_ground
from alight.settings import HazardsSettings, Lander, Settings, SitesSettings
from alight.sources.raster import GroundRaster

EXACT = HazardsSettings(tilt_sigma=0.0, smoothed=False)
MID = (30, 30)


def level(cell: float, lander: Lander, settings: HazardsSettings = EXACT) -> HazardMap:
    return assess(ground(np.zeros((61, 61)), cell=cell), None, lander, settings)


def test_surveyed_cells_that_show_every_obstacle_are_believed() -> None:
    lander = Lander()
    for cell in (0.05, lander.judging_cell):
        assert level(cell, lander).p_safe[MID] == 1.0
    assert level(0.25, Lander(skids=(2.0, 1.5), belly_clearance=0.4)).p_safe[MID] == 1.0


def test_surveyed_cells_that_are_too_wide_leave_the_usual_obstacles_unseen() -> None:
    for cell in (0.2, 0.5):
        h = level(cell, Lander())
        hidden = 1 - Lander().judging_cell / cell
        assert_allclose(h.p_obstacle[MID], math.exp(-hidden * EXACT.unseen_unknown * math.pi * 1.5**2), rtol=1e-5)
        assert h.p_safe[MID] == h.p_obstacle[MID]
        assert Hazard(int(h.reasons[MID])) == Hazard.DOUBT
    assert level(1.0, Lander(), EXACT.model_copy(update={"unseen_unknown": 0.0})).p_safe[MID] == 1.0


@pytest.mark.parametrize(("cell", "warned"), [(0.1, False), (0.5, True)])
def test_a_raster_of_wide_cells_is_warned_of_and_its_places_are_candidates(cell: float, warned: bool) -> None:
    raster = GroundRaster(ground(np.zeros((81, 81)), cell=cell, sigma=0.01), None, None, (), ())
    result = judge_ground(raster, for_surveyed_heights(Settings()), "dem.tif").record
    told = [w for w in result.warnings if w.startswith("cells of 0.5 m do not show every obstacle of 0.15 m")]
    assert bool(told) == warned
    assert bool(result.sites.sites) != warned
    assert bool(result.sites.candidates) == warned
    if warned:
        assert result.sites.candidates[0].doubt == "obstacle"


def test_heights_averaged_over_blocks_still_give_a_plane_for_a_small_footprint() -> None:
    z = ground(np.zeros((41, 41))).height
    z[20, 20] = 0.5
    for radius in (0.15, 0.3, 0.4):
        found = smoothed_roughness(z, radius, 0.1, 0.2)
        assert np.isfinite(found[5:-5, 5:-5]).all()
        assert found[20, 20] > 0.002


def test_a_footprint_that_leaves_the_map_is_no_unknown_ground() -> None:
    h = level(0.1, Lander(radius=1.0))
    assert h.reasons[0, 0] == Hazard.EDGE
    assert not (h.reasons & Hazard.UNKNOWN).any()
    assert np.isnan(h.p_safe[0, 0])


def test_cells_wider_than_the_lander_are_told_as_the_reason() -> None:
    e, lander = ground(np.zeros((41, 41)), cell=0.5), Lander(radius=0.3)
    reason = choose_sites(assess(e, None, lander, EXACT), None, e, SitesSettings(), lander).reason
    assert reason.endswith("cells of 0.5 m are wider than the radius of 0.3 m, so no plane fits")
