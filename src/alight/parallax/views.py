"""Views prepared for matching: smoothed to the cell size, normalised, sampled on the world grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F32, F64, U8, Mask
from alight.geometry import Camera, Grid, Pose, ground_projection
from alight.parallax.projection_kernels import project_grid
from alight.parallax.view_kernels import normalise
from alight.raster import grey_levels, rgb_levels
from alight.records import View

NORM_CELLS = 5  # cells, window of the local mean and deviation; 9 cells smear walls and give a third more noise
NORM_FLOOR = 3.0  # grey levels, least standard deviation: noise is not amplified to texture
STEEPEST = np.cos(np.radians(75.0))  # cosine of the largest angle of used views and rays from straight down
BLOCK = 8  # cells on a side of a block of which it is decided as a whole where its rays may end, and whether it moves
LEAST_SIDE = 8  # pixels, least length of the shorter side of a picture that is made coarser


@dataclass(frozen=True, eq=False)
class Prepared:
    """One view, prepared for matching on cells of one size."""

    grey: F32  # (H, W) grey levels, smoothed to the cell size
    norm: F32  # (H, W) normalised: (grey - local mean) / local standard deviation
    camera: Camera
    H: F64  # (3, 3) ground homography, ideal coordinates (eq. 2)
    b: F64  # (3,) image of the vertical (eq. 2)
    centre: F64  # (3,) camera centre, metres
    r2_max: float  # largest squared ideal radius in the image: beyond it the lens polynomial folds back
    ratio: float  # width of a cell in pixels
    rolling: F64  # motion during the exposure, see `rolling_of`

    def posed(self, world_from_cam: Pose) -> Prepared:
        """Return the prepared view with another camera pose."""
        H, b = ground_projection(world_from_cam)
        return replace(self, H=H, b=b, centre=np.array(world_from_cam.translation))


def tone_of(view: View) -> U8:
    """Return the (256, 3) table from grey levels of a view to colours that its gain makes comparable between views."""
    levels = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    return levels if view.gain is None else np.rint(levels * view.gain).clip(0, 255).astype(np.uint8)


def is_grey(view: View) -> bool:
    """Whether a view has one channel and one gain; photos count as coloured."""
    image = view.image
    return isinstance(image, np.ndarray) and image.ndim == 2 and (view.gain is None or bool(np.ptp(view.gain) == 0))


@cache
def border_rays(camera: Camera) -> F64:
    """Return directions (N, 3) in the optical frame, with z = 1, along the border of a camera's picture."""
    w, h = camera.width - 1.0, camera.height - 1.0
    u, v = np.linspace(0, w, 17), np.linspace(0, h, 17)
    border = np.concatenate([np.c_[u, 0 * u], np.c_[u, 0 * u + h], np.c_[0 * v, v], np.c_[0 * v + w, v]])
    return camera.rays(border)


def on_level(rays: F64, centre: F64, height: float) -> F64:
    """Return where rays (N, 3) from a camera `centre` (3,) meet level ground at `height`, (N, 2) metres.

    Flatter rays than `STEEPEST` end at that angle.
    """
    down = np.maximum(-rays[:, 2], np.linalg.norm(rays, axis=1) * STEEPEST)
    return np.asarray(centre[:2] + rays[:, :2] * ((centre[2] - height) / down)[:, None])


@cache
def radius2_limit(camera: Camera) -> float:
    """Return the largest squared radius, in undistorted coordinates, along the border of the image, plus 2 %."""
    return float((border_rays(camera)[:, :2] ** 2).sum(axis=1).max() * 1.02)


def ground_sampling(view: View, height: float) -> float:
    """Return the ground sampling distance at the image centre, metres, for level ground at `height`, metres."""
    drop = max(view.centre[2] - height, 1e-3)
    tilt = max(-view.world_from_cam.rotation[2, 2], 0.2)  # cosine of the optical axis to the vertical
    return float(drop / tilt / view.camera.fu)


def halved(grey: F32, camera: Camera) -> tuple[F32, Camera]:
    """Return an image at half the resolution, and the camera of that image; an odd last row or column is dropped."""
    # otherwise the resized image would lie up to half a pixel beside its camera
    rows, cols = (n // 2 for n in grey.shape)
    half = cv2.resize(grey[: 2 * rows, : 2 * cols], (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(half, np.float32), replace(camera.scaled(0.5), width=cols, height=rows)


def prepare_view(view: View, cell: float, height: float) -> Prepared:
    """Smooth a view to the cell size and normalise it by local mean and standard deviation, so that gain cancels.

    `height`: of the ground, metres, sets the scale; even if it is wrong, the shorter side keeps `LEAST_SIDE` pixels.
    """
    grey, camera = grey_levels(view.image).astype(np.float32), view.camera
    ratio = min(cell / ground_sampling(view, height), max(min(grey.shape) / LEAST_SIDE, 1.0))
    while ratio >= 1.9:  # a cell spans two pixels
        grey, camera = halved(grey, camera)
        ratio /= 2
    sigma = 0.5 * np.sqrt(max(ratio**2 - 1.0, 0.0)) + 0.4  # 0.4 px: linear sampling then blurs alike at any phase
    grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma), np.float32)
    H, b = ground_projection(view.world_from_cam)
    norm = _normalised(grey, ratio)
    return Prepared(grey, norm, camera, H, b, np.array(view.centre), radius2_limit(camera), ratio, rolling_of(view))


def rolling_of(view: View) -> F64:
    """Return the (9,) motion of the camera while its rows were exposed (eq. 4b); (0,) if all were exposed at once.

    The elements are the translation [m] and the linear and quadratic part of the rotation [rad].
    """
    return np.empty(0) if view.rolling is None else view.rolling


def _normalised(grey: F32, ratio: float) -> F32:
    norm = np.empty_like(grey)
    normalise(grey, int(NORM_CELLS * max(ratio, 1.0)) // 2, NORM_FLOOR, norm)
    return norm


@dataclass(frozen=True, eq=False)
class Kept:
    """A view with its prepared pictures at several resolutions."""

    view: View
    levels: list[Prepared]  # for the cells of the map, for twice their size, ...; each is made at its first use

    @classmethod
    def of(cls, view: View, cell: float, height: float) -> Kept:
        """Prepare a view for cells of `cell` metres on ground at `height` metres."""
        return cls(view, [prepare_view(view, cell, height)])

    @property
    def fine(self) -> Prepared:
        """The view prepared for the cells of the map."""
        return self.levels[0]

    def halved(self, times: int) -> Prepared:
        """Return the view prepared for cells 2**`times` times as large, with its picture halved `times` times."""
        while len(self.levels) <= times:
            fine = self.levels[-1]
            grey, camera = halved(fine.grey, fine.camera)
            self.levels.append(replace(fine, grey=grey, norm=_normalised(grey, fine.ratio), camera=camera))
        return self.levels[times]

    def posed(self, world_from_cam: Pose) -> Kept:
        """Return the view with another camera pose."""
        view = replace(self.view, world_from_cam=world_from_cam)
        return Kept(view, [p.posed(world_from_cam) for p in self.levels])


class Buffers:
    """Named arrays that are reused from step to step, because the system allocates new memory slowly."""

    def __init__(self) -> None:
        self._flat: dict[str, NDArray[Any]] = {}

    def get(self, name: str, shape: tuple[int, ...], dtype: type[np.generic] = np.float32) -> NDArray[Any]:
        """Return the array of this name and shape, with undefined content; its earlier content is lost."""
        size = math.prod(shape)
        if name not in self._flat or self._flat[name].size < size:
            self._flat[name] = np.empty(size + size // 8, dtype)
        return self._flat[name][:size].reshape(shape)


def centres_of(prepared: list[Prepared]) -> F64:
    """Return the camera centres (N, 3), metres."""
    return np.array([p.centre for p in prepared])


def when_exposed(p: Prepared, grid: Grid, height: float) -> Prepared:
    """Return the view with its camera centre at the time when the middle of `grid`, at `height` metres, was exposed."""
    if not p.rolling.size:
        return p
    x, y = (float(v.mean()) for v in grid.xy())
    row = float(maps(p, np.array([x]), np.array([y]), np.full((1, 1), height, np.float32))[1][0, 0])
    share = (row + 0.5) / p.camera.height - 0.5 if row >= 0 else 0.0
    way = np.array([p.H[:, 0], p.H[:, 1], p.b]) @ p.rolling[:3]  # the columns of H and b are the world's axes
    return replace(p, centre=p.centre + share * way)


def maps(p: Prepared, xs: F64, ys: F64, h: F32, buffers: Buffers | None = None) -> tuple[F32, F32]:
    """Project ground points at heights `h` (R, C), metres, to pixel columns and rows, (R, C) each (eqs. 1 to 3).

    Pixels are negative outside the picture. `xs` (C,) is east, evenly spaced; `ys` (R,) is north, with any spacing;
    both in metres.
    """
    held, camera = buffers or Buffers(), p.camera
    out = held.get("mapx", h.shape), held.get("mapy", h.shape)
    lens = np.array([camera.fu, camera.fv, camera.cu, camera.cv])
    project_grid(
        p.H, p.b, lens, camera.coefficients, camera.code, p.r2_max,
        float(camera.width), float(camera.height), p.rolling, *(np.ascontiguousarray(v) for v in (xs, ys)), h, *out,
    )  # fmt: skip
    return out


def sample(
    image: NDArray[np.float32], mapx: F32, mapy: F32, out: F32 | None = None, how: int = cv2.INTER_LINEAR
) -> F32:
    """Sample an image at pixel columns `mapx`, rows `mapy` (R, C) by OpenCV's interpolation `how`; NaN outside."""
    return np.asarray(cv2.remap(image, mapx, mapy, how, dst=out, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan))


def stack(prepared: list[Prepared], grid: Grid, h: F32, buffers: Buffers | None = None) -> F32:
    """Return normalised samples (N, R, C) of the views on a grid at heights `h` (R, C), metres; NaN: outside."""
    held = buffers or Buffers()
    out = held.get("samples", (len(prepared), *grid.shape))
    for i, p in enumerate(prepared):
        sample(p.norm, *maps(p, *grid.xy(), h, held), out=out[i])
    return out


def inside_picture(camera: Camera, points_cam: F64) -> Mask:
    """Return a mask of points (N, 3), in the optical frame, that lie in front of the camera and in its picture."""
    uv = camera.project(points_cam)
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] <= camera.width - 1) & (uv[:, 1] <= camera.height - 1)
    return np.asarray(inside & (points_cam[:, 2] > 0))


def may_see(views: Sequence[View], grid: Grid, low: float, high: float) -> list[int]:
    """Return the indices of views that may see part of a grid between heights `low` and `high`, metres.

    No view that sees the grid is missing; some that do not see it are included.
    """
    # the cone around each picture is tested against the sphere around the ground, for all views at once: with thousands
    # of photos, most are far from a tile
    if not views:
        return []
    x, y = grid.xy()
    middle = np.array([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1]), 0.5 * (low + high)])
    radius = 0.5 * float(np.linalg.norm([x[-1] - x[0] + grid.cell, y[0] - y[-1] + grid.cell, high - low]))
    ray = middle - np.array([v.centre for v in views])
    axes = np.array([v.world_from_cam.rotation[:, 2] for v in views])
    distance = np.maximum(np.linalg.norm(ray, axis=1), 1e-9)
    off = np.arccos(np.clip((ray * axes).sum(axis=1) / distance, -1.0, 1.0))
    field = np.arctan(np.sqrt([radius2_limit(v.camera) for v in views]))
    wide = np.where(distance > radius, np.arcsin(np.minimum(radius / distance, 1.0)), np.pi)
    return np.flatnonzero(off <= field + wide + 1e-6).tolist()


def choose_views(views: Sequence[View], grid: Grid, height: float, count: int, max_tangent: float) -> list[int]:
    """Return the indices of up to `count` views that see each part of a grid often, over wide and even baselines.

    Views flatter than `max_tangent` (horizontal over vertical distance) weigh less. `height`: of the ground, metres.
    """
    if not views:
        return []
    xs, ys = grid.xy()
    px, py = np.meshgrid(np.linspace(xs[0], xs[-1], 7), np.linspace(ys[0], ys[-1], 7))
    points = np.c_[px.ravel(), py.ravel(), np.full(px.size, height)]
    inside, offset = [], []
    for v in views:
        ray = v.world_from_cam.inverse.apply(points)
        with np.errstate(invalid="ignore"):
            ok = inside_picture(v.camera, ray) & (((ray[:, :2] / ray[:, 2:3]) ** 2).sum(1) < radius2_limit(v.camera))
        tangent = np.hypot(*(points - v.centre)[:, :2].T) / max(v.centre[2] - height, 1e-3)
        inside.append(ok * np.where(tangent <= max_tangent, 1.0, 0.25))
        offset.append(v.centre / max(v.centre[2] - height, 1e-3))
    seen, centres = np.array(inside), np.array(offset)
    chosen: list[int] = []
    total = np.zeros(len(points))
    distance = np.ones((len(views), len(points)))  # to the nearest chosen view that sees the point
    while len(chosen) < count:
        gain = (seen * distance / (1.0 + total)).sum(axis=1)
        gain[chosen] = 0
        k = int(np.argmax(gain))
        if gain[k] < 1e-3:
            break
        chosen.append(k)
        total += seen[k]
        apart = np.linalg.norm(centres - centres[k], axis=1)
        distance = np.where(seen[k] > 0, np.minimum(distance, apart[:, None]), distance)
    return sorted(chosen)


def colour_at(view: View, prepared: Prepared, mapx: F32, mapy: F32) -> U8:
    """Return the gain-corrected colours (R, C, 3) of a view at columns `mapx` and rows `mapy` of its prepared image."""
    scale = np.float32(view.camera.fu / prepared.camera.fu)
    offset = np.float32(0.5) * scale - np.float32(0.5)
    levels = cv2.remap(np.asarray(view.image), mapx * scale + offset, mapy * scale + offset, cv2.INTER_LINEAR)
    seen = rgb_levels(np.asarray(levels, np.uint8))
    return seen if view.gain is None else np.asarray(cv2.LUT(seen, tone_of(view)[None]), np.uint8)
