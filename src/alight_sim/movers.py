"""Cars that drive along lines: boxes at exact positions, for the pictures and for the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from pydantic import Field, model_validator

from alight.arrays import F64
from alight_sim.kernels.boxes import NUMBERS
from alight_sim.materials import palette
from alight_sim.section import Coordinate, Section

Height = Callable[[float, float], float]
CABIN = (0.55, 0.86, 0.42)  # of the length, the width and the height: the glass house on the body
NODE = 1.0  # metres along the path between the ground heights under a car or a person


class Moving(Protocol):
    """Interface of moving objects: upright boxes whose positions are functions of time."""

    def boxes_at(self, times: F64) -> F64:
        """Return the (T, M, 12) boxes at times (s), in the format of `kernels.boxes`."""


class Traffic(Section):
    """Cars that follow each other on one line."""

    path: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        min_length=2, description="east and north of its corners, metres"
    )
    speed: float = Field(8.0, description="m/s; negative: from the end to the start")
    size: tuple[float, float, float] = Field((4.4, 1.8, 1.5), description="length, width, height, metres")
    colour: tuple[float, float, float] | None = Field(None, description="linear RGB; none: each car its own")
    gap: float = Field(35.0, gt=1, description="metres from a car to the next")

    @model_validator(mode="after")
    def _moves(self) -> Traffic:
        if any(a == b for a, b in zip(self.path, self.path[1:], strict=False)):
            raise ValueError("two corners of the path are the same place; leave one out")
        if min(self.size) <= 0:
            raise ValueError("the size of a car must be positive")
        return self


@dataclass(frozen=True, eq=False)
class Mover:
    """The cars of one line of traffic. A car that reaches the end of the line reappears at its start."""

    traffic: Traffic
    height_at: Height
    seed: int = 0

    @cached_property
    def corners(self) -> tuple[F64, F64]:
        """(N, 2) corners of the path, and (N,) distance of each along the path, metres."""
        path = np.array(self.traffic.path, float)
        return path, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])

    @cached_property
    def _ride(self) -> tuple[F64, F64]:
        path, along = self.corners
        nodes = np.linspace(0.0, along[-1], max(2, round(along[-1] / NODE) + 1))
        east, north = (np.interp(nodes, along, path[:, k]) for k in range(2))
        return nodes, np.array([self.height_at(float(e), float(n)) for e, n in zip(east, north, strict=True)])

    @cached_property
    def starts(self) -> F64:
        """Distance of each car along the path at time 0, (M,) metres."""
        length = self.corners[1][-1]
        count = max(1, int(length / self.traffic.gap))
        rng = np.random.default_rng(np.random.SeedSequence([self.seed & 0xFFFFFFFF, 77]))
        return np.asarray(length * np.arange(count) / count + rng.uniform(-0.2, 0.2, count) * self.traffic.gap)

    @cached_property
    def paint(self) -> F64:
        """Linear RGB colour of each car, (M, 3)."""
        if self.traffic.colour is not None:
            return np.tile(np.array(self.traffic.colour), (len(self.starts), 1))
        rng = np.random.default_rng(np.random.SeedSequence([self.seed & 0xFFFFFFFF, 78]))
        colours = palette("traffic")
        return np.asarray(colours[rng.integers(0, len(colours), len(self.starts))])

    def places_at(self, times: F64) -> tuple[F64, F64]:
        """Return the (T, M, 3) centre of each car's base and (T, M) heading, rad from east to north, at times (s)."""
        path, along = self.corners
        s = np.mod(self.starts + self.traffic.speed * np.asarray(times, float)[:, None], along[-1])
        leg = np.clip(np.searchsorted(along, s, "right") - 1, 0, len(along) - 2)
        step = np.diff(path, axis=0)
        heading = np.arctan2(step[leg, 1], step[leg, 0]) + (np.pi if self.traffic.speed < 0 else 0.0)
        east, north = (np.interp(s, along, path[:, k]) for k in range(2))
        return np.stack([east, north, np.interp(s, *self._ride)], -1), heading

    def boxes_at(self, times: F64) -> F64:
        """Return the (T, 2 M, 12) body and cabin of each car at times (s), in the format of `kernels.boxes`."""
        places, heading = self.places_at(times)
        return car_boxes(places, heading, self.traffic.size, self.paint)


def car_boxes(places: F64, heading: F64, size: tuple[float, float, float], paint: F64) -> F64:
    """Return the (T, 2 M, 12) boxes of cars, a body and a cabin per car, in the format of `kernels.boxes`.

    `places`: (T, M, 3) metres, centres of the base. `heading`: (T, M) rad from east to north. `size`: length, width,
    height, metres. `paint`: (M, 3) linear RGB.
    """
    length, width, height = size
    out = np.zeros((*heading.shape, 2, NUMBERS))
    out[..., 3], out[..., 4] = np.cos(heading)[..., None], np.sin(heading)[..., None]
    body, cabin = out[..., 0, :], out[..., 1, :]
    body[..., :3] = cabin[..., :3] = places
    body[..., 5:8] = 0.5 * length, 0.5 * width, (1.0 - CABIN[2]) * height
    cabin[..., 2] += (1.0 - CABIN[2]) * height
    cabin[..., 5:8] = 0.5 * CABIN[0] * length, 0.5 * CABIN[1] * width, CABIN[2] * height
    body[..., 8:11] = cabin[..., 8:11] = paint
    cabin[..., 11] = 1.0
    return out.reshape(len(heading), -1, NUMBERS)


def boxes_at(movers: Sequence[Moving], times: F64) -> F64:
    """Return the (T, M, 12) boxes of all moving objects at times (s)."""
    none = np.zeros((len(times), 0, NUMBERS))
    return np.concatenate([none, *(m.boxes_at(times) for m in movers)], axis=1)
