"""Model of lens and sensor: blur, falloff, exposure control, noise, tone; each has its own random stream."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from alight.arrays import F32, F64, U8
from alight.geometry import Camera
from alight_sim.kernels.exposure import LEVELS, develop
from alight_sim.section import Section
from alight_sim.vehicle import correlated

HOT = 0.9  # share of full scale that a hot pixel adds
CONTROL_RANGE = math.log(16.0)  # exposure control changes the gain by at most this factor (logarithm) up or down
Seeds = np.random.SeedSequence


class GainStep(Section):
    """A sudden step of the gain."""

    at: float = Field(description="s after the first frame")
    factor: float = Field(gt=0, description="of the gain, from then on")


class Imaging(Section):
    """Image formation from the lens to the file."""

    rate_hz: float = Field(8.0, gt=0, le=1000, description="exposures a second")
    samples: int = Field(1, ge=1, le=16, description="rays a pixel")
    exposure_time: float = Field(0.0, ge=0, description="s that the shutter is open: motion blur")
    line_time: float = Field(0.0, ge=0, description="s from one row to the next: rolling shutter")
    moments: int = Field(5, ge=1, le=64, description="instants that the motion blur is summed of")
    gain: float = Field(1.25, gt=0, description="linear light times this is full scale at 1")
    auto: bool = Field(False, description="exposure control that follows the mean brightness")
    auto_target: float = Field(0.25, gt=0, lt=1, description="mean signal that it wants, of full scale")
    auto_lag: float = Field(0.6, gt=0, description="s, time constant of the exposure control")
    gain_drift: float = Field(0.05, ge=0, description="standard deviation of the gain's logarithm, each camera its own")
    gain_drift_time: float = Field(5.0, gt=0, description="s, its correlation time")
    gain_steps: tuple[GainStep, ...] = Field((), description="jumps of the gain")
    white_balance: float = Field(0.004, ge=0, description="standard deviation of red's and blue's logarithm, drifting")
    blur_px: float = Field(0.45, ge=0, description="pixels, standard deviation of lens and pixel together")
    vignetting: float = Field(0.12, ge=0, lt=1, description="share of light lost in the farthest corner")
    full_well: float = Field(30000.0, gt=0, description="electrons that are full scale at gain 1: less is noisier")
    read_noise: float = Field(10.0, ge=0, description="electrons")
    noise: float = Field(1.0, ge=0, description="factor on all noise of the sensor; 0 is none")
    gamma: float = Field(2.2, gt=0.5, le=4, description="of the file's grey values")
    hot_pixels: float = Field(0.0, ge=0, le=0.1, description="share of pixels that are bright whatever they see")
    dust: int = Field(0, ge=0, le=1000, description="specks on the sensor, soft and dark")


@dataclass(frozen=True, eq=False)
class Sensor:
    """Lens and sensor of one camera with their flaws, made once and used for every exposure."""

    imaging: Imaging
    falloff: F32  # (H, W) share of the light that reaches the sensor
    hot: F32  # (N, 3) row, column, channel of hot pixels
    tone: U8  # (LEVELS,) grey value by the square root of the signal

    @classmethod
    def of(cls, camera: Camera, imaging: Imaging, seeds: Seeds) -> Sensor:
        """Build the sensor of a camera, with dust and hot pixels drawn from `seeds`."""
        dust, hot = (np.random.default_rng(s) for s in seeds.spawn(2))
        size = (camera.height, camera.width, 3)
        count = round(imaging.hot_pixels * camera.height * camera.width)
        roots = np.linspace(0.0, 1.0, LEVELS)
        tone = np.round(255.0 * roots ** (2.0 / imaging.gamma)).astype(np.uint8)
        return cls(imaging, _falloff(camera, imaging, dust), hot.integers(0, size, (count, 3)).astype(np.float32), tone)

    def expose(self, radiance: F32, gain: F64, key: int, covered: float = 0.0) -> U8:
        """Return the picture (H, W, 3), RGB, from linear light `radiance` (H, W, 3).

        `gain`: (3,) red, green, blue. `key`: seed of the noise. `covered`: share of the light that a cover keeps out.
        """
        s, light = self.imaging, radiance
        if s.blur_px > 0:
            light = cv2.GaussianBlur(radiance, (0, 0), s.blur_px)
        if len(self.hot):
            light = light.copy() if light is radiance else light
            light[tuple(self.hot.astype(np.intp).T)] += np.float32(HOT / float(gain.mean()))
        amplified = float(gain.mean()) / s.full_well  # full scale per electron
        shot, read = s.noise**2 * amplified, (s.noise * s.read_noise * amplified) ** 2
        out = np.empty(light.shape, np.uint8)
        falloff = self.falloff if covered <= 0 else self.falloff * np.float32(1.0 - covered)
        develop(light, falloff, gain, shot, read, self.tone, np.uint64(key), out)
        return out


def _falloff(camera: Camera, imaging: Imaging, rng: np.random.Generator) -> F32:
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    r2 = (u - camera.cu) ** 2 + (v - camera.cv) ** 2
    falloff = 1.0 - imaging.vignetting * (r2 / r2.max())
    for _ in range(imaging.dust):
        x, y, size, depth = rng.uniform((0, 0, 1.5, 0.05), (camera.width, camera.height, 6.0, 0.35))
        falloff *= 1.0 - depth * np.exp(-0.5 * ((u - x) ** 2 + (v - y) ** 2) / size**2)
    return np.ascontiguousarray(falloff, dtype=np.float32)


def gains(imaging: Imaging, seconds: F64, seeds: Seeds, metered: F64 | None = None) -> F64:
    """Return the (N, 3) gains of one camera for red, green and blue, at ascending times (s).

    Args:
        metered: (N,) mean linear light of each exposure, the input of exposure control; None: it is off.
    """
    drift, white = (np.random.default_rng(s) for s in seeds.spawn(2))
    log = np.full((len(seconds), 3), math.log(imaging.gain))
    log += imaging.gain_drift * irregular_gauss_markov(drift, seconds, 1, imaging.gain_drift_time)
    log[:, ::2] += imaging.white_balance * irregular_gauss_markov(white, seconds, 2, 4.0 * imaging.gain_drift_time)
    for step in imaging.gain_steps:
        log[seconds >= step.at] += math.log(step.factor)
    if imaging.auto and metered is not None:
        log += _control(imaging, seconds, metered)[:, None]
    return np.asarray(np.exp(log))


def _control(imaging: Imaging, seconds: F64, metered: F64) -> F64:
    out, before = np.empty(len(metered)), None
    for i, light in enumerate(metered):
        step = controlled(imaging, before, float(light), seconds[i] - seconds[max(i - 1, 0)])
        out[i], before = step.log, step
    return out


@dataclass(frozen=True)
class ControlStep:
    """State of exposure control at one exposure."""

    free: float  # logarithm of the factor on the gain, before it is limited to 1/16 and 16
    wanted: float  # logarithm of the factor that would have brought the mean to its target

    @property
    def log(self) -> float:
        """Logarithm of the limited factor on the gain."""
        return min(max(self.free, -CONTROL_RANGE), CONTROL_RANGE)


def controlled(imaging: Imaging, before: ControlStep | None, metered: float, seconds: float) -> ControlStep:
    """Advance exposure control, which follows the target mean with a first-order lag.

    Args:
        before: state at the previous exposure, from which the gain follows; None: the control has settled.
        metered: mean linear light now.
        seconds: time since the previous exposure.
    """
    wanted = math.log(imaging.auto_target / max(metered * imaging.gain, 1e-6))
    if before is None:
        return ControlStep(wanted, wanted)
    keep = math.exp(-seconds / imaging.auto_lag)
    return ControlStep(keep * before.free + (1.0 - keep) * before.wanted, wanted)


def irregular_gauss_markov(rng: np.random.Generator, seconds: F64, width: int, tau: float) -> F64:
    """Return (N, width) Gauss-Markov noise of unit deviation at ascending times (N,), s; each column is independent.

    `tau`: correlation time, s. The noise is drawn every tau / 20, whatever the times, and interpolated. So a lost
    exposure changes no other noise.
    """
    step = tau / 20.0
    first = math.floor(float(seconds.min(initial=0.0)) / step)
    last = math.ceil(float(seconds.max(initial=0.0)) / step) + 1
    grid = step * np.arange(min(first, 0), last + 1)
    values = correlated(rng, len(grid), width, 1.0 / 20.0)
    return np.column_stack([np.interp(seconds, grid, values[:, k]) for k in range(width)])
