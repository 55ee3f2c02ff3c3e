"""A film of a flight: the ground from above with what is known of it, the camera, and the decisions."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from alight.arrays import F64, U8
from alight.geometry import Grid
from alight.outputs.atomic_write import write_whole
from alight.records import InputError
from alight.report.paint import SAFE_RAMP, colour_ramp, rgb
from alight.viewing.flight import Moment, ShownFlight, ShownPlace

WHITE, GREY, DARK, PATH = rgb("#ffffff"), rgb("#a0a6ae"), rgb("#10151b"), rgb("#ffdd57")
PICTURES = {".gif": "GIF", ".webp": "WEBP"}


def write_film(flown: ShownFlight, path: Path, rate: float | None = None, speed: float | None = None) -> int:
    """Draw a flight and write it as MP4, GIF or WebP; return the number of frames.

    Args:
        path: file to write; its ending decides the form.
        rate: frames a second; None: 10, or 5 of the pictures for pages, WebP and GIF.
        speed: 2 is twice as fast as it was; None: 1, or 4 of those.

    Raises:
        InputError: the file has another ending, the flight has nothing to show, or this build cannot write MP4.
    """
    refuse_ending(path)
    small = path.suffix in PICTURES
    rate, speed = rate or (5.0 if small else 10.0), speed or (4.0 if small else 1.0)
    drawing = Drawing(flown)
    frames = drawing.frames(speed / rate)
    if small:
        from PIL import Image

        images = [Image.fromarray(frame) for frame in frames]
        out = BytesIO()
        images[0].save(
            out, PICTURES[path.suffix], save_all=True, append_images=images[1:], duration=round(1000 / rate), loop=0,
            quality=40, method=4,
        )  # fmt: skip
        write_whole(path, out.getvalue())
        return len(images)
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (2 * drawing.side, drawing.side))
    if not writer.isOpened():
        raise InputError(f"{path}: cannot be written as MP4 here; name a .webp or .gif file")
    count = 0
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        count += 1
    writer.release()
    return count


def refuse_ending(path: Path) -> None:
    """Raise InputError for a file whose ending is none of a film."""
    if path.suffix not in {".mp4", *PICTURES}:
        raise InputError(f"{path}: a film is an .mp4, .webp or .gif file")


class Drawing:
    """Draws what a flight knew, moment by moment: the map, and as wide beside it the camera and the decisions.

    Args:
        flown: the flight.
        side: pixels, of the square map.
    """

    def __init__(self, flown: ShownFlight, side: int = 480) -> None:
        self.side = side
        self._flown, self._rig, self._ortho = flown, flown.rig, flown.found.run.ortho
        self._grid, height, _ = flown.found.heights()
        self._ground = float(np.nanmedian(height))  # metres up
        self._track: list[F64] = []

    def frames(self, step: float) -> Iterator[U8]:
        """Yield a frame, (H, W, 3) RGB, every `step` seconds of the flight, and one of its end."""
        start_ns, shown, last = None, -1, None
        for now in self._flown.moments():
            start_ns = now.t_ns if start_ns is None else start_ns
            self._track.append(now.pose.translation)
            t = (now.t_ns - start_ns) * 1e-9
            last = (now, t)
            if t >= (shown + 1) * step:
                shown, last = int(t / step), None
                yield self._frame(now, t)
        if last is not None:
            yield self._frame(*last)

    def _frame(self, now: Moment, t: float) -> U8:
        side = np.vstack([self._camera(now), self._words(now, t)])
        return np.hstack([self._from_above(now), side[: self.side]])

    def _view(self, now: Moment) -> tuple[F64, float]:
        """Return the middle of the map, (2,) metres, and the pixels a metre: it comes nearer as the vehicle sinks."""
        grid, above = self._grid, max(float(now.pose.translation[2]) - self._ground, 0.0)
        reach = float(np.clip(1.2 * above, 8.0, 0.5 * grid.cell * max(grid.shape)))
        near = now.places[0].position[:2] if now.places else now.pose.translation[:2]
        far = np.array([grid.east + grid.cell * grid.cols / 2, grid.north - grid.cell * grid.rows / 2])
        share = min(above / 30.0, 1.0)
        return share * far + (1 - share) * near, self.side / (2 * reach)

    def _from_above(self, now: Moment) -> U8:
        """Return the ground with P(safe) where it was judged, the places, the path and the view of the camera."""
        middle, scale = self._view(now)
        out = np.full((self.side, self.side, 3), DARK, np.uint8)
        if self._ortho is not None:
            out = self._warp(self._ortho, self._grid, middle, scale)
            out[~out.any(axis=2)] = DARK
        if now.map is not None and "p_safe" in now.map.layers:
            safe, grid = now.map.layers["p_safe"], now.map.grid
            colours = self._warp(colour_ramp(safe, 0.0, 1.0, SAFE_RAMP).astype(np.uint8), grid, middle, scale)
            share = 0.5 * self._warp(np.isfinite(safe).astype(np.float32), grid, middle, scale, 0.0)[..., None]
            out = (out * (1 - share) + colours * share).astype(np.uint8)

        def pixel(points: Any) -> NDArray[np.int32]:
            p = np.asarray(points, dtype=float)[..., :2]
            return np.rint((p - middle) * [scale, -scale] + self.side / 2).astype(np.int32)

        cv2.polylines(out, [pixel(self._track)], False, PATH, 2, cv2.LINE_AA)
        if (corners := self._footprint(now)) is not None:
            cv2.polylines(out, [pixel(corners)], True, WHITE, 1, cv2.LINE_AA)
        for place in reversed(now.places):
            _mark(out, place, pixel(place.position), scale)
        for thickness, colour in ((-1, PATH), (1, DARK)):
            cv2.circle(out, pixel(now.pose.translation).tolist(), 6, colour, thickness, cv2.LINE_AA)
        return out

    def _footprint(self, now: Moment) -> F64 | None:
        """Return the corners of the picture on the ground, (4, 2) metres; None: unknown, or not all on the ground."""
        if self._rig is None:
            return None
        camera, at = self._rig.cameras[0].camera, now.pose @ self._rig.cameras[0].body_from_cam
        corners = [(0, 0), (camera.width, 0), (camera.width, camera.height), (0, camera.height)]
        rays, down = camera.rays(corners) @ at.rotation.T, self._ground - at.translation[2]
        if down > 0 or (rays[:, 2] > -0.05).any():
            return None
        return np.asarray((at.translation + rays * (down / rays[:, 2:]))[:, :2])

    def _camera(self, now: Moment) -> U8:
        """Return the camera's picture with the places in it; nothing of a run without pictures."""
        if now.picture is None:
            return np.empty((0, self.side, 3), np.uint8)
        picture = now.picture if now.picture.ndim == 3 else cv2.cvtColor(now.picture, cv2.COLOR_GRAY2RGB)
        factor = self.side / picture.shape[1]
        out = cv2.resize(picture, (self.side, round(picture.shape[0] * factor)), interpolation=cv2.INTER_CUBIC)
        if self._rig is None:
            return np.asarray(out, np.uint8)
        camera, at = self._rig.cameras[0].camera, now.pose @ self._rig.cameras[0].body_from_cam
        circle = np.linspace(0, 2 * np.pi, 33)
        for place in reversed(now.places):
            ring = place.position + place.radius * np.stack([np.cos(circle), np.sin(circle), 0 * circle], axis=1)
            pixels = camera.project(at.inverse.apply(ring)) * factor
            if (np.abs(pixels) < 10 * self.side).all():
                cv2.polylines(out, [np.rint(pixels).astype(np.int32)], True, place.colour, 2, cv2.LINE_AA)
        return np.asarray(out, np.uint8)

    def _warp(self, values: Any, grid: Grid, middle: F64, scale: float, outside: Any = DARK) -> Any:
        """Return values on a grid as they lie on the map."""
        k = grid.cell * scale
        x, y = (grid.east - middle[0]) * scale + self.side / 2, (middle[1] - grid.north) * scale + self.side / 2
        return cv2.warpAffine(
            values, np.array([[k, 0, x], [0, k, y]]), (self.side, self.side), flags=cv2.INTER_AREA, borderValue=outside
        )

    def _words(self, now: Moment, t: float) -> U8:
        """Return the time, the best place and the newest decisions as text."""
        out = np.full((self.side, self.side, 3), DARK, np.uint8)
        lines = [(f"{t:.1f} s   {now.places[0].label if now.places else 'no place yet'}", WHITE, 0.5)]
        for line in reversed(now.lines):
            lines += [(part, GREY, 0.4) for part in textwrap.wrap(" ".join(line.split()), 56)]
        for k, (text, colour, size) in enumerate(lines):
            cv2.putText(out, text, (12, 26 + 18 * k), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
        return out


def _mark(picture: U8, place: ShownPlace, at: NDArray[np.int32], scale: float) -> None:
    radius = max(4, round(place.radius * scale))
    for thickness, colour in ((4, DARK), (2, place.colour)):
        cv2.circle(picture, at.tolist(), radius, colour, thickness, cv2.LINE_AA)
