"""Patterns of a flight plan, as lines of way-points."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from alight.arrays import F64
from alight_sim.section import Section
from alight_sim.vehicle import Air, Limits

Pattern = Literal[
    "transect", "lawn_mower", "spiral", "descent", "approach", "climb", "two_heights", "hover", "waypoints"
]  # fmt: skip
Place = tuple[float, float, float]
ARC = 1.0  # metres between the points of a curve
SLIDE = 0.15  # metres over ground per metre of height, in an approach and in a climb
HELD: tuple[Pattern, ...] = ("hover", "descent", "approach", "climb", "two_heights")  # heading by `course_deg`


class FlightPlan(Section):
    """Plan of a flight; `height: 40` alone is enough."""

    pattern: Pattern = Field("transect", description="what to fly; `waypoints` where those are given")
    height: float = Field(40.0, gt=0, le=10_000, description="metres above what `above` names, at the start")
    above: Literal["ground", "origin"] = Field(
        "ground", description="heights count from the ground under the start, or from the world's origin"
    )
    speed: float = Field(5.0, gt=0, le=60.0, description="m/s, cruise; slower in corners and when climbing or sinking")
    duration: float = Field(8.0, gt=0, description="s of a transect or a hover")
    centre: tuple[float, float] = Field((0.0, 0.0), description="east, north of the pattern's middle, metres")
    course_deg: float = Field(84.3, description="degrees clockwise from north: of the transect, the lines, the descent")
    length: float | None = Field(
        None,
        ge=0,
        description="metres: of a lawn mower's lines (40), of the strips of an approach or of two heights "
        "(0.35 of the greater height), over ground in a descent (a third of the height lost)",
    )
    lines: int = Field(4, ge=1, le=1000, description="lines of a lawn mower")
    spacing: float | None = Field(
        None, gt=0, description="metres between the lines or the turns of a spiral (0.3 of the height)"
    )
    turns: float = Field(2.0, gt=0, le=1000, description="turns of a spiral, outwards")
    end_height: float = Field(
        5.0, gt=0, description="metres, where a descent, an approach, a climb or two heights end; counts like `height`"
    )
    waypoints: tuple[Place, ...] | None = Field(
        None, description="east, north, height: metres; heights count like `height`"
    )
    heading_deg: float | None = Field(
        None, description="degrees clockwise from north, held; without it the nose follows the course"
    )
    vehicle: Literal["multirotor", "helicopter"] = Field("multirotor", description="what flies")
    limits: Limits = Field(Limits(), description="what the vehicle does at most")
    air: Air = Field(Air(), description="the wind that it flies in")

    @model_validator(mode="after")
    def _agree(self) -> FlightPlan:
        if self.pattern == "waypoints" and not self.waypoints:
            raise ValueError("pattern: waypoints needs waypoints: [[east, north, height], ...]")
        if self.pattern in ("descent", "approach") and self.end_height >= self.height:
            article = "an" if self.pattern == "approach" else "a"
            raise ValueError(
                f"{article} {self.pattern} ends below its start: "
                f"end_height {self.end_height:g} >= height {self.height:g}"
            )
        if self.pattern == "climb" and self.end_height <= self.height:
            raise ValueError(f"a climb ends above its start: end_height {self.end_height:g} <= height {self.height:g}")
        return self

    @property
    def kind(self) -> Pattern:
        """Pattern that is flown: `waypoints` if way-points are given."""
        return "waypoints" if self.waypoints else self.pattern

    @property
    def rolling(self) -> bool:
        """Whether the flight begins and ends at full speed, as part of a longer one; true for a transect."""
        return self.kind == "transect"

    @property
    def heading(self) -> float | None:
        """Constant heading, rad counter-clockwise from east; None: the nose follows the course."""
        if self.heading_deg is not None:
            return math.radians(90.0 - self.heading_deg)
        return math.radians(90.0 - self.course_deg) if self.kind in HELD else None


def line(plan: FlightPlan) -> F64:
    """Return the (N, 3) way-points: east, north, and height above the plan's zero, metres; one way-point is a hover."""
    if plan.waypoints:
        return np.array(plan.waypoints, dtype=np.float64)
    flat = {
        "transect": _transect, "lawn_mower": _lawn_mower, "spiral": _spiral, "descent": _descent, "hover": _hover,
        "approach": _approach, "climb": _climb, "two_heights": _two_heights,
    }[plan.kind](plan)  # fmt: skip
    course = math.radians(plan.course_deg)
    along, right = np.array([math.sin(course), math.cos(course)]), np.array([math.cos(course), -math.sin(course)])
    places = np.array(plan.centre) + flat[:, :1] * along + flat[:, 1:2] * right
    return np.column_stack([places, flat[:, 2]])


def _transect(plan: FlightPlan) -> F64:
    half = 0.5 * plan.duration * plan.speed
    return np.array([[-half, 0.0, plan.height], [half, 0.0, plan.height]])


def _lawn_mower(plan: FlightPlan) -> F64:
    half, gap = 0.5 * (plan.length or 40.0), plan.spacing or 0.3 * plan.height
    out = []
    for k in range(plan.lines):
        side = gap * (k - 0.5 * (plan.lines - 1))
        ends = (-half, half) if k % 2 == 0 else (half, -half)
        out += [[end, side, plan.height] for end in ends]
    return np.array(out)


def _spiral(plan: FlightPlan) -> F64:
    gap = (plan.spacing or 0.3 * plan.height) / (2.0 * math.pi)
    last = 2.0 * math.pi * plan.turns
    fine = np.linspace(0.0, last, max(int(200 * plan.turns), 50))
    arc = np.concatenate([[0.0], np.cumsum(gap * np.hypot(1.0, 0.5 * (fine[1:] + fine[:-1])) * np.diff(fine))])
    angle = np.interp(np.linspace(0.0, arc[-1], max(int(arc[-1] / ARC), 2) + 1), arc, fine)
    return np.column_stack([gap * angle * np.cos(angle), gap * angle * np.sin(angle), np.full(len(angle), plan.height)])


def _descent(plan: FlightPlan) -> F64:
    lost = plan.height - plan.end_height
    half = 0.5 * (lost / 3.0 if plan.length is None else plan.length)
    return np.array([[-half, 0.0, plan.height], [half, 0.0, plan.end_height]])


def _hover(plan: FlightPlan) -> F64:
    return np.array([[0.0, 0.0, plan.height]])


def _approach(plan: FlightPlan) -> F64:
    """Return a path as before a landing: a strip, a return close to it, and a descent to the pattern's centre."""
    half, gap = 0.5 * _strip(plan), plan.spacing or 0.1 * plan.height
    begin = SLIDE * (plan.height - plan.end_height)
    return np.array(
        [
            [-half, -0.5 * gap, plan.height], [half, -0.5 * gap, plan.height], [half, 0.5 * gap, plan.height],
            [begin, 0.0, plan.height], [0.0, 0.0, plan.end_height],
        ]
    )  # fmt: skip


def _climb(plan: FlightPlan) -> F64:
    end = SLIDE * (plan.end_height - plan.height)
    return np.array([[-plan.height, 0.0, plan.height], [0.0, 0.0, plan.height], [end, 0.0, plan.end_height]])


def _two_heights(plan: FlightPlan) -> F64:
    """Return a strip at the plan's height, and the same strip back at the end height."""
    half = 0.5 * _strip(plan)
    ends = ((-half, plan.height), (half, plan.height), (half, plan.end_height), (-half, plan.end_height))
    return np.array([[along, 0.0, height] for along, height in ends])


def _strip(plan: FlightPlan) -> float:
    return plan.length or 0.35 * max(plan.height, plan.end_height)
