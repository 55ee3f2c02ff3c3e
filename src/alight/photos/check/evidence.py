"""Evidence about a set of photos: a sample of pictures, matched pairs of neighbours, and the geometry of the set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from alight.arrays import F64, I64, U8, Mask
from alight.checks.features import LEAST_FEATURES, downscaled, full_size, match_pictures
from alight.checks.picture_quality import Brightness, brightness_of, edge_widths
from alight.geometry import Camera, enu_from_flu
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.photos.reading.photos import Photos, UsedPhoto
from alight.spread import robust_sigma

SAMPLE = 8  # pairs of neighbours, spread over the set, whose pictures are read
MATCHED_PX = 800  # longer side at which neighbours are matched
SHARP_PX = 1200  # side of the middle part whose sharpness is measured


class NeighbourPair(NamedTuple):
    """Two neighbouring photos, and what their pictures show."""

    first: int  # indices of the exposures
    other: int
    matches: int  # features that follow one homography; 0: no match
    overlap: float  # share of the first picture that the other picture shows; NaN without matches
    height: float  # metres above ground, by focal length and baseline; NaN: unknown


@dataclass(frozen=True, eq=False)
class PhotoEvidence:
    """Evidence about one set of photos."""

    exposures: list[UsedPhoto]
    source: Photos
    brightness: list[Brightness]  # of each sampled picture
    edges: F64  # (N, 2) px, widths of the sharpest edges of sampled pictures, see `edge_widths`
    pairs: list[NeighbourPair]
    unread: list[str]  # sampled pictures that cannot be read, with the reason
    poses: F64  # (n, 3, 3) world_from_cam by the tags, else looking down with the top along the flight
    centres: F64  # (n, 3) metres; NaN: unknown

    def lens(self, number: int) -> Camera:
        """Return the lens of an exposure by its index."""
        return self.source.rig.cameras[self.exposures[number].camera].camera

    @property
    def above(self) -> F64:
        """(n,) metres above take-off by the tags; NaN: unknown."""
        return np.array([e.tags.relative_altitude for e in self.exposures], np.float64)

    @property
    def measured(self) -> float:
        """Median height above ground by the matched pairs, metres; NaN: too few pairs, or they disagree."""
        heights = np.array([p.height for p in self.pairs if np.isfinite(p.height)])
        if len(heights) < 3:
            return np.nan
        middle = float(np.median(heights))
        return middle if robust_sigma(heights - middle) < 0.1 * middle * np.sqrt(len(heights)) else np.nan

    @property
    def height(self) -> float:
        """Median camera height above take-off by the tags, else above ground by matched pairs, metres; NaN: unknown."""
        above = self.above
        return float(np.nanmedian(above)) if np.isfinite(above).any() else self.measured

    @property
    def down(self) -> F64:
        """(n,) cosine of the angle between optical axis and straight down, by the tags; NaN: unknown."""
        tagged = np.array([e.nav.world_from_body is not None for e in self.exposures])
        return np.where(tagged, -self.poses[:, 2, 2], np.nan)


def gather_photos(source: Photos, progress: Callable[[float], None]) -> PhotoEvidence:
    """Read a sample of the pictures, and match each with a neighbour; `progress` receives the completed share."""
    exposures = source.exposures
    places = (e.nav.position_world for e in exposures)
    centres = np.array([np.full(3, np.nan) if place is None else place for place in places])
    found = PhotoEvidence(exposures, source, [], np.empty((0, 2)), [], [], _poses(exposures, centres), centres)
    chosen = np.unique(np.linspace(0, len(exposures) - 1, SAMPLE).astype(int))
    widths, sampled = list[F64](), dict[int, U8 | None]()

    def picture(number: int) -> U8 | None:
        if number in sampled:
            return sampled[number]
        sampled[number] = None
        try:
            pixels = source.read(exposures[number].tags)
        except ValueError as e:
            found.unread.append(f"{exposures[number].tags.path.name}: {e}")
            return None
        found.brightness.append(brightness_of(pixels))
        top, left = (max(0, (n - SHARP_PX) // 2) for n in pixels.shape[:2])
        widths.append(edge_widths(np.ascontiguousarray(pixels[top : top + SHARP_PX, left : left + SHARP_PX])))
        sampled[number] = downscaled(pixels, MATCHED_PX)[0]
        return sampled[number]

    for k, first in enumerate(chosen):
        other, a = _neighbour(int(first), centres), picture(int(first))
        b = None if other is None else picture(other)
        if other is not None and a is not None and b is not None:
            found.pairs.append(_matched(found, (int(first), other), (a, b)))
        progress((k + 1) / len(chosen))
    return replace(found, edges=np.array(widths).reshape(-1, 2))


def _neighbour(number: int, centres: F64) -> int | None:
    """Return the index of the photo to match with photo `number`: the next one, or the one before the last photo.

    A photo less than half as far away is preferred. `centres` (n, 3) are in metres, NaN: unknown. None: no other photo.
    """
    if len(centres) < 2:
        return None
    next_one = number + 1 if number + 1 < len(centres) else number - 1
    away = np.nan_to_num(np.linalg.norm(centres - centres[number], axis=1), nan=np.inf)
    away[number] = np.inf
    nearest = int(away.argmin())
    return nearest if away[nearest] < 0.5 * away[next_one] < np.inf else next_one


def _poses(exposures: list[UsedPhoto], centres: F64) -> F64:
    """Return (n, 3, 3) world_from_cam by the tags; without tags, looking down with the top along the flight."""
    out = np.empty((len(exposures), 3, 3))
    known = np.nan_to_num(centres)
    for k, exposure in enumerate(exposures):
        body = exposure.nav.world_from_body
        if body is None:
            east, north, _ = known[min(k + 1, len(known) - 1)] - known[max(k - 1, 0)]
            body = enu_from_flu(float(np.arctan2(east, north)), -np.pi / 2, 0.0)
        out[k] = body @ BODY_FROM_CAM.rotation
    return out


def _matched(found: PhotoEvidence, numbers: tuple[int, int], small: tuple[U8, U8]) -> NeighbourPair:
    lens, its = lenses = [found.lens(k) for k in numbers]
    factors = [-(-max(c.width, c.height) // MATCHED_PX) for c in lenses]
    a, b = (full_size(p, k) for p, k in zip(match_pictures(*small), factors, strict=True))
    nothing = NeighbourPair(*numbers, 0, np.nan, np.nan)
    if len(a) < LEAST_FEATURES:
        return nothing
    H, inside = cv2.findHomography(a, b, cv2.RANSAC, 4.0 * factors[1])  # relief shifts features by pixels
    if H is None or inside.sum() < LEAST_FEATURES:
        return nothing
    corners, frame = (np.array([[0, 0], [c.width, 0], [c.width, c.height], [0, c.height]], np.float32) for c in lenses)
    back = cv2.perspectiveTransform(frame[None], np.linalg.inv(H)).astype(np.float32)
    shared = cv2.intersectConvexConvex(corners, back[0])[0] if cv2.isContourConvex(back[0]) else np.nan
    ray = its.rays(cv2.perspectiveTransform(np.array([[[lens.cu, lens.cv]]]), H)[0])[0]
    return NeighbourPair(*numbers, int(inside.sum()), shared / (lens.width * lens.height), _height(found, numbers, ray))


def _height(found: PhotoEvidence, numbers: tuple[int, int], ray: F64) -> float:
    """Return the height above ground in metres by parallax, for cameras that look down; NaN: unknown.

    Args:
        found: evidence with poses and centres.
        numbers: indices of two exposures.
        ray: (3,) ray in the second camera to the ground on the first camera's optical axis.
    """
    i, j = numbers
    down = np.nan_to_num(found.down[[i, j]], nan=1.0)
    way = (found.centres[i] - found.centres[j]) * [1.0, 1.0, 0.0]  # without altitudes, which are wrong too often
    if not (down > np.cos(np.radians(15.0))).all() or not np.linalg.norm(way) > 1.0:
        return np.nan
    axis, base = found.poses[j].T @ (found.poses[i][:, 2] / down[0]), found.poses[j].T @ way
    turned, moved = (np.linalg.norm(v[:2] - ray[:2] / ray[2] * v[2]) for v in (axis, base))
    return float(moved / turned) if turned > 0 else np.nan  # a heading error common to both has no effect


class Coverage(NamedTuple):
    """Overlap of photos on level ground."""

    along: F64  # share of each picture that the next picture shows, for photos before the last
    views: I64  # number of photos that show the ground in the middle of each picture


def coverage(found: PhotoEvidence, height: float) -> Coverage:
    """Compute the overlap by positions, attitudes and fields of view, over ground `height` metres below each photo."""
    known = np.flatnonzero(np.isfinite(found.centres).all(axis=1) & (-found.poses[:, 2, 2] > 0.3)).tolist()
    chosen = known[:: max(1, len(known) // 400)]
    views, along = list[int](), list[float]()
    for k in chosen:
        lens = found.lens(k)
        grid = np.stack(np.meshgrid((np.arange(9) + 0.5) / 9 * lens.width, (np.arange(9) + 0.5) / 9 * lens.height), -1)
        rays = lens.rays(grid.reshape(-1, 2)) @ found.poses[k].T
        ground = found.centres[k] - rays * (height / rays[:, 2:])
        ground = ground[rays[:, 2] < -0.1]
        middle = found.centres[k] - found.poses[k][:, 2] * (height / found.poses[k][2, 2])
        near = (j for j in known if np.abs(found.centres[k, :2] - found.centres[j, :2]).max() < 4.0 * height)
        views.append(sum(bool(_shows(found, j, middle[None])[0]) for j in near))
        later = next((j for j in known if j > k), None)
        if later is not None and len(ground):
            along.append(float(_shows(found, later, ground).mean()))
    return Coverage(np.array(along), np.array(views, dtype=np.int64))


def _shows(found: PhotoEvidence, number: int, ground: F64) -> Mask:
    lens = found.lens(number)
    seen = (ground - found.centres[number]) @ found.poses[number]
    pixels = lens.project(np.where(seen[:, 2:] > 0, seen, np.nan))
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels >= 0) & (pixels < (lens.width, lens.height))).all(axis=1))
