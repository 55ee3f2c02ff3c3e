"""Pictures matched as a whole: where the features are to be looked for when the prediction is poor (M1b, M1c)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.records import F32, U8
from alight.settings import TracksSettings

Mask = NDArray[np.bool_]

_LEAST = 12  # features that a common turn of the image is told from
_SMALL = 160  # px, about the shorter side of a picture shrunk to be looked at as a whole
_EVERY = 4  # px between those that tell how bright a picture is
TURNS = tuple(np.radians(np.arange(0.0, 360.0, 15.0)).tolist())  # rad about the optical axis, tried when all else fails


def warp_whole(image: U8, pixels: F32, guess: F32) -> tuple[U8, F32]:
    """Turn, scale and shear an earlier image as a whole to how the motion lets expect the present one (M1b).

    The SSD window only shifts: at 0.03 rad a frame its matches drift by 0.17 px in five frames, so by 0.014 px; on the
    sample flight the relative error over a second falls from 0.091 to 0.037 px and the tilt from 1.9 to 0.5 mrad.
    Returns the image and the features' (N, 2) places in it; unchanged where there are too few to tell.
    """
    if len(pixels) < _LEAST:
        return image, pixels
    ones = np.column_stack([pixels, np.ones(len(pixels))]).astype(np.float64)
    affine = np.linalg.lstsq(ones, guess.astype(np.float64), rcond=None)[0].T
    size = (image.shape[1], image.shape[0])  # linear as the matching itself samples: cubic doubles the drift
    warped = cv2.warpAffine(image, affine, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped), (ones @ affine.T).astype(np.float32)


def lit_as(image: U8, other: U8, settings: TracksSettings) -> U8:
    """Take one picture to the brightness and contrast of another of the same ground (M1d).

    The SSD has no notion of exposure: a step of 20 % between two pictures cost 0.4 px, of 50 % nine of ten features.
    Small differences come from what the pictures do not share (taken out: ring of the sample 0.18 px instead of 0.14).
    """
    a, b = image[::_EVERY, ::_EVERY].astype(np.float32), other[::_EVERY, ::_EVERY].astype(np.float32)
    most = settings.most_gain
    gain = float(np.clip(b.std() / max(float(a.std()), 1e-3), 1.0 / most, most))
    shift = float(b.mean()) - gain * float(a.mean())
    if abs(gain - 1.0) < settings.same_gain and abs(float(b.mean() - a.mean())) < settings.same_grey:
        return image
    levels = np.clip(np.round(gain * np.arange(256.0) + shift), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, levels))


def common_shift(then: U8, now: U8, pixels: F32, guess: F32, reach_px: int, least_overlap: float) -> F32:
    """Return the (2,) px that all guesses are off by alike: a degree of tilt is 34 px, more than a search may bound."""
    a, b = shrunken(then), shrunken(now)
    k = factor_of(now)
    warped, there = _warped(a, b, pixels, guess, k)
    r = reach_px // k
    if there.mean() < least_overlap or min(a.shape) <= 4 * r:
        return np.zeros(2, np.float32)
    high = [_high(warped), _high(b)]
    inner = high[0][r:-r, r:-r] * there[r:-r, r:-r]
    score = cv2.matchTemplate(high[1], inner, cv2.TM_CCORR_NORMED, mask=there[r:-r, r:-r].astype(np.float32))
    y, x = np.unravel_index(int(np.argmax(score)), score.shape)
    return np.array([(x - r) * k, (y - r) * k], np.float32)


def found_again(then: U8, now: U8, pixels: F32, turns: tuple[float, ...]) -> F32:
    """Where (N, 2) pixels of one picture are in another of which nothing is known: turned about the axis and shifted.

    Phase correlation of shrunken pictures; the turn whose peak is the highest.
    """
    middle = (np.array([then.shape[1], then.shape[0]], np.float64) - 1.0) / 2.0
    k, a, b = factor_of(now), shrunken(then), shrunken(now)
    window = cv2.createHanningWindow((b.shape[1], b.shape[0]), cv2.CV_32F)
    best, found = -1.0, pixels
    for turn in turns:
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        guess = ((pixels - middle) @ R.T + middle).astype(np.float32)
        warped, _ = _warped(a, b, pixels, guess, k)
        shift, peak = cv2.phaseCorrelate(_high(warped), _high(b), window)
        if peak > best:
            best, found = peak, guess + np.array(shift, np.float32) * k
    return found.astype(np.float32)


def _high(image: U8) -> F32:
    """A picture less its slow changes."""
    x = image.astype(np.float32)
    return np.asarray(x - cv2.GaussianBlur(x, (0, 0), 4.0), dtype=np.float32)


def factor_of(image: U8) -> int:
    return max(1, round(int(min(image.shape)) / _SMALL))


def shrunken(image: U8) -> U8:
    k = 1.0 / factor_of(image)
    return np.asarray(cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA))


def _warped(then: U8, now: U8, pixels: F32, guess: F32, factor: int) -> tuple[U8, Mask]:
    """A shrunken picture under the affine map from `pixels` to `guess` (full size), and where it has something."""
    a, b = ((x.astype(np.float64) + 0.5) / factor - 0.5 for x in (pixels, guess))
    affine = np.linalg.lstsq(np.column_stack([a, np.ones(len(a))]), b, rcond=None)[0].T
    size = (now.shape[1], now.shape[0])
    there = cv2.warpAffine(np.ones_like(then), affine, size, flags=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.warpAffine(then, affine, size)), np.asarray(there)


def agreement(then: U8, now: U8, pixels: F32, guess: F32, factor: int, least_overlap: float) -> float:
    """Correlation of two shrunken pictures where the affine map from `pixels` to `guess` (full size) overlaps them."""
    warped, there = _warped(then, now, pixels, guess, factor)
    if there.mean() < least_overlap:
        return -1.0
    x, y = warped[there].astype(np.float64), now[there].astype(np.float64)
    return float(np.corrcoef(x, y)[0, 1]) if x.std() > 0 and y.std() > 0 else -1.0
