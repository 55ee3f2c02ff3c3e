"""A flight in three dimensions, for Rerun: map, vehicle, cameras, places, route, decisions and time series."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from alight.arrays import F32, F64, U8
from alight.geometry import Grid
from alight.records import MissingExtraError
from alight.report.paint import SAFE_RAMP, colour_ramp
from alight.viewing.flight import Moment, ShownFlight, ShownMap


def rerun_here() -> Any:
    """Return Rerun, or raise MissingExtraError if it is not installed."""
    try:
        import rerun
    except ImportError as e:
        raise MissingExtraError("rerun-sdk", "view") from e
    return rerun


def show(flown: ShownFlight, save: Path | None) -> None:
    """Open a flight in the viewer, or write it to a file that the viewer opens.

    Raises:
        MissingExtraError: Rerun is not installed.
        InputError: the run has nothing to show.
    """
    rr = rerun_here()
    rr.init("alight", recording_id=flown.name, spawn=save is None)
    if save is not None:
        rr.save(save)
    rr.send_blueprint(_layout())
    _log_rest(rr, flown)
    previous = Moment()
    for moment in flown.moments():
        rr.set_time("flight", timestamp=moment.t_ns * 1e-9)
        _log_moment(rr, moment, previous)
        previous = moment
    rr.disconnect()


def _layout() -> Any:
    import rerun.blueprint as rrb

    numbers = [
        rrb.TimeSeriesView(name=name, origin=f"numbers/{name}")
        for name in ("up", "position_sigma", "p_safe", "tracks", "battery")
    ]
    beside = rrb.Vertical(
        rrb.Spatial2DView(name="camera", origin="world/vehicle/camera"),
        rrb.TextLogView(name="decisions", origin="decisions"),
        rrb.Tabs(*numbers),
    )
    whole_path = rrb.VisibleTimeRanges(
        timeline="flight", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    flight = rrb.Spatial3DView(name="flight", origin="world", overrides={"world/path": [whole_path]})
    return rrb.Blueprint(rrb.Horizontal(flight, beside, column_shares=[3, 2]), collapse_panels=True)


def _log_rest(rr: Any, flown: ShownFlight) -> None:
    """Log what does not change: the axes, the map of the whole flight in its own colours, and the cameras."""
    rr.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    grid, height, run = flown.found.heights()
    colours = np.full((*height.shape, 3), 128, np.uint8) if run.ortho is None else run.ortho
    rr.log("world/ground", _mesh(rr, grid, height, colours), static=True)
    for camera in () if flown.rig is None else flown.rig.cameras[:1]:
        lens, at = camera.camera, camera.body_from_cam
        pinhole = rr.Pinhole(
            image_from_camera=lens.K, resolution=(lens.width, lens.height), camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=2.0,
        )  # fmt: skip
        rr.log("world/vehicle/camera", rr.Transform3D(translation=at.translation, mat3x3=at.rotation), static=True)
        rr.log("world/vehicle/camera", pinhole, static=True)


def _log_moment(rr: Any, now: Moment, before: Moment) -> None:
    place = now.pose.translation
    rr.log("world/vehicle", rr.Transform3D(translation=place, mat3x3=now.pose.rotation))
    if before.t_ns:
        rr.log("world/path", rr.LineStrips3D([[before.pose.translation, place]], colors=(255, 221, 87)))
    if np.isfinite(now.covariance).all():
        spread, turn = np.linalg.eigh(now.covariance[:3, :3])
        turn[:, 0] *= np.sign(np.linalg.det(turn))
        half = np.sqrt(np.maximum(spread, 0.0))
        rr.log("world/uncertainty", rr.Transform3D(translation=place, mat3x3=turn))
        rr.log("world/uncertainty", rr.Ellipsoids3D(half_sizes=[half], fill_mode="MajorWireframe"))
    if now.picture is not None:
        rr.log("world/vehicle/camera", rr.Image(now.picture).compress())
    if now.places is not before.places:
        colours = [p.colour for p in now.places]
        sizes = [(p.radius, p.radius, 0.05) for p in now.places]
        centres, labels = [p.position for p in now.places], [p.label for p in now.places]
        rr.log("world/places", rr.Ellipsoids3D(centers=centres, half_sizes=sizes, colors=colours, labels=labels))
    if now.map is not None and now.map is not before.map:
        rr.log("world/judged", _judged(rr, now.map))
    if now.route is not before.route:
        rr.log("world/route", rr.LineStrips3D([now.route]))
    for line in now.lines[len(before.lines) :]:
        rr.log("decisions", rr.TextLog(" ".join(line.split())))
    for name, value in now.numbers.items():
        rr.log(f"numbers/{name}", rr.Scalars(value))


def _judged(rr: Any, shown: ShownMap) -> Any:
    height, safe = shown.layers["elevation"], shown.layers.get("p_safe")
    p = np.full(height.shape, np.nan, np.float32) if safe is None else safe
    colours = colour_ramp(p, 0.0, 1.0, SAFE_RAMP).astype(np.uint8)
    return _mesh(rr, shown.grid, np.where(np.isfinite(p), height + shown.grid.cell / 2, np.nan), colours)


def _mesh(rr: Any, grid: Grid, height: F32 | F64, colours: U8, most: int = 400_000) -> Any:
    """Return the ground as triangles between known cells; of a larger map every second, third, ... cell."""
    step = max(1, int(np.ceil(np.sqrt(height.size / most))))
    east, north = grid.xy()
    up, colours = height[::step, ::step], colours[::step, ::step]
    x, y = np.meshgrid(east[::step], north[::step])
    number = np.arange(up.size).reshape(up.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    known = np.isfinite(up.ravel())[triangles].all(axis=1)
    points = np.stack([x, y, np.nan_to_num(up)], axis=-1).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=points, triangle_indices=triangles[known], vertex_colors=colours.reshape(-1, 3)
    )  # fmt: skip
