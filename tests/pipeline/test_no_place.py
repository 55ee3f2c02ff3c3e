"""Grounds without a place to land: no site, and the reasons; every refused cell has a reason."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from length import first

from alight.geometry import Camera
from alight.pipeline import Decision, Pipeline, PipelineOptions
from alight.records import Hazard, Rig, RigCamera
from alight.settings import load_settings
from alight_sim import default_rig, fly
from alight_sim.scene import Scene

LENS = Camera(240, 180, 180.0, 180.0, 119.5, 89.5)
RELIEF = [{"height": 0.8, "longest": 60, "shortest": 8, "fall": 1.8}]
GROUNDS: dict[str, dict[str, object]] = {
    "lake": {"relief": RELIEF, "layers": [{"thing": "water", "level": 2.5}]},
    "hay": {"relief": RELIEF, "layers": [{"thing": "tall_grass", "share": 1.0, "height": 1.0, "tuft": 0.45}]},
    "glare": {"cover": "bare", "look": "snow", "relief": RELIEF},
}
SAID = {"lake": "covered|surely|unknown", "hay": "covered|rough|surely", "glare": "unknown|seen well enough|texture"}


@cache
def flown(ground: str) -> Decision:
    """Fly 18 m above one kind of ground, 25 exposures, true poses."""
    scene = Scene.model_validate({"name": ground, "ground": {"size": [90, 90], **GROUNDS[ground]}})
    rig = Rig((RigCamera("cam0", LENS, default_rig().cameras[0].body_from_cam),))
    f = fly(scene, 3, 5.0, rig=rig, rate_hz=5.0, height=18.0, speed=2.0)
    p = Pipeline(rig, "flight", load_settings("", ["tuning.elevation.tile=128"]), PipelineOptions(f.truth_trajectory))
    for event in f.events():
        p.feed(event)
    return p.finish()


@pytest.mark.parametrize("ground", first(2, GROUNDS))
def test_there_is_no_site_and_it_is_said_why(ground: str) -> None:
    d = flown(ground)
    assert d.sites.sites == ()
    assert any(word in d.sites.reason for word in SAID[ground].split("|")), d.sites.reason


@pytest.mark.parametrize("ground", first(2, GROUNDS))
def test_every_cell_that_is_not_safe_says_why_and_every_other_says_nothing(ground: str) -> None:
    danger = flown(ground).hazards
    if danger is None:  # no height at all: the whole map is the reason
        assert ground == "glare"
        return
    safe = danger.p_safe >= load_settings("", []).hazards.p_safe
    assert ((danger.reasons == 0) == safe).all()
    assert ((danger.reasons[np.isnan(danger.p_safe)] & (Hazard.UNKNOWN | Hazard.EDGE)) != 0).all()


def test_tall_grass_is_refused_as_what_it_is() -> None:
    danger = flown("hay").hazards
    assert danger is not None
    assert ((danger.reasons & Hazard.TERRAIN) != 0).mean() > 0.8


def test_a_lake_from_rim_to_rim_is_refused_and_half_of_it_as_water() -> None:
    """The frame shows water only: the classes recognise half of it, and missing heights refuse the rest."""
    danger = flown("lake").hazards
    assert danger is not None
    assert ((danger.reasons & (Hazard.TERRAIN | Hazard.UNKNOWN | Hazard.EDGE)) != 0).mean() > 0.95
    assert ((danger.reasons & Hazard.TERRAIN) != 0).mean() > 0.4
    assert np.nanmax(danger.p_safe) < 0.3
