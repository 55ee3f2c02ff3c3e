"""Sun, sky, haze, clouds and wind of a scene as functions of time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.special import ndtri

from alight.arrays import F64
from alight_sim.section import Section

SUN_STEP = math.radians(0.1)  # rad, turn of the sun after which shadows are computed again


@dataclass(frozen=True)
class Sun:
    """Direction of the sun in radians, and linear colours of sun and sky on a white flat surface."""

    azimuth: float = math.radians(140.0)  # clockwise from north
    elevation: float = math.radians(43.0)
    colour: tuple[float, float, float] = (1.05, 1.0, 0.9)
    sky: tuple[float, float, float] = (0.13, 0.16, 0.22)

    @property
    def direction(self) -> F64:
        """(3,) unit vector towards the sun, world."""
        c = math.cos(self.elevation)
        return np.array([math.sin(self.azimuth) * c, math.cos(self.azimuth) * c, math.sin(self.elevation)])

    @property
    def numbers(self) -> F64:
        """(9,) direction towards the sun, colour of the sun, colour of the sky: input of the kernels."""
        return np.array([*self.direction, *self.colour, *self.sky])


class Clouds(Section):
    """Clouds, whose shadows drift over the ground."""

    share: float = Field(0.0, ge=0, le=1, description="of the ground that lies in their shadow")
    size: float = Field(120.0, gt=1, description="metres, of the larger ones")
    dark: float = Field(0.75, ge=0, le=1, description="share of the sun that they take")
    speed: float = Field(8.0, ge=0, description="m/s, with the wind's direction")


class Wind(Section):
    """Wind at the ground: it moves leaves, grass and waves (the vehicle's own wind is in the flight section)."""

    speed: float = Field(2.5, ge=0, le=40, description="m/s")
    from_deg: float = Field(260.0, description="where it comes from, clockwise from north")

    @property
    def towards(self) -> tuple[float, float]:
        """Unit vector (east, north) along which the wind blows."""
        a = math.radians(self.from_deg)
        return -math.sin(a), -math.cos(a)


class Light(Section):
    """Sun, sky, haze, clouds and wind of a scene."""

    azimuth_deg: float = Field(140.0, description="of the sun, clockwise from north")
    elevation_deg: float = Field(43.0, gt=3, le=90, description="of the sun above the horizon")
    turn_deg_per_s: float = Field(0.0, description="how fast the sun turns: moving shadows (nature: 0.004)")
    sun: float = Field(1.0, ge=0, le=3, description="strength of the direct sun")
    sky: float = Field(0.55, gt=0, le=5, description="strength of the sky: 0.5 clear and dark shadows, 2 hazy and soft")
    visibility: float = Field(20000.0, ge=30, description="metres at which haze leaves 2 % of the contrast")
    clouds: Clouds = Clouds()
    wind: Wind = Wind()

    def sun_step(self, time: float) -> int:
        """Return the index of the sun's step at a time (s); within one step all shadows are static."""
        return round(math.radians(self.turn_deg_per_s) * time / SUN_STEP)

    def sun_at(self, time: float) -> Sun:
        """Return the sun at a time (s), with its direction in steps of 0.1 degrees."""
        azimuth = math.radians(self.azimuth_deg) + self.sun_step(time) * SUN_STEP
        elevation = math.radians(self.elevation_deg)
        path = 1.0 / (math.sin(elevation) + 0.15 * (self.elevation_deg + 3.885) ** -1.253)  # Kasten, 1965
        direct = [1.9 * self.sun * math.exp(-k * path) for k in (0.20, 0.235, 0.31)]
        blue = [0.52 * self.sky * c * (0.5 + 0.5 * math.sin(elevation)) for c in (0.62, 0.76, 1.0)]
        return Sun(azimuth, elevation, (direct[0], direct[1], direct[2]), (blue[0], blue[1], blue[2]))

    def numbers(self, time: float) -> F64:
        """Return the (20,) light inputs of `kernels.shade`: sun (9), extinction, air, clouds, wind and drift."""
        sun, (e, n) = self.sun_at(time), self.wind.towards
        # the haze is a little darker than a white card that faces the sky: the brightness of the horizon
        air = [0.35 * a * math.sin(sun.elevation) + 1.6 * b for a, b in zip(sun.colour, sun.sky, strict=True)]
        edge = float(np.clip(-ndtri(self.clouds.share), -4.0, 4.0)) * 0.95  # deviation of three octaves
        dark = self.clouds.dark if self.clouds.share > 0 else 0.0
        wind, drift = self.wind.speed, self.clouds.speed
        return np.array(
            [*sun.numbers, 3.912 / self.visibility, *air, edge, self.clouds.size, dark,
             wind * e, wind * n, drift * e, drift * n]
        )  # fmt: skip
