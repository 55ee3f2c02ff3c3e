"""Clock offset between a film and its telemetry, from the path of the pictures over the ground and the GPS track.

A camera that looks down sees the ground move with its own velocity, rotated by its heading and divided by the height
above ground. The heading is integrated from the pictures' rotation. With plane vectors as complex numbers, the velocity
u in the pictures follows from the velocity v of the telemetry up to two unknown factors, c (complex) and k (real):

    u(t) = c v(t + offset) + k g(t)

Here g is the motion that turning causes at the picture's centre if the camera is slightly tilted. Every stop, turn and
change of speed shows the offset, so neither focal length nor attitude is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from alight.arrays import F64, U8
from alight.checks.clock_offset import LOBE, STEP, ClockOffset, clearest
from alight.checks.features import downscaled, picture_flow
from alight.geometry import Camera
from alight.photos.reading.film_frames import FilmFrames
from alight.photos.reading.film_telemetry import FilmTelemetry

Complex = NDArray[np.complex128]  # first axis + 1j times the axis to its left

BETWEEN = 0.2  # s, least time between two compared pictures
LONGEST = 120.0  # s, longest part of a film that is compared
PARTLY = 30.0  # s; if both last longer, an overlap of two thirds suffices, else the longer contains the shorter
TILT = 0.3  # rad, 1-sigma tilt of a camera that looks down; with less, a turn at constant speed looks like an offset
MODEL = 0.15  # share of the motion that tilt, relief and GPS may leave unexplained at the true offset


@dataclass(frozen=True, eq=False)
class PicturePath:
    """Path of the pictures over the ground."""

    seconds: F64  # (N,) s, on the film's clock
    path: Complex  # (N,) path of the camera as a shift in the picture, in units of an assumed focal length
    heading: Complex  # (N,) heading relative to the first picture, unit complex numbers


def picture_path(film: Path) -> PicturePath:
    """Compute the path of the pictures over the ground, from the first `LONGEST` seconds of a film."""
    seconds, path, headings, move, last = list[float](), [0j], [1.0 + 0j], 0j, None
    with FilmFrames(film) as frames:
        for t in frames:
            if t > LONGEST:
                break
            if (seconds and t - seconds[-1] < BETWEEN) or (frame := frames.image()) is None:
                continue
            small, factor = downscaled(frame, 640)
            if last is not None:
                seen = _motion(last, small, factor)
                move, half = seen or (move, 1.0 + 0j)  # no match: repeat the last motion
                path.append(path[-1] + headings[-1] * half * move)
                headings.append(headings[-1] * half * half)
            seconds.append(t)
            last = small
    return PicturePath(np.array(seconds or [0.0]), np.array(path), np.array(headings))


def _motion(then: U8, now: U8, factor: int) -> tuple[complex, complex] | None:
    """Return the camera's motion between two pictures (right + 1j forward), and half its rotation (unit complex).

    `then` and `now` are grey pictures, downscaled by `factor`. The motion is in units of an assumed focal length. None:
    too few features agree.
    """
    height, width = (float(n * factor) for n in now.shape)
    lens = Camera(round(width), round(height), width, width, width / 2, height / 2)
    if (flow := picture_flow(then, now, factor, lens, (0, 1))) is None:
        return None
    H = flow.homography
    half = 0.5 * math.atan2(H[1, 0] - H[0, 1], H[0, 0] + H[1, 1])
    return complex(-H[0, 2], H[1, 2]), complex(math.cos(half), math.sin(half))


def film_offset(pictures: PicturePath, telemetry: FilmTelemetry) -> ClockOffset:
    """Find the offset in s that converts the film's time to the telemetry's time, and the reason if it is unclear."""
    t0, u = _velocity(pictures.seconds, pictures.path)
    _, g = _velocity(pictures.seconds, 1j * pictures.heading)
    s0, v = _velocity(np.array(telemetry.seconds), telemetry.path())
    if len(u) < 2 or len(v) < 2 or not np.abs(u).any() or not np.abs(v).any():
        return ClockOffset(0.0, math.inf, "they are too short, or show no motion")
    always = np.ones(len(v))
    vu, vg, gu = _sums(v, u), _sums(v, g), _sums(always, u * np.conj(g))
    vv, uu, gg = _sums(_energy(v), np.ones(len(u))).real, *(_sums(always, _energy(x)).real for x in (u, g))
    vv, uu = np.maximum(vv, 1e-9 * vv.max()), np.maximum(uu, 1e-9 * uu.max())
    left, turning = uu - abs(vu) ** 2 / vv, (gu - vg.conj() * vu / vv).real  # left after the part that c explains
    left -= turning**2 / (gg - abs(vg) ** 2 / vv + uu * (MODEL / TILT) ** 2)
    left = np.sqrt((left / uu).clip(0.0) + MODEL**2)
    first = np.arange(1 - len(u), len(v))
    common = np.minimum(first + len(u), len(v)) - np.maximum(first, 0)
    short = min(len(u), len(v))
    tried = common >= (short if short * STEP < PARTLY else 2 * short / 3)
    if short * STEP < LOBE or tried.sum() * STEP < 4.0 * LOBE:
        return ClockOffset(0.0, math.inf, "they are too short")
    return clearest(np.asarray(s0 - t0 + STEP * first[tried]), np.asarray(left[tried], np.float64))


def _energy(z: Complex) -> F64:
    return np.asarray((z * z.conj()).real)


def _sums(a: Complex | F64, b: Complex | F64) -> Complex:
    """Return the cross-correlation (N + M - 1,) of a and b, sum_j a[j + k] conj(b[j]) for k = 1 - M, ..., N - 1."""
    return np.asarray(fftconvolve(a, np.conj(b[::-1])))


def _velocity(seconds: F64, path: Complex) -> tuple[float, Complex]:
    """Return the first time (s) and the velocity at steps of `STEP` s along a path; empty if the path is too short.

    It is averaged over `LOBE`, because GPS repeats and rounds its positions.
    """
    t = np.arange(seconds[0] + LOBE / 2, seconds[-1] - LOBE / 2 + 1e-9, STEP)
    after, before = (np.interp(t + d, seconds, path) for d in (LOBE / 2, -LOBE / 2))
    return float(t[0]) if len(t) else 0.0, np.asarray((after - before) / LOBE)
