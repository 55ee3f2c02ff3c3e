"""Accuracy of matchers on a recording with true poses and ground: the estimator, StereoSGBM, and tracks."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from subjects import Points, Subject

from alight.arrays import F32, F64
from alight.geometry import Grid
from alight.records import ElevationMap, Flag, Terrain, View
from alight.runner import replay
from alight.spread import nmad

WRONG = 0.01  # of the height above ground
STEP = 0.13  # of the height between the pictures of a pair: every second photo
PAIRS = 4
BORDER = 8  # px
# blocks of 3 to 9 and nine pairs of P1, P2 tried on tuning-1 of meadow and village at 40 m: the best ground but for
# P1 = 50, P2 = 400, which is a tenth better there and half as good again in wrong cells beside steps
SGBM = {"blockSize": 7, "P1": 200, "P2": 800}
SGBM_CHECKS = {"uniquenessRatio": 10, "speckleWindowSize": 100, "speckleRange": 2, "disp12MaxDiff": 1}
Mask = NDArray[np.bool_]
ByGroup = dict[str, tuple[float, ...]]  # given out, wrong before any refusal, wrong and given out, percent; more


def _grey(view: View) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY) if view.image.ndim == 3 else view.image)


def groups(points: Points) -> dict[str, Mask]:
    """Groups of points that are judged together: dry, open and rough ground, where descriptors match, each class."""
    even = ~points.feature | points.feature.all()  # a reference has nothing but features
    dry = points.kind != Terrain.WATER
    out = {
        "dry": even & dry, "open": even & points.open, "rough": even & dry & ~points.open,
        "features": points.feature & dry, "... open": points.feature & points.open,
        "... rough": points.feature & dry & ~points.open,
    }  # fmt: skip
    return out | {t.name.lower(): even & (points.kind == t) for t in list(Terrain)[1:]}


def _wrong(error: F64, given: Mask, above: float) -> float:
    return 100 * float((np.abs(error[given]) > WRONG * above).mean()) if given.sum() >= 50 else np.nan


def _at(values: NDArray[np.generic], grid_map: ElevationMap, points: Points) -> tuple[NDArray[np.generic], Mask]:
    r, c = (np.rint(i).astype(int) for i in grid_map.grid.index(points.xyz[:, 0], points.xyz[:, 1]))
    inside = (r >= 0) & (r < grid_map.grid.rows) & (c >= 0) & (c < grid_map.grid.cols)
    return values[r.clip(0, grid_map.grid.rows - 1), c.clip(0, grid_map.grid.cols - 1)], inside


def estimator(subject: Subject, points: Points) -> tuple[dict[str, float], ByGroup, float]:
    """Run all stages with true poses; return the row of the estimator, the failures, and the height in metres."""
    result = replay.replay(subject.source, subject.settings, subject.poses)
    found = result.elevation
    if found is None:
        return {"accepted %": 0.0}, {}, 30.0
    above = float(result.height_above_ground or 1.0)
    seen = (found.flags & np.uint16(Flag.UNSEEN | Flag.FEW)) == 0
    height, inside = _at(found.height.astype(np.float64), found, points)
    accepted, visible, shared = (_at(v, found, points)[0] for v in (found.trusted, seen, 1.0 - found.residual))
    error = height - points.xyz[:, 2]
    usable = inside & visible & np.isfinite(error)
    accepted &= usable
    by_group = {
        name: (
            100 * float(accepted[usable & group].mean()),
            _wrong(error, usable & group, above),
            _wrong(error, accepted & group, above),
            float(np.median(shared[usable & group])),
        )
        for name, group in groups(points).items()
        if (usable & group).sum() >= 50
    }
    return _row(found, seen, error[groups(points)["open"] & accepted], above), by_group, above


def _row(found: ElevationMap, seen: Mask, good: F64, above: float) -> dict[str, float]:
    """Shares and texture of the map, and its errors `good` (metres) on accepted open ground."""
    texture = 1.0 - found.residual[seen]
    e = 100 * good / above if len(good) > 50 else np.array([np.nan])
    row = {
        "height m": above,
        "accepted %": 100 * float(found.trusted[seen].mean()),
        "texture P10": float(np.nanpercentile(texture, 10)),
        "P50": float(np.nanpercentile(texture, 50)),
        "< 0.6 %": 100 * float((texture < 0.6).mean()),
        "open NMAD %": nmad(e),
        "open P95 %": float(np.percentile(np.abs(e - np.median(e)), 95)),
    }
    for flag in (Flag.TEXTURE, Flag.AMBIGUOUS, Flag.MOVING, Flag.UNSURE, Flag.SATURATED, Flag.STEP):
        row[f"{flag.name.lower()} %"] = 100 * float(((found.flags[seen] & np.uint16(flag)) > 0).mean())
    return row


def pairs(views: list[View], above: float, step: float = STEP) -> Iterator[tuple[View, View]]:
    """Some pairs of pictures about `step` of the height apart, spread over the recording."""
    for i in np.unique(np.linspace(0, len(views) - 1, 3 * PAIRS).astype(int)):
        gaps = np.array([np.linalg.norm(v.centre - views[i].centre) for v in views[i + 1 :]])
        if len(gaps) and np.abs(gaps - step * above).min() < 0.3 * step * above:
            yield views[i], views[i + 1 + int(np.argmin(np.abs(gaps - step * above)))]


class Rectified:
    """Two views turned so that rows match; `a` is the left one."""

    def __init__(self, a: View, b: View) -> None:
        base = b.centre - a.centre
        self.baseline = float(np.linalg.norm(base))
        x = base / self.baseline
        z = a.world_from_cam.rotation[:, 2] + b.world_from_cam.rotation[:, 2]
        z = z - (z @ x) * x
        z /= np.linalg.norm(z)
        self.world_from_rect = np.column_stack([x, np.cross(z, x), z])
        self.f = 0.5 * (a.camera.fu + a.camera.fv)
        self.centre = a.centre
        edge = np.concatenate([self._border(v) for v in (a, b)])
        low, high = np.floor(edge.min(0)), np.ceil(edge.max(0))
        self.c = -low
        w, h = (int(v) + 1 for v in high - low)
        self.left, self.right = self._turn(a, w, h), self._turn(b, w, h)

    def _border(self, v: View) -> F64:
        w, h = v.camera.width - 1.0, v.camera.height - 1.0
        rays = v.camera.rays(np.array([[0, 0], [w, 0], [w, h], [0, h], [w / 2, 0], [w / 2, h], [0, h / 2], [w, h / 2]]))
        rays = rays @ (v.world_from_cam.rotation.T @ self.world_from_rect)
        return np.asarray(self.f * rays[:, :2] / rays[:, 2:])

    def _turn(self, v: View, w: int, h: int) -> NDArray[np.uint8]:
        x, y = np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float))
        rays = np.stack([(x - self.c[0]) / self.f, (y - self.c[1]) / self.f, np.ones_like(x)], -1)
        uv = v.camera.project(rays @ (self.world_from_rect.T @ v.world_from_cam.rotation)).astype(np.float32)
        return np.asarray(cv2.remap(_grey(v), uv[..., 0], uv[..., 1], cv2.INTER_LINEAR))

    def project(self, xyz: F64) -> tuple[F64, F64]:
        """Pixels (N, 2) in the left picture, and depths (N,)."""
        p = (xyz - self.centre) @ self.world_from_rect
        return self.f * p[:, :2] / p[:, 2:] + self.c, p[:, 2]


def disparity(pair: Rectified, near: float, far: float, strict: bool, wider: int = 1) -> F32:
    """StereoSGBM over the true range of depths, in pixels; `strict`: with all of its own checks.

    `wider`: factor of the pictures' width, for finer disparities.
    """
    low = wider * int(pair.f * pair.baseline / far) - 4
    count = -(-int(wider * pair.f * pair.baseline / near + 4 - low) // 16) * 16
    matcher = cv2.StereoSGBM_create(low, count, **SGBM, **(SGBM_CHECKS if strict else {"disp12MaxDiff": -1}))
    wide = [cv2.resize(p, None, fx=wider, fy=1, interpolation=cv2.INTER_CUBIC) for p in (pair.left, pair.right)]
    found = np.asarray(matcher.compute(*wide), np.float32) / 16
    return np.asarray(found[:, wider // 2 :: wider] / wider)


def by_pair(a: View, b: View, xyz: F64, wider: int = 1) -> tuple[F64, Mask]:
    """StereoSGBM on two views at points (N, 3): heights (N,), NaN without one, and where it passes its own checks (N,).

    The height is that of the end of the ray to the point; only the disparities of the points' own depths are searched.
    """
    pair = Rectified(a, b)
    uv, z = pair.project(xyz)
    near, far = float(z.min()) - 1.0, float(z.max()) + 1.0
    low = max(pair.f * pair.baseline / far - 4, 0.0)
    loose, strict = (_looked_up(disparity(pair, near, far, s, wider), uv) for s in (False, True))
    known = loose > low
    depth = pair.f * pair.baseline / np.where(known, loose, 1.0)
    ray = (xyz - pair.centre) / z[:, None]
    return np.where(known, pair.centre[2] + ray[:, 2] * depth, np.nan), strict > low


def map_of_pair(a: View, b: View, xyz: F64, cell: float, strict: bool) -> F64:
    """StereoSGBM on two views as a map, at points (N, 3): its pixels are put into cells, the highest stays."""
    pair = Rectified(a, b)
    near, far = (float(v) for v in (pair.project(xyz)[1].min() - 1.0, pair.project(xyz)[1].max() + 1.0))
    found = disparity(pair, near, far, strict)
    row, col = np.nonzero(found > max(pair.f * pair.baseline / far - 4, 0.0))
    ray = np.c_[col - pair.c[0], row - pair.c[1], np.full(len(row), pair.f)] @ pair.world_from_rect.T
    seen = pair.centre + ray * (pair.baseline / found[row, col].astype(np.float64))[:, None]
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    grid = Grid(low[0], high[1], cell, *(int(n) + 1 for n in np.ceil((high - low)[::-1] / cell)))
    height = np.full(grid.shape, -np.inf)
    r, c = (np.rint(i).astype(int) for i in grid.index(seen[:, 0], seen[:, 1]))
    ok = (r >= 0) & (r < grid.rows) & (c >= 0) & (c < grid.cols)
    np.maximum.at(height, (r[ok], c[ok]), seen[ok, 2])
    r, c = (np.rint(i).astype(int) for i in grid.index(xyz[:, 0], xyz[:, 1]))
    out = height[r.clip(0, grid.rows - 1), c.clip(0, grid.cols - 1)]
    return np.where(np.isfinite(out), out, np.nan)


def _looked_up(found: F32, uv: F64) -> F64:
    """Values at the nearest pixels, far below all outside."""
    h, w = found.shape
    col, row = np.rint(uv).astype(int).T
    ok = (col >= 0) & (col < w) & (row >= 0) & (row < h)
    return np.where(ok, found[row.clip(0, h - 1), col.clip(0, w - 1)], -1e9)


def inside(view: View, xyz: F64) -> Mask:
    """Mask (N,) of the points (N, 3) that lie in a picture, `BORDER` pixels away from its end."""
    uv = view.camera.project(view.world_from_cam.inverse.apply(xyz))
    with np.errstate(invalid="ignore"):
        return np.asarray(((uv > BORDER) & (uv < [view.camera.width - BORDER, view.camera.height - BORDER])).all(1))


def _visible(subject: Subject, xyz: F64, view: View) -> Mask:
    """`stands_clear` for a subject; a reference's points always are."""
    if subject.truth is None:
        return np.ones(len(xyz), bool)
    return stands_clear(subject.surface(), subject.truth.grid, xyz, view)


def stands_clear(surface: F32, grid: Grid, xyz: F64, view: View) -> Mask:
    """Mask (N,) of the points (N, 3) that no part of a surface hides from a camera."""
    top, clear = float(np.nanmax(surface)), np.ones(len(xyz), bool)
    way = view.centre - xyz
    for rise in np.arange(0.2, top - float(np.nanmin(surface)), 0.2):
        p = xyz + way * (rise / way[:, 2:])
        r, c = (np.rint(i).astype(int) for i in grid.index(p[:, 0], p[:, 1]))
        clear &= ~(surface[r.clip(0, grid.rows - 1), c.clip(0, grid.cols - 1)] > p[:, 2] + 0.1)
    return clear


def sgbm(subject: Subject, points: Points, views: list[View], above: float) -> ByGroup:
    """StereoSGBM on pairs of the motion."""
    errors, given, which = [], [], []
    for a, b in pairs(views, above):
        both = inside(a, points.xyz) & inside(b, points.xyz)
        both[both] &= _visible(subject, points.xyz[both], a) & _visible(subject, points.xyz[both], b)
        k = np.flatnonzero(both)
        if len(k) < 100:
            continue
        height, sure = by_pair(a, b, points.xyz[k])
        errors.append(np.nan_to_num(height - points.xyz[k, 2], nan=np.inf))  # no height is a wrong one
        given.append(sure)
        which.append(k)
    if not which:
        return {}
    error, ok, index = np.concatenate(errors), np.concatenate(given), np.concatenate(which)
    out = {}
    for name, group in groups(points).items():
        g = group[index]
        if g.sum() >= 50:
            out[name] = (100 * float(ok[g].mean()), _wrong(error, g, above), _wrong(error, g & ok, above))
    return out


def _plane_guess(a: View, b: View, pixels: F32, ground: float) -> F32:
    rays = a.camera.rays(pixels.astype(np.float64)) @ a.world_from_cam.rotation.T
    xyz = a.centre + rays * ((ground - a.centre[2]) / rays[:, 2:])
    return b.camera.project(b.world_from_cam.inverse.apply(xyz)).astype(np.float32)


def survival(views: list[View], above: float, ground: float, step: float) -> float:
    """Percent of corners that Lucas-Kanade finds again after `step` of the height, within 0.5 px there and back."""
    kept, all_ = 0, 0
    for a, b in pairs(views, above, step):
        one, two = _grey(a), _grey(b)
        found = cv2.goodFeaturesToTrack(one, 400, 1e-4, 0.03 * one.shape[1], blockSize=11)
        if found is None:
            continue
        start = found.reshape(-1, 2)
        guess = _plane_guess(a, b, start, ground)
        inside = ((guess > 20) & (guess < [one.shape[1] - 20, one.shape[0] - 20])).all(1)
        start, guess = np.ascontiguousarray(start[inside]), np.ascontiguousarray(guess[inside])
        if not len(start):
            continue
        more = {"winSize": (21, 21), "maxLevel": 3, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        there, ok, _ = cv2.calcOpticalFlowPyrLK(one, two, start, guess.copy(), **more)
        back, ok2, _ = cv2.calcOpticalFlowPyrLK(two, one, there, start.copy(), **more)
        good = (ok[:, 0] > 0) & (ok2[:, 0] > 0) & (np.linalg.norm(back - start, axis=1) < 0.5)
        kept, all_ = kept + int(good.sum()), all_ + len(start)
    return 100 * kept / all_ if all_ else np.nan
