"""Least squares matching of patches, on drawn pictures of a plane with known values at all pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("pycolmap")

from alight.arrays import F64
from alight.geometry import Camera, so3_exp
from alight.photos.bundle import patch_matching
from alight.photos.bundle import patch_matching_kernels as kernels
from alight.photos.bundle.lenses import PhotoLenses
from alight.photos.bundle.matching import BundleObservations
from alight.photos.bundle.solver import BundleState, Priors, project_points
from alight.records import Frame

SIDE = 2 * kernels.HALF + 3
CAMERA = Camera(320, 240, 400.0, 400.0, 159.5, 119.5)
FINER = Camera(640, 480, 800.0, 800.0, 319.5, 239.5)


def texture(seed: int) -> Callable[[F64, F64], F64]:
    """Return the grey levels of a plane as a function of two coordinates: waves of 5 to 30 units."""
    rng = np.random.default_rng(seed)
    length, way, phase = rng.uniform(5, 30, 60), rng.uniform(0, 2 * np.pi, 60), rng.uniform(0, 2 * np.pi, 60)
    k = 2 * np.pi / length * np.array([np.cos(way), np.sin(way)])

    def grey(x: F64, y: F64) -> F64:
        return 120 + 8 * np.cos(np.multiply.outer(x, k[0]) + np.multiply.outer(y, k[1]) + phase).sum(axis=-1)

    return grey


def picture(grey: Callable[[F64, F64], F64], warp: F64, shift: F64) -> np.ndarray:
    """Picture (H, W) of a plane: pixel p shows the place warp p + shift."""
    c, r = np.meshgrid(np.arange(90.0), np.arange(80.0))
    place = np.stack([c, r], axis=-1) @ warp.T + shift
    return grey(place[..., 0], place[..., 1]).astype(np.float32)


def matched(one: np.ndarray, other: np.ndarray, at: F64, expected: F64, warp: F64) -> tuple[F64, F64]:
    patches = np.empty((len(at), SIDE, SIDE), np.float32)
    kernels.sample_patches(one, at, patches)
    moved, likeness = np.empty((len(at), 2)), np.empty(len(at))
    kernels.match_patches(patches, other, expected, np.repeat(warp[None], len(at), axis=0), moved, likeness)
    return moved, likeness


@pytest.mark.parametrize("gain", [1.0, 0.6])
@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_patches_are_found_to_a_hundredth_of_a_pixel(gain: float, turn: float) -> None:
    """Patches are turned, stretched and darker, and the search starts 0.3 to 1 px off."""
    grey = texture(3)
    warp = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ np.diag([1.1, 0.95])
    inverse = np.linalg.inv(warp)  # other pixel = warp (pixel - 40) + 40
    one, middle = picture(grey, np.eye(2), np.zeros(2)), np.array([40.0, 40.0])
    other = gain * picture(grey, inverse, middle - inverse @ middle) + 10.0
    rng = np.random.default_rng(1)
    at = middle + rng.uniform(-14, 14, (60, 2))
    there = (at - middle) @ warp.T + middle
    way = rng.uniform(0, 2 * np.pi, 60)
    off = rng.uniform(0.3, 1.0, 60)[:, None] * np.column_stack([np.cos(way), np.sin(way)])
    moved, likeness = matched(one, other.astype(np.float32), at, there + off, warp)
    found = np.isfinite(moved).all(axis=1)
    assert found.mean() > 0.95
    assert np.median(np.abs(moved + off)[found]) < 0.01
    assert np.percentile(np.abs(moved + off)[found], 95) < 0.03
    assert likeness[found].min() > 0.99


def test_what_is_not_there_is_not_found() -> None:
    """On even ground, other ground, or at the edge of either picture, the result is NaN or a low correlation."""
    one, even = picture(texture(3), np.eye(2), np.zeros(2)), np.full((80, 90), 100.0, np.float32)
    at = np.array([[40.0, 40.0], [30.0, 52.0], [55.2, 33.3]])
    for first, second in ((even, one), (one, even)):
        moved, likeness = matched(first, second, at, at, np.eye(2))
        assert np.isnan(moved).all()
        assert_allclose(likeness, 0.0)
    moved, likeness = matched(one, picture(texture(4), np.eye(2), np.zeros(2)), at, at, np.eye(2))
    assert not ((likeness > 0.8) & np.isfinite(moved).all(axis=1)).any()
    edge = np.array([[4.0, 40.0], [40.0, 78.0]])
    assert np.isnan(matched(one, one, edge, edge + 20.0, np.eye(2))[0]).all()
    assert np.isnan(matched(one, one, edge + 30.0 * np.array([1.0, -1.0]), edge, np.eye(2))[0]).all()


def survey(
    seed: int, cameras: tuple[Camera, ...] = (CAMERA,)
) -> tuple[BundleState, BundleObservations, Priors, list[Frame]]:
    """Four tilted photos of level ground from 20 m, by the cameras in turn, with exact observations."""
    grey, rng = texture(seed), np.random.default_rng(seed)
    centres = np.array([[0.0, 0.0, 20.0], [3.0, 0.5, 20.5], [0.5, 3.0, 19.5], [3.0, 3.5, 20.0]])
    down = np.diag([1.0, -1.0, -1.0])
    rotations = np.array([so3_exp(rng.normal(0, 0.06, 3)) @ down for _ in centres])
    frames = []
    for k, (C, R) in enumerate(zip(centres, rotations, strict=True)):
        camera, images = cameras[k % len(cameras)], [None] * len(cameras)
        c, r = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        world = camera.rays(np.stack([c, r], axis=-1).reshape(-1, 2).astype(float)) @ R.T
        ground = C + world * (-C[2] / world[:, 2])[:, None]
        shade = grey(20 * ground[:, 0], 20 * ground[:, 1]).reshape(c.shape).clip(0, 255)
        images[k % len(cameras)] = np.rint(shade).astype(np.uint8)
        frames.append(Frame(k, tuple(images)))
    points = np.column_stack([rng.uniform(-1, 4, (80, 1)), rng.uniform(-1, 4, (80, 1)), np.zeros((80, 1))])
    photo, point = np.tile(np.arange(4), 80), np.repeat(np.arange(80), 4)
    lenses = PhotoLenses(cameras, np.arange(4) % len(cameras))
    lens = np.zeros(5 * len(cameras))
    state = BundleState(centres, rotations, points, lens, np.zeros(3), np.zeros((4, 2, 3)))
    obs = BundleObservations(photo, point, np.zeros((320, 2)), np.zeros(320, bool))
    priors = Priors(
        centres, np.ones((4, 3)), rotations @ down.T, np.ones((4, 3)), down, 0.0, lenses, np.zeros(len(lens)),
        np.zeros((4, 3)),
    )  # fmt: skip
    return state, replace(obs, pixels=project_points(state, obs, priors).pixels), priors, frames


@pytest.mark.parametrize(("cameras", "longest"), [((CAMERA,), 3200), ((CAMERA,), 240), ((CAMERA, FINER), 400)])
def test_observations_of_features_become_sharper(
    cameras: tuple[Camera, ...], longest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a quarter of a pixel of noise, the first observation of a point stays, and the others are matched with it.

    In the photos' own pixels, in pictures of three quarters of the size, and beside a finer camera whose pictures
    alone are reduced.
    """
    monkeypatch.setattr(patch_matching, "MOST_PX", longest)
    state, exact, priors, frames = survey(5, cameras)
    noise = np.random.default_rng(2).normal(0, 0.25, exact.pixels.shape)
    noisy = replace(exact, pixels=exact.pixels + noise)
    sharp = patch_matching.refine_observations(state, noisy, priors, frames)
    first = np.repeat(exact.starts, 4)
    assert_allclose(sharp.pixels[exact.starts], noisy.pixels[exact.starts])
    others = sharp.by_patch & (np.arange(320) != first)
    assert others.sum() > 0.75 * 240
    assert sharp.by_patch[exact.starts].mean() > 0.8
    focal = priors.lenses.focal(exact.photo)[:, :1]  # apart from it, the photos are nearly alike in scale and heading
    left = (sharp.pixels - exact.pixels - focal / focal[first] * noise[first])[others]
    assert np.median(np.abs(left)) < 0.03
    assert_allclose(sharp.pixels[~sharp.by_patch], noisy.pixels[~sharp.by_patch])


def test_a_photo_of_other_ground_keeps_its_features() -> None:
    state, obs, priors, frames = survey(5)
    strange = [*frames[:3], replace(frames[3], images=survey(6)[3][3].images)]
    sharp = patch_matching.refine_observations(state, obs, priors, strange)
    assert sharp.by_patch[obs.photo == 1].mean() > 0.8
    assert sharp.by_patch[obs.photo == 3].mean() < 0.1


def test_without_an_observation_nothing_is_done() -> None:
    state, obs, priors, frames = survey(5)
    none = obs.keep(np.zeros(320, bool))[0]
    assert not len(patch_matching.refine_observations(state, none, priors, frames).photo)
