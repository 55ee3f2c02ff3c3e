"""Global image alignment: predicted pixels of all features where the predicted motion is poor (M1b, M1c)."""

from __future__ import annotations

import cv2
import numpy as np

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Pose
from alight.settings import TracksSettings

TURNS = tuple(np.radians(np.arange(0.0, 360.0, 15.0)).tolist())  # rad about the optical axis, tried last


def warp_affine(image: U8, pixels: F32, predicted: F32) -> tuple[U8, F32]:
    """Warp an earlier image to the predicted present view by one affine map, from `pixels` to `predicted` (M1b).

    Returns:
        The image and the (N, 2) pixels of the features in it; both unchanged if there are too few features.
    """
    # matching only shifts its window: at 0.03 rad per frame, matches drift by 0.17 px in five frames (warped: 0.014 px)
    if len(pixels) < 12:
        return image, pixels
    ones = np.column_stack([pixels, np.ones(len(pixels))]).astype(np.float64)
    affine = np.linalg.lstsq(ones, predicted.astype(np.float64), rcond=None)[0].T
    size = (image.shape[1], image.shape[0])  # linear, as in the matching: cubic interpolation doubles the drift
    warped = cv2.warpAffine(image, affine, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped), (ones @ affine.T).astype(np.float32)


def match_brightness(image: U8, other: U8, settings: TracksSettings) -> U8:
    """Return the image with the brightness and contrast of `other`, an image of the same ground (M1d)."""
    # the SSD does not model exposure: a step of 20 % between two images caused an error of 0.4 px, a step of 50 % the
    # loss of nine of ten features. Small differences come from ground that only one image shows
    a, b = (i[::4, ::4].astype(np.float32) for i in (image, other))
    mean, wanted = float(a.mean()), float(b.mean())
    gain = float(b.std()) / max(float(a.std()), 1e-3)
    if abs(gain - 1.0) < settings.same_gain and abs(wanted - mean) < settings.same_gain * mean:
        return image
    shift = wanted - gain * mean
    levels = np.clip(np.round(gain * np.arange(256.0) + shift), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, levels))


def common_shift(then: U8, now: U8, pixels: F32, predicted: F32, least_overlap: float) -> F32:
    """Return the (2,) shift, px, that corrects all predicted pixels; 0 if the images overlap too little.

    A quarter of the image's shorter side is searched in each direction, so that half of the image is compared.

    Args:
        then, now: earlier and present image.
        pixels, predicted: (N, 2) pixels of the features in both images.
        least_overlap: least share of the image that must overlap.
    """
    # one degree of tilt is 34 px, beyond the search of single features
    a, b = downsampled(then), downsampled(now)
    k = downsampling_factor(now)
    warped, valid = _warped(a, b, _affine_of(pixels, predicted, k))
    r = min(a.shape) // 4
    if valid.mean() < least_overlap:
        return np.zeros(2, np.float32)
    high = [_high_pass(warped), _high_pass(b)]
    inner = high[0][r:-r, r:-r] * valid[r:-r, r:-r]
    score = cv2.matchTemplate(high[1], inner, cv2.TM_CCORR_NORMED, mask=valid[r:-r, r:-r].astype(np.float32))
    y, x = np.unravel_index(int(np.argmax(score)), score.shape)
    return np.array([(x - r) * k, (y - r) * k], np.float32)


def likely_turns(now_from_then: Pose | None, covariance: F64 | None, sigmas: float) -> tuple[float, ...]:
    """Return the turns about the optical axis, rad, that a predicted motion of camera 0 leaves possible.

    Without a prediction or covariance, all `TURNS` are returned.

    Args:
        now_from_then: predicted motion.
        covariance: (6, 6) covariance of the prediction, rotation first.
        sigmas: largest error of the predicted turn, in standard deviations.
    """
    # the lines of a car park look the same after half a turn, so turns that the gyros exclude are not tried
    if now_from_then is None or covariance is None:
        return TURNS
    R, reach = now_from_then.rotation, sigmas * float(np.sqrt(covariance[2, 2]))
    turn = float(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))
    return tuple(turn + x for x in TURNS if min(x, 2 * np.pi - x) <= reach)


def relocate(then: U8, now: U8, pixels: F32, turns: tuple[float, ...]) -> F32:
    """Return where pixels (N, 2) of image `then` lie in image `now`, which differs by an unknown turn and shift.

    The downsampled images are phase correlated (Kuglin and Hines 1975) for each of the `turns` about the optical axis,
    rad; the turn with the highest peak is used.
    """
    middle = (np.array([then.shape[1], then.shape[0]], np.float64) - 1.0) / 2.0
    k, a, b = downsampling_factor(now), downsampled(then), downsampled(now)
    window = cv2.createHanningWindow((b.shape[1], b.shape[0]), cv2.CV_32F)
    best, found = -1.0, pixels
    for turn in turns:
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        predicted = ((pixels - middle) @ R.T + middle).astype(np.float32)
        about = (middle + 0.5) / k - 0.5
        warped, _ = _warped(a, b, np.column_stack([R, about - R @ about]))
        shift, peak = cv2.phaseCorrelate(_high_pass(warped), _high_pass(b), window)
        if peak > best:
            best, found = peak, predicted + np.array(shift, np.float32) * k
    return found.astype(np.float32)


def _high_pass(image: U8) -> F32:
    x = image.astype(np.float32)
    return np.asarray(x - cv2.GaussianBlur(x, (0, 0), 4.0), dtype=np.float32)


def downsampling_factor(image: U8) -> int:
    """Return the factor by which an image is downsampled, to about 160 px on its shorter side."""
    return max(1, round(int(min(image.shape)) / 160))


def downsampled(image: U8) -> U8:
    """Return the image downsampled by `downsampling_factor`."""
    k = 1.0 / downsampling_factor(image)
    return np.asarray(cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA))


def _affine_of(pixels: F32, predicted: F32, factor: int) -> F64:
    """Return the affine map (2, 3) of images downsampled by `factor` that fits `pixels` to `predicted` (full size)."""
    a, b = ((x.astype(np.float64) + 0.5) / factor - 0.5 for x in (pixels, predicted))
    return np.asarray(np.linalg.lstsq(np.column_stack([a, np.ones(len(a))]), b, rcond=None)[0].T)


def _warped(then: U8, now: U8, affine: F64) -> tuple[U8, Mask]:
    """Return the image `then`, warped by an affine map (2, 3) to the size of `now`, and the mask of valid pixels."""
    size = (now.shape[1], now.shape[0])
    valid = cv2.warpAffine(np.ones_like(then), affine, size, flags=cv2.INTER_NEAREST) > 0
    return np.asarray(cv2.warpAffine(then, affine, size)), np.asarray(valid)


def image_correlation(then: U8, now: U8, pixels: F32, predicted: F32, factor: int, least_overlap: float) -> float:
    """Return the correlation of two downsampled images, after the affine map from `pixels` to `predicted` (full size).

    It is -1 if less than the share `least_overlap` of the image overlaps.
    """
    warped, valid = _warped(then, now, _affine_of(pixels, predicted, factor))
    if valid.mean() < least_overlap:
        return -1.0
    x, y = warped[valid].astype(np.float64), now[valid].astype(np.float64)
    return float(np.corrcoef(x, y)[0, 1]) if x.std() > 0 and y.std() > 0 else -1.0
