"""Labelled patches, and their features as photographed and as other cameras might photograph them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, I64, U8
from alight.terrain.model import PIXEL, STRETCH, against, appearance_features, frame_of, names

Report = Callable[[float], None]


def quiet(share: float) -> None:
    """Ignore reported progress."""


@dataclass(frozen=True, eq=False)
class LabelledPatch:
    """Picture of one class of ground."""

    rgb: U8  # (H, W, 3)
    sampling: float  # metres per pixel
    kind: int  # Terrain code
    site: str  # location and flight; patches of one site are held out together
    name: str = ""


@dataclass(frozen=True, eq=False)
class Samples:
    """Features of one level, N rows."""

    values: F32  # (N, F)
    patch: I64  # (N,) index of the patch
    variant: I64  # (N,) 0: original picture; else an augmented one

    def of(self, rows: NDArray[np.bool_]) -> Samples:
        """Return the samples of the rows that a mask (N,) selects."""
        return Samples(self.values[rows], self.patch[rows], self.variant[rows])


def another_camera(rgb: U8, rng: np.random.Generator) -> U8:
    """Simulate another camera: change light, white balance, tone, saturation, blur, noise and heading of a patch."""
    linear = (rgb.astype(np.float32) / 255) ** 2.2
    linear *= np.exp(rng.normal(0, 0.12, 3) + rng.normal(0, 0.4)).astype(np.float32)
    tone = np.clip(linear, 0, 1) ** np.float32(np.exp(rng.normal(0, 0.15)) / 2.2)
    grey = tone.mean(axis=2, keepdims=True)
    tone = np.clip(grey + (tone - grey) * np.float32(np.exp(rng.normal(0, 0.25))), 0, 1)
    if rng.random() < 0.6:
        tone = cv2.GaussianBlur(tone, (0, 0), rng.uniform(0.3, 1.6))
    noisy = tone + rng.normal(0, rng.uniform(0, 0.015), tone.shape)
    return np.ascontiguousarray(np.rot90(np.clip(255 * noisy, 0, 255).astype(np.uint8), int(rng.integers(4))))


def _read_off(patch: LabelledPatch, rgb: U8, level: int) -> F32:
    """Measure the features of a level at 3 x 3 positions of a patch, (P, F); empty if the patch is too coarse.

    `rgb`: the patch's picture, or an altered copy of it.
    """
    pixel = PIXEL * 2**level
    if patch.sampling > STRETCH * pixel:
        return np.empty((0, len(names(level))), np.float32)
    factor = min(1.0, patch.sampling / pixel)
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    seen = appearance_features(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), max(patch.sampling, pixel))
    assert seen is not None
    rows, cols = (np.unique((np.linspace(0.2, 0.8, 3) * n).astype(int)) for n in seen.values.shape[:2])
    return np.asarray(seen.values[np.ix_(rows, cols)].reshape(-1, seen.values.shape[2]))


def measure_patches(
    patches: list[LabelledPatch], level: int, report: Report = quiet, variants: int = 3, seed: int = 0
) -> Samples:
    """Measure the features of all patches, and of `variants` altered copies of each, at one level.

    Detail is relative to its median over the site. `report`: gets the progress, 0 to 1.
    """
    rng = np.random.default_rng(seed)
    parts, which, variant = [], [], []
    for i, patch in enumerate(patches):
        for v in range(variants):
            found = _read_off(patch, another_camera(patch.rgb, rng) if v else patch.rgb, level)
            parts.append(found)
            which += [i] * len(found)
            variant += [v] * len(found)
        report((i + 1) / len(patches))
    samples = Samples(np.concatenate(parts), np.array(which, np.int64), np.array(variant, np.int64))
    return _against_sites(samples, np.array([p.site for p in patches]), level)


def _against_sites(samples: Samples, sites: NDArray[np.str_], level: int) -> Samples:
    """Return the samples with detail relative to its median over each site; `sites`: site of each patch."""
    out = samples.values.copy()
    for site in np.unique(sites):
        for v in np.unique(samples.variant):
            rows = (sites[samples.patch] == site) & (samples.variant == v)
            out[rows] = against(out[rows], frame_of(out[rows], level))
    return Samples(out, samples.patch, samples.variant)
