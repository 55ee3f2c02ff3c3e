"""Labels of photos on the map of a run: each cell takes the label at its projection into the photo.

A run's own poses, lens and heights are used (`trajectory.tum`, `run.json`, `dem.tif`), so that a shift of the whole map
on Earth moves map and labels together. A cell that is hidden from the photo by higher ground takes no label of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from label_file import HAZARDS, KINDS, OPEN, ROUGH, UNSURE, Label, Labels

from alight.arrays import F32, F64, I64, Mask
from alight.geometry import Camera, Grid, Pose, world_up
from alight.outputs.reading import Run
from alight.photos.reading.photo_pose import BODY_FROM_CAM
from alight.raster import masked_gaussian, nearest_known
from alight.records import Flag
from alight.sources.tum import read_tum

NEAR = 2.0  # metres, 1-sigma of the narrowest mean that fills gaps between known heights
HIDDEN_BY = 0.3  # metres above the line of sight by which known ground hides a cell


@dataclass(frozen=True, eq=False)
class LabelledMap:
    """Kinds of ground on the cells that a run saw from two photos or more. A cell can be of several kinds."""

    grid: Grid
    kinds: Mapping[str, Mask]  # (R, C) of every kind
    unused: tuple[str, ...]  # photos with labels that the run did not place

    def any_of(self, kinds: tuple[str, ...]) -> Mask:
        """The cells of any of some kinds, (R, C)."""
        return np.asarray(np.any([self.kinds[k] for k in kinds], axis=0))

    @property
    def unsure(self) -> Mask:
        """Cells without a statement: `unsure` wins over every other kind."""
        return self.kinds[UNSURE]

    @property
    def hazard(self) -> Mask:
        """Cells of a hazard: it wins over open ground, also over that of another photo."""
        return self.any_of(HAZARDS) & ~self.unsure

    @property
    def rough(self) -> Mask:
        """Cells where a person would not land although they hold no obstacle."""
        return self.kinds[ROUGH] & ~self.hazard & ~self.unsure

    @property
    def open_ground(self) -> Mask:
        """Cells where a person would land."""
        return self.any_of(OPEN) & ~self.hazard & ~self.rough & ~self.unsure


def photo_camera_of(info: Mapping[str, Any]) -> Camera:
    """The lens of a run over photos after its bundle adjustment, from run.json.

    Raises:
        ValueError: the run is not one over photos with their own calibration and estimated poses.
    """
    notes = info.get("notes", {})
    missing = [k for k in ("focal_px", "principal_point_px", "distortion", "image_size") if k not in notes]
    if missing or info["settings"]["sources"]["calibration"]:
        why = f"run.json lacks {', '.join(missing)}" if missing else "its lens is from a file"
        raise ValueError(f"labels need a run over photos with their own lens and estimated poses: {why}")
    (fu, fv), (cu, cv) = notes["focal_px"], notes["principal_point_px"]
    width, height = notes["image_size"]
    distortion = tuple(notes["distortion"])
    return Camera(width, height, fu, fv, cu, cv, "radial-tangential" if distortion else "none", distortion)


def photo_poses(run: Run) -> dict[int, Pose]:
    """`world_from_cam` of every photo that the run placed, by its time in ns.

    Raises:
        ValueError: the run has no place on Earth.
    """
    if run.local is None:
        raise ValueError(f"{run.folder}: the run has no place on Earth")
    times, bodies = read_tum(run.folder / "trajectory.tum", run.local)
    return {int(t): body @ BODY_FROM_CAM for t, body in zip(times, bodies, strict=True)}


def labelled_map(run: Run, labels: Labels) -> LabelledMap:
    """Project the labels on the map of a run.

    Raises:
        ValueError: the run has no heights, no place on Earth or no lens, or its photos have another size.
    """
    if run.grid is None or run.height is None or run.local is None:
        raise ValueError(f"{run.folder}: the run has no heights")
    camera, poses = photo_camera_of(run.info), photo_poses(run)
    if (camera.width, camera.height) != (labels.width, labels.height):
        raise ValueError(f"{run.folder}: photos of {camera.width} x {camera.height} px, labels of another size")
    up = world_up(run.height, run.grid, run.local)
    kinds = {k: np.zeros(run.grid.shape, bool) for k in KINDS}
    seen_twice = np.ones(run.grid.shape, bool) if run.flags is None else (run.flags & np.uint16(Flag.UNSEEN)) == 0
    unused = []
    for photo in sorted({p.photo for p in labels.polygons}):
        pose = poses.get(labels.times[photo])
        if pose is None:
            unused.append(photo)
            continue
        for kind, cells in _of_photo(PhotoCells(run.grid, up, camera, pose), labels, photo).items():
            kinds[kind] |= cells & seen_twice
    return LabelledMap(run.grid, kinds, tuple(unused))


def _of_photo(seen: PhotoCells, labels: Labels, photo: str) -> dict[str, Mask]:
    """The cells of each kind in one photo; objects on open ground are taken out of it."""
    kinds: dict[str, Mask] = {}
    for label in labels.of_photo(photo):
        under = seen.under(label, labels)
        kinds[label.kind] = kinds[label.kind] | under if label.kind in kinds else under
    for kind in OPEN:
        for other in (*HAZARDS, ROUGH):
            if kind in kinds and other in kinds:
                kinds[kind] = kinds[kind] & ~kinds[other]
    return kinds


class PhotoCells:
    """The cells of a map that one photo shows, and the pixel of each."""

    def __init__(self, grid: Grid, up: F32, camera: Camera, world_from_cam: Pose) -> None:
        """Find the pixel of each cell that the photo shows; `up`: (R, C) metres, NaN = unknown."""
        known = np.isfinite(up)
        self._shape = grid.shape
        east, north = grid.xy()
        points = np.stack([*np.meshgrid(east, north), filled(up, grid)], axis=-1)
        points = points.reshape(-1, 3)
        pixels = np.rint(pixels_within(camera, world_from_cam.inverse.apply(points)))
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
        cells = np.flatnonzero(inside)
        shown = ~hidden(grid, np.where(known, up, -np.inf), points[cells], world_from_cam.translation)
        self._cells: I64 = cells[shown]
        self._pixels = pixels[self._cells].astype(np.int64)

    def under(self, label: Label, labels: Labels) -> Mask:
        """The cells whose pixel the polygon covers, (R, C)."""
        u, v = self._pixels.T
        out = np.zeros(self._shape, bool)
        out.flat[self._cells[labels.mask(label)[v, u]]] = True
        return out


def pixels_within(camera: Camera, points_cam: F64) -> F64:
    """Project (N, 3) points; NaN beyond the corners' angle, where the polynomial of the lens is not valid."""
    corners = np.array([[u, v] for u in (0, camera.width - 1) for v in (0, camera.height - 1)], np.float64)
    widest = np.linalg.norm(camera.rays(corners)[:, :2], axis=1).max()
    off_axis = np.linalg.norm(points_cam[:, :2], axis=1)
    within = off_axis <= widest * points_cam[:, 2]
    return camera.project(np.where(within[:, None], points_cam, np.nan))


def filled(up: F32, grid: Grid) -> F64:
    """Heights (R, C) in metres without gaps: the Gaussian mean of known ones, as narrow as one is near.

    Raises:
        ValueError: no cell is known.
    """
    known = np.isfinite(up)
    if not known.any():
        raise ValueError("the run knows no heights")
    out, sigma = up, NEAR
    while sigma < max(grid.shape) * grid.cell and not np.isfinite(out).all():
        near = masked_gaussian(up, known.astype(np.float32), sigma / grid.cell)
        out, sigma = np.where(np.isnan(out), near, out), 2 * sigma
    return nearest_known(out, np.isfinite(out)).astype(np.float64)


def hidden(grid: Grid, up: F32, points: F64, centre: F64) -> Mask:
    """Return whether known ground stands between points and a camera by more than `HIDDEN_BY`.

    Args:
        grid: of the heights.
        up: (R, C) metres, -inf = unknown.
        points: (N, 3) metres, world.
        centre: (3,) metres, of the camera.
    """
    out = np.zeros(len(points), bool)
    if not np.isfinite(up).any() or not len(points):
        return out
    towards = centre - points
    distance = np.hypot(towards[:, 0], towards[:, 1])
    step = towards / np.maximum(distance, 1e-9)[:, None] * grid.cell
    rise = float(up.max()) - points[:, 2]
    with np.errstate(divide="ignore"):
        steps = np.minimum(rise / np.maximum(step[:, 2], 1e-9), distance / grid.cell)
    for k in range(1, int(steps.max(initial=0)) + 1):
        ask = np.flatnonzero((steps >= k) & ~out)
        at = points[ask] + k * step[ask]
        row, col = (np.rint(i).astype(np.int64) for i in grid.index(at[:, 0], at[:, 1]))
        on = (row >= 0) & (row < grid.rows) & (col >= 0) & (col < grid.cols)
        out[ask[on]] = up[row[on], col[on]] > at[on, 2] + HIDDEN_BY
    return out
