"""Raster operators that several stages share: blocks, discs, smoothing, morphology, distances, brightness."""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, reduce
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from alight.arrays import F32, I64, U8, Mask

T = TypeVar("T", bound=np.generic)
Float = TypeVar("Float", bound=np.floating[Any])
# cells, added to the radius: a centre exactly on the rim belongs to the disc in spite of rounding
RIM = float(np.finfo(np.float32).eps)
LEAST_SHARE = np.float32(1e-3)  # least share of a Gaussian's weight on known cells for a mean
_LOG_LEVELS = np.log(np.arange(256, dtype=np.float32) + np.float32(2.0))  # + 2: noise in dark pixels gives no contrast


_FILTERS = threading.Lock()


@contextmanager
def placeless_rasters() -> Iterator[None]:
    """Keep rasterio from warning of rasters without a place; by one thread at a time, as filters are of the process."""
    from rasterio.errors import NotGeoreferencedWarning

    with _FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def unreadable() -> tuple[type[Exception], ...]:
    """Return the exceptions that opening or reading a raster file may raise."""
    from rasterio._err import CPLE_BaseError  # not public; raised for coordinates that cannot be converted
    from rasterio.errors import CRSError, RasterioError

    return RasterioError, CRSError, CPLE_BaseError, UnicodeDecodeError  # the last: a file name that cannot be decoded


# -- square blocks of cells: to a coarser raster, and back


def cells_as_blocks(fine: NDArray[T], factor: int) -> NDArray[T]:
    """View (R * factor, C * factor) pixels as (R, factor, C, factor), grouped by cell."""
    rows, cols = fine.shape[0] // factor, fine.shape[1] // factor
    return fine.reshape(rows, factor, cols, factor)


def whole_blocks(values: NDArray[T], factor: int) -> NDArray[T]:
    """Repeat the last row and column of (R, C) values until both sides are multiples of `factor`."""
    missing = [(0, -n % factor) for n in values.shape]
    return np.pad(values, missing, mode="edge") if any(n for _, n in missing) else values


def block_mean(fine: F32, factor: int) -> F32:
    """Compute the mean of `factor` x `factor` pixels per cell: (R * factor, C * factor) to (R, C)."""
    size = (fine.shape[1] // factor, fine.shape[0] // factor)
    return np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.float32)


def block_max(fine: F32, factor: int) -> F32:
    """Compute the maximum of `factor` x `factor` pixels per cell: (R * factor, C * factor) to (R, C)."""
    pixels = (fine[r::factor, c::factor] for r in range(factor) for c in range(factor))
    return np.asarray(reduce(np.maximum, pixels), np.float32)


def block_quantile(values: F32, factor: int, share: float) -> F32:
    """Compute the quantile of the known cells of each block; NaN for a block without a known cell.

    Args:
        values: (R, C), NaN = unknown; the last row and column of blocks may be incomplete.
        factor: side of a block, cells.
        share: quantile, 0 to 1; the value of that rank is returned without interpolation.
    """
    padded = np.pad(
        np.asarray(values, np.float32), [(0, -n % factor) for n in values.shape], constant_values=np.float32(np.nan)
    )
    blocks = cells_as_blocks(padded, factor).transpose(0, 2, 1, 3)
    cells = np.sort(blocks.reshape(*blocks.shape[:2], -1), axis=2)
    known = np.isfinite(cells).sum(axis=2)
    pick = np.clip(np.floor(share * known), 0, np.maximum(known - 1, 0)).astype(np.int64)
    return np.take_along_axis(cells, pick[..., None], axis=2)[..., 0]


def upsample(coarse: NDArray[T], factor: int, shape: tuple[int, int] | None = None) -> NDArray[T]:
    """Repeat each cell's value for its `factor` x `factor` pixels, and crop the result to `shape` if it is given."""
    fine = np.repeat(np.repeat(coarse, factor, axis=1), factor, axis=0)  # rows last: these are copied whole
    return fine if shape is None else fine[: shape[0], : shape[1]]


# -- the disc of cells whose centres lie within a radius, as under a lander's footprint


def disc_spans(radius_cells: float) -> I64:
    """Return the half width of each row of a disc, (2 n + 1,) cells, north first; `radius_cells`: radius in cells."""
    reach = math.floor(radius_cells + RIM)
    rows = np.arange(-reach, reach + 1, dtype=np.float64)
    return np.floor(np.sqrt(np.maximum((radius_cells + RIM) ** 2 - rows**2, 0.0)) + RIM).astype(np.int64)


def disc_mask(spans: I64) -> U8:
    """Return the disc of `disc_spans` as a (2 n + 1, 2 n + 1) array of ones and zeros, as OpenCV's filters need it."""
    reach = spans.size // 2
    return (np.abs(np.arange(-reach, reach + 1)) <= spans[:, None]).astype(np.uint8)


def _disc(radius: float, cell: float) -> U8:
    return disc_mask(disc_spans(radius / cell))


def _disc_sums(values: F32 | Mask, radius: float, cell: float) -> F32:
    disc = _disc(radius, cell).astype(np.float32)
    return np.asarray(cv2.filter2D(values.astype(np.float32), cv2.CV_32F, disc, borderType=cv2.BORDER_CONSTANT))


@lru_cache(maxsize=16)
def _cells_in(shape: tuple[int, ...], radius: float, cell: float) -> F32:
    cells = _disc_sums(np.ones(shape, np.bool_), radius, cell)
    cells.flags.writeable = False
    return cells


def disc_mean(values: F32, radius: float, cell: float) -> F32:
    """Compute the mean of the known values in each cell's disc; NaN if none is known; `radius`, `cell`: metres."""
    known = np.isfinite(values)
    if known.all():
        return np.asarray(_disc_sums(values, radius, cell) / _cells_in(values.shape, radius, cell), np.float32)
    total, weight = (_disc_sums(a, radius, cell) for a in (np.where(known, values, 0), known))
    out = np.full(values.shape, np.nan, dtype=np.float32)
    np.divide(total, weight, out=out, where=weight > 0.5)
    return out


def disc_max(values: F32, radius: float, cell: float) -> F32:
    """Compute the largest value in the disc around every cell; a `radius` below `cell` becomes `cell`; both metres.

    Each row of a disc is widened from the next narrower one, so that a wide disc takes a third of the time of a filter.
    """
    spans, (rows, cols) = disc_spans(max(radius, cell) / cell), values.shape
    reach, out, along, width = spans.size // 2, np.array(values, np.float32), np.asarray(values, np.float32), 0
    for away in range(min(reach, rows - 1), -1, -1):  # rows of the disc from its ends inwards
        while width < (wanted := min(int(spans[reach - away]), cols - 1)):
            more, wider = min(wanted - width, width + 1), along.copy()
            np.maximum(along[:, :-more], wider[:, more:], out=wider[:, more:])
            np.maximum(along[:, more:], wider[:, :-more], out=wider[:, :-more])
            along, width = wider, width + more
        np.maximum(out[away:], along[: rows - away], out=out[away:])
        np.maximum(out[: rows - away], along[away:], out=out[: rows - away])
    return out


def disc_share(mask: Mask, radius: float, cell: float) -> F32:
    """Compute the share of True cells in the disc around every cell; cells off the map are False; lengths in metres."""
    disc = _disc(radius, cell).astype(np.float32)
    share: F32 = cv2.filter2D(mask.astype(np.float32), cv2.CV_32F, disc / disc.sum(), borderType=cv2.BORDER_CONSTANT)
    return share


def disc_any(mask: Mask, radius: float, cell: float) -> Mask:
    """Return the mask of cells whose disc holds a True cell of `mask`; `radius`, `cell`: metres."""
    disc = _disc(radius, cell)
    near: Mask = cv2.dilate(mask.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return near


def disc_crosses_edge(shape: tuple[int, int], radius: float, cell: float) -> Mask:
    """Return the mask of cells whose disc reaches beyond a map of `shape`; `radius`, `cell`: metres."""
    reach = disc_spans(radius / cell).size // 2
    out = np.ones(shape, dtype=np.bool_)
    out[reach : shape[0] - reach, reach : shape[1] - reach] = False
    return out


class DiscWindow(NamedTuple):
    """Part of a map that a disc covers, cropped at the map's edge."""

    rows: slice
    cols: slice
    inside: Mask  # (rows, cols) of the window; True: in the disc


def disc_window(shape: tuple[int, int], row: int, col: int, radius_cells: float) -> DiscWindow:
    """Return the window of the disc about cell (row, col) of a map of `shape`; `radius_cells`: radius in cells."""
    reach = math.floor(radius_cells + RIM)
    rows = slice(max(0, row - reach), min(shape[0], row + reach + 1))
    cols = slice(max(0, col - reach), min(shape[1], col + reach + 1))
    y, x = np.ogrid[rows.start - row : rows.stop - row, cols.start - col : cols.stop - col]
    return DiscWindow(rows, cols, np.hypot(x, y) <= radius_cells + RIM)


# -- Gaussian means of all cells, or of known cells only (normalised convolution, Knutsson and Westin 1993)


class WeightedMean(NamedTuple):
    """Weighted mean about every cell, (R, C) arrays."""

    mean: F32  # not reliable where the share is below `LEAST_SHARE`
    share: F32  # share of the Gaussian's weight on cells with positive weight, 0 to 1

    @property
    def where_near(self) -> F32:
        """The mean, NaN where no cell with weight is near."""
        return np.where(self.share > LEAST_SHARE, self.mean, np.float32(np.nan))


def _blurred_small(values: F32, size: tuple[int, int], sigma: float) -> F32:
    return np.asarray(cv2.GaussianBlur(cv2.resize(values, size, interpolation=cv2.INTER_AREA), (0, 0), sigma))


def _enlarged(values: F32, shape: tuple[int, ...]) -> F32:
    return np.asarray(cv2.resize(values, shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def gaussian_mean(values: F32, sigma: float) -> F32:
    """Compute the Gaussian mean of all cells, (R, C) without NaN; `sigma`: 1-sigma in cells."""
    if sigma <= 6.0:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), max(sigma, 0.3)), np.float32)  # 0.3: only the cell itself
    n = int(2 * sigma / 6.0)  # wide Gaussians: on a coarser raster, then interpolated
    size = (max(1, values.shape[1] // n), max(1, values.shape[0] // n))
    return _enlarged(_blurred_small(values, size, sigma / n), values.shape)


def difference_of_gaussians(values: F32, narrow: float, wide: float) -> F32:
    """Subtract the Gaussian mean of 1-sigma `wide` from the mean of 1-sigma `narrow`, both in cells; (R, C)."""
    out = gaussian_mean(values, narrow)
    out -= gaussian_mean(values, wide)
    return out


def weighted_gaussian(values: F32, weight: F32, sigma: float) -> WeightedMean:
    """Compute the weighted Gaussian mean, and the share of the Gaussian that lies on cells with weight.

    Args:
        values: (R, C); ignored where the weight is 0, so they may be NaN there.
        weight: (R, C), 0 or more.
        sigma: 1-sigma of the Gaussian, cells.
    """
    total = cv2.GaussianBlur(_weighted(values, weight), (0, 0), sigma)
    share = np.asarray(cv2.GaussianBlur(weight, (0, 0), sigma), np.float32)
    return WeightedMean(np.asarray(total / np.maximum(share, LEAST_SHARE), np.float32), share)


def masked_gaussian(values: F32, weight: F32, sigma: float) -> F32:
    """Compute the mean of `weighted_gaussian`, (R, C), with NaN where no cell with weight is near."""
    if sigma <= 8.0:
        return weighted_gaussian(values, weight, sigma).where_near
    n = int(sigma / 4.0)  # wide Gaussians: on a coarser raster, then interpolated
    size = (max(1, round(values.shape[1] / n)), max(1, round(values.shape[0] / n)))
    total, share = (_blurred_small(a, size, sigma / n) for a in (_weighted(values, weight), weight))
    mean = np.asarray(total / np.maximum(share, LEAST_SHARE), np.float32)
    return _enlarged(WeightedMean(mean, share).where_near, values.shape)


def _weighted(values: F32, weight: F32) -> F32:
    return np.asarray(np.where(weight > 0, values * weight, 0), np.float32)


# -- morphology with OpenCV's elliptic structuring element (narrower than a true disc at its ends)


def ellipse(reach: int) -> U8:
    """Return the elliptic structuring element, (2 reach + 1, 2 reach + 1), ones and zeros; `reach` in cells."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)


def close_mask(mask: Mask, reach: int) -> Mask:
    """Close the mask (binary closing): fill gaps narrower than 2 * `reach` cells."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, ellipse(reach), borderValue=0)
    return np.asarray(closed > 0)


def grow(mask: Mask, reach: int) -> Mask:
    """Dilate the mask by `reach` cells."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), ellipse(reach)) > 0)


def fill_pits(values: F32, width: int) -> F32:
    """Raise low areas that are narrower than `width` cells (grey-scale closing)."""
    if width % 2:
        return np.asarray(cv2.morphologyEx(values, cv2.MORPH_CLOSE, ellipse(width // 2)), np.float32)
    square = np.ones((width, width), np.uint8)  # without a middle cell; opposite anchors keep values in position
    raised = cv2.dilate(values, square, anchor=(0, 0))
    return np.asarray(cv2.erode(raised, square, anchor=(width - 1, width - 1)), np.float32)


def local_max(values: F32, reach: int) -> F32:
    """Return the largest value within `reach` cells of every cell (grey-scale dilation)."""
    return np.asarray(cv2.dilate(values, ellipse(reach)), np.float32)


def without_specks(mask: Mask, cell: float, least: float, neighbours: int = 8) -> Mask:
    """Remove connected patches smaller than `least` m^2; `cell` in metres, `neighbours`: connectivity, 4 or 8."""
    labels, stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=neighbours)[1:3]
    big = stats[:, cv2.CC_STAT_AREA] * cell**2 >= least
    big[0] = False
    return np.asarray(big[labels])


# -- distances, unknown cells, slopes


def distance_to(mask: Mask) -> F32:
    """Compute the distance of every cell's centre to the nearest True centre, (R, C) cells; inf if no cell is True."""
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    # not OpenCV: the last bits of its distances depend on the number of free threads
    return np.asarray(distance_transform_edt(~mask), np.float32)


def clearance_of(free: Mask, cell: float) -> F32:
    """Compute the distance of each cell's centre to the edge of the nearest cell that is not `free`, (R, C) metres."""
    out: F32 = np.maximum(distance_to(~free) - np.float32(0.5), np.float32(0)) * np.float32(cell)
    return out


def nearest_known(values: NDArray[T], known: Mask) -> NDArray[T]:
    """Replace unknown cells of (R, C, ...) by the nearest known cell; `values` is unchanged if no cell is known."""
    if known.all() or not known.any():
        return values
    at = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(at)])


def filled_surface(height: F32) -> F32:
    """Subtract the median from heights (R, C), to keep float32 digits, and fill NaN by the nearest value, or by 0."""
    known = np.isfinite(height)
    middle = np.float32(np.median(height[known])) if known.any() else np.float32(0)
    return np.asarray(np.nan_to_num(nearest_known(height - middle, known)))


class Rise(NamedTuple):
    """Slopes by central differences, per unit of the spacing, (R, C) arrays."""

    down: NDArray[Any]  # towards the next row
    right: NDArray[Any]  # towards the next column


def gradient(values: NDArray[Float], spacing: float = 1.0) -> Rise:
    """Compute central differences like `numpy.gradient`, but 0 along an axis with a single cell, where NumPy raises."""
    sides = [np.gradient(values, spacing, axis=k) if values.shape[k] > 1 else np.zeros_like(values) for k in range(2)]
    return Rise(*sides)


# -- functions of single values, for features


def linear_ramp(values: F32, low: float, high: float) -> F32:
    """Map values to 0 below `low`, 1 above `high` and linearly in between; NaN gives 0."""
    scaled = np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(np.nan_to_num(scaled), np.float32)


def log_at_least(values: F32, floor: float) -> F32:
    """Compute the natural logarithm of max(values, floor); NaN is treated as 1."""
    return np.asarray(np.log(np.maximum(np.nan_to_num(values, nan=1.0), np.float32(floor))), np.float32)


def log_offset(values: F32, offset: float) -> F32:
    """Compute the natural logarithm of values + offset; NaN is treated as 0."""
    return np.asarray(np.log(np.nan_to_num(values) + np.float32(offset)), np.float32)


# -- log brightness and excess green of a picture: their contrasts do not depend on the exposure


def rgb_levels(picture: U8) -> U8:
    """Return the levels of a picture, grey (R, C) or RGB, as RGB (R, C, 3)."""
    return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def grey_levels(picture: ArrayLike) -> U8:
    """Convert an 8-bit picture, (R, C) grey or (R, C, 3) RGB, to grey levels (R, C)."""
    levels = np.asarray(picture)
    return levels if levels.ndim == 2 else np.asarray(cv2.cvtColor(levels, cv2.COLOR_RGB2GRAY), np.uint8)


def log_levels(levels: U8) -> F32:
    """Compute the natural logarithm of 8-bit grey levels + 2; any shape."""
    return np.asarray(_LOG_LEVELS[levels])


def log_brightness(rgb: U8) -> F32:
    """Compute `log_levels` of the grey levels of an RGB picture: (R, C, 3) to (R, C)."""
    return log_levels(grey_levels(rgb))


class BlockLight(NamedTuple):
    """Log brightness of square blocks of pixels, (R, C) arrays."""

    mean: F32
    seen: F32  # share of the block's pixels that are not black: black means unseen
    within: F32  # variance of the pixels of a block; 0 unless it was requested


def _strips(rgb: U8, inner: int) -> Iterator[tuple[slice, U8, F32]]:
    """Yield the picture in strips of 256 rows of blocks, to save memory; `inner`: pixels per side of a block.

    Yields:
        the slice of block rows, their pixels, and the (rows, cols) share of non-black pixels in each block.
    """
    for top in range(0, rgb.shape[0] // inner, 256):
        part = rgb[top * inner : (top + 256) * inner]
        yield slice(top, top + 256), part, block_mean((part[..., 1] > 0).astype(np.float32), inner)


def block_light(rgb: U8, inner: int, within: bool = False) -> BlockLight:
    """Compute the log brightness of `inner` x `inner` blocks of an RGB picture (R * inner, C * inner, 3).

    `within`: whether to compute the variance within each block.
    """
    out = BlockLight(*np.zeros((3, rgb.shape[0] // inner, rgb.shape[1] // inner), np.float32))
    for at, part, seen in _strips(rgb, inner):
        light = log_brightness(part)
        out.mean[at], out.seen[at] = block_mean(light, inner), seen
        if within and inner > 1:
            out.within[at] = np.maximum(block_mean(light * light, inner) - out.mean[at] * out.mean[at], 0)
    return out


class BlockGreen(NamedTuple):
    """Excess green, (2 G - R - B) / (R + G + B), of square blocks of pixels, (R, C) arrays."""

    mean: F32  # excess green of the block's mean colour
    seen: F32  # share of the block's pixels that are not black
    coloured: bool  # whether any pixel of the picture is not grey


def block_green(rgb: U8, inner: int) -> BlockGreen:
    """Compute the excess green of `inner` x `inner` blocks of an RGB picture (R * inner, C * inner, 3)."""
    mean, seen = np.zeros((2, rgb.shape[0] // inner, rgb.shape[1] // inner), np.float32)
    coloured = False
    for at, part, share in _strips(rgb, inner):
        r, g, b = (block_mean(part[..., k].astype(np.float32), inner) for k in range(3))
        mean[at], seen[at] = (2 * g - r - b) / np.maximum(r + g + b, 1), share
        coloured = coloured or bool((part[..., 0] != part[..., 1]).any())
    return BlockGreen(mean, seen, coloured)
