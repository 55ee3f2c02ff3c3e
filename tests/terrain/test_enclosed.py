"""Water by its shape: level along its length, below both banks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.ground import ground

from alight.records import Datum, Flag
from alight.settings import Settings
from alight.terrain.enclosed import LevelSurfaces
from alight.terrain.water import dryness

CELL = 0.1
SETTINGS = Settings().stages().terrain


def canal(fall: float = 0.0, bank: float = 0.5, noise: float = 0.01) -> np.ndarray:
    """Heights of 40 x 30 m with a canal of 6 m through the whole map along its columns; gradient `fall`."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(300) * CELL, np.arange(400) * CELL)
    lawn = 0.02 * x + 0.1 * np.sin(y / 7)
    off = np.abs(x - 15.0)
    water = -bank + 0.02 * 15 - 0.1 + fall * y
    z = np.where(off < 3.0, water, np.where(off < 4.0, water + (lawn - water) * (off - 3.0), lawn))
    return (z + rng.normal(0, noise, z.shape)).astype(np.float32)


def middle(values: np.ndarray) -> float:
    """Share of the water, without its margins, that is found to be enclosed."""
    return float((values[20:-20, 130:170] > 0.5).mean())


def test_a_canal_that_leaves_the_map_at_both_ends_is_enclosed() -> None:
    found = LevelSurfaces.of(ground(canal(), cell=CELL), SETTINGS).enclosed()
    assert middle(found) > 0.95
    assert (found[:, :90] > 0.1).mean() < 0.02  # the lawns beside it are not
    assert (found[:, 210:] > 0.1).mean() < 0.02


@pytest.mark.parametrize("z", [canal(fall=0.03), canal(bank=0.0), np.zeros((400, 300), np.float32)])
def test_a_sloping_valley_a_level_lawn_and_open_ground_are_not(z: np.ndarray) -> None:
    assert middle(LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).enclosed()) == 0.0


def test_what_was_not_seen_of_the_rim_says_nothing() -> None:
    z = canal()
    z[150:250, 190:] = np.nan
    assert middle(LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).enclosed()) > 0.9
    z = canal()
    z[:, :122] = z[:, 178:] = np.nan  # no bank was seen at all
    assert middle(LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).enclosed()) == 0.0


def test_a_map_that_leans_as_much_as_it_says_hides_no_canal() -> None:
    y = np.arange(400, dtype=np.float32)[:, None] * CELL
    leaning = ground(canal() + 0.015 * y, cell=CELL)
    assert middle(LevelSurfaces.of(leaning, SETTINGS).enclosed()) < 0.5
    datum = Datum(0.0, 0.0, np.diag([0.1, 0.01, 0.01]) ** 2)
    assert middle(LevelSurfaces.of(replace(leaning, datum=datum), SETTINGS).enclosed()) > 0.95


def test_doubtful_heights_are_no_bank() -> None:
    e = ground(canal(), cell=CELL)
    flags = e.flags.copy()
    flags[:, :122] |= np.uint16(Flag.UNSURE)
    flags[:, 178:] |= np.uint16(Flag.UNSURE)
    assert middle(LevelSurfaces.of(replace(e, flags=flags), SETTINGS).enclosed()) == 0.0


def roof(height: float = 4.0) -> np.ndarray:
    """Heights of 40 x 30 m of gently sloping ground, with a flat roof of 16 x 12 m in the middle."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(300) * CELL, np.arange(400) * CELL)
    lawn = 0.02 * x + 0.01 * y
    on = (np.abs(x - 15.0) < 6.0) & (np.abs(y - 20.0) < 8.0)
    return (np.where(on, height + 0.5, lawn) + rng.normal(0, 0.01, x.shape)).astype(np.float32)


def on_roof(z: np.ndarray) -> float:
    return float((LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).raised()[130:270, 100:200] > 0.5).mean())


def test_a_flat_roof_is_raised_and_the_ground_about_it_is_not() -> None:
    found = LevelSurfaces.of(ground(roof(), cell=CELL), SETTINGS).raised()
    assert on_roof(roof()) == 1.0
    assert found[:100].max() == found[300:].max() == found[:, :70].max() == found[:, 230:].max() == 0.0


def test_a_low_slab_a_terrace_and_a_canal_are_not_raised() -> None:
    y = np.arange(400)[:, None] * CELL
    terrace = np.where((y > 12) & (y < 28), 4.0, np.where(y <= 12, 0.0, 8.0)) * np.ones((1, 300))
    assert on_roof(roof(0.8)) == 0.0
    assert on_roof(terrace.astype(np.float32)) == 0.0
    assert LevelSurfaces.of(ground(canal(), cell=CELL), SETTINGS).raised().max() == 0.0


def test_a_roof_whose_rim_is_not_seen_cannot_be_told() -> None:
    """The middle of a roof seen from near by, or a step at the rim of the map with one known side, is no roof."""
    near = roof()
    near[:125] = near[275:] = np.nan
    near[:, :95] = near[:, 205:] = np.nan
    assert on_roof(near) == 0.0
    step = np.where(np.arange(300) * CELL < 12.0, 4.0, 0.0) * np.ones((400, 1))
    assert LevelSurfaces.of(ground(step.astype(np.float32), cell=CELL), SETTINGS).raised().max() == 0.0


def pool(fall: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Heights of 40 x 30 m of lawn that rises by 2 %, and the mask of a pool of 36 m^2 in it; gradient `fall`."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(300) * CELL, np.arange(400) * CELL)
    water = (np.abs(x - 6.0) < 3.0) & (np.abs(y - 20.0) < 3.0)
    z = np.where(water, 0.06 + fall * y, 0.02 * x)
    return (z + rng.normal(0, 0.01, z.shape)).astype(np.float32), water


def test_a_level_patch_that_looks_like_water_is_a_pool() -> None:
    z, alike = pool()
    found = LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).pools(alike)
    assert (found & alike).sum() > 0.8 * alike.sum()
    assert not (found & ~alike)[:, :20].any()
    assert not LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).pools(np.zeros_like(alike)).any()


def test_a_patch_that_slopes_or_is_smaller_than_a_pool_is_none() -> None:
    z, alike = pool(fall=0.03)
    assert not LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).pools(alike).any()
    z, alike = pool()
    alike[210:] = False  # 15 x 1 m at most are left
    alike[:195] = False
    assert not LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).pools(alike).any()


def test_dryness_is_measured_from_the_nearest_water() -> None:
    z, water = pool()
    water[:, 280:] = True  # a second pool, higher up
    dry = dryness(water, np.where(water & (z < 0.05), np.nan, z).astype(np.float32))
    assert dry[200, 60] == pytest.approx(0.0, abs=0.05)
    assert dry[200, 120] == pytest.approx(0.24 - 0.06, abs=0.05)
    assert dry[200, 270] == pytest.approx(0.0, abs=0.02)
    assert (dryness(np.zeros_like(water), z) == 1).all()
    assert dryness(water, z + 1.5 * ~water)[200, 120] == 1.0


def test_a_flat_roof_that_looks_like_water_is_no_pool() -> None:
    z, alike = pool()
    z[alike] += 3.0
    assert not LevelSurfaces.of(ground(z, cell=CELL), SETTINGS).pools(alike).any()
