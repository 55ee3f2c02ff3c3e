"""The scene file: one YAML file that describes a world; every section and every key may be omitted."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from alight.arrays import F64
from alight.documents import DocumentError, parse_yaml, plain_words, read_text
from alight.geometry import LocalFrame
from alight.records import InputError
from alight_sim.exposure import Imaging
from alight_sim.faults import Faults
from alight_sim.light import Light
from alight_sim.looks import Look
from alight_sim.movers import Traffic
from alight_sim.patterns import FlightPlan
from alight_sim.rasters import SceneRaster
from alight_sim.relief import FractalRelief
from alight_sim.rigs import RigModel
from alight_sim.section import Section
from alight_sim.sensors import Sensors
from alight_sim.things import Thing
from alight_sim.things.base import UNTINTED, CoverName, LookName, Tint
from alight_sim.truth import TrueLander
from alight_sim.variation import resolve

FOLDER = Path(__file__).parent / "scenes"


class Origin(Section):
    """Origin of the world on Earth."""

    latitude: float = Field(47.6213, ge=-89.0, le=89.0, description="degrees, WGS84")
    longitude: float = Field(13.4127, ge=-180.0, le=180.0, description="degrees, WGS84")
    height: float = Field(512.0, ge=-500.0, le=9000.0, description="metres above the ellipsoid, of the zero of heights")

    @property
    def local(self) -> LocalFrame:
        """Local frame at this origin: east, north, up."""
        return LocalFrame(self.latitude, self.longitude, self.height)


Side = Annotated[float, Field(gt=0.0, le=20_000.0)]


class SceneGround(Section):
    """Ground of the world: relief first, then the layers in their order; or a raster of your own."""

    size: tuple[Side, Side] = Field((120.0, 120.0), description="[east, north] metres about the origin, with truth")
    cell: float = Field(0.1, ge=0.05, le=0.2, description="metres")
    cover: CoverName = Field("short_grass", description="class of the ground where no layer has another")
    look: LookName = Field(Look.BY_CLASS, description="look of that ground; without it that of its class")
    tint: Tint = Field(UNTINTED, description="factor on its reflectance: a number or [red, green, blue]")
    slope_deg: float = Field(0.0, ge=0.0, le=60.0, description="of the whole ground")
    downhill_deg: float = Field(180.0, description="where the slope falls to, clockwise from north")
    relief: tuple[FractalRelief, ...] = Field(
        (FractalRelief(), FractalRelief(height=0.012, longest=3.0, shortest=0.2, fall=0.8)),
        description="ups and downs, added up",
    )
    layers: tuple[Thing, ...] = Field((), description="things, each with `thing: name`; later ones lie over earlier")
    raster: SceneRaster | None = Field(None, description="a height raster of your own instead of relief and layers")

    def fall(self, x: F64, y: F64) -> F64:
        """Return the heights of the ground's overall slope at positions `x`, `y` (m), metres; 0 at the origin."""
        steep, towards = math.tan(math.radians(self.slope_deg)), math.radians(self.downhill_deg)
        return np.asarray(-steep * (math.sin(towards) * x + math.cos(towards) * y))

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north in metres: whole cells about the origin."""
        half = [max(1, round(0.5 * s / self.cell)) * self.cell for s in self.size]
        return -half[0], -half[1], half[0], half[1]


class Scene(Section):
    """One world and the flight over it."""

    name: str = Field("scene", description="what it is called")
    description: str = Field("", description="one sentence for people")
    origin: Origin = Field(Origin(), description="where on Earth")
    ground: SceneGround = Field(SceneGround(), description="relief and things")
    light: Light = Field(Light(), description="sun, sky, haze, clouds, wind at the ground")
    traffic: tuple[Traffic, ...] = Field((), description="cars that drive: [{path: [[east, north], ...]}, ...]")
    rig: RigModel = Field(RigModel(), description="the cameras: a name, or cameras of your own")
    imaging: Imaging = Field(Imaging(), description="what lens and sensor make of the light")
    faults: Faults = Field(Faults(), description="what goes wrong between shutter and log")
    flight: FlightPlan = Field(FlightPlan(), description="where to fly, and with what")
    sensors: Sensors = Field(Sensors(), description="GPS/INS and IMU")
    lander: TrueLander = Field(TrueLander(), description="for whom the truth is judged")


def built_in() -> dict[str, Path]:
    """Return the paths of the packaged scenes by name."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.yaml"))}


def read_scene(path: Path, seed: int = 0) -> Scene:
    """Read a scene file; paths of rasters are relative to its folder.

    Args:
        seed: seed of the values that the file draws at random.

    Raises:
        InputError: the file is not readable or not YAML, or has an unknown key or a wrong value.
    """
    try:
        tree = parse_yaml(read_text(path))
    except OSError as e:
        raise InputError(
            f"{path}: cannot be read ({e.strerror}); name a scene file or one of: {', '.join(built_in())}"
        ) from e
    except DocumentError as e:
        raise InputError(f"{path}: {e}; a scene is a YAML file") from e
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise InputError(f"{path}: holds a {type(tree).__name__}; a scene is a list of keys: ground, light, flight ...")
    return parse_scene({"name": path.stem} | tree, str(path), path.parent, seed)


def parse_scene(tree: dict[str, Any], where: str, folder: Path | None = None, seed: int = 0) -> Scene:
    """Return a scene from plain values.

    Args:
        tree: content of a scene file, including `draw` (`alight_sim.variation`).
        where: name of the source in error messages.
        folder: folder to which paths of rasters are relative; None: the working directory.
        seed: seed of the drawn values.

    Raises:
        InputError: a key is unknown or a value is wrong.
    """
    try:
        return Scene.model_validate(resolve(tree, seed, where), context={"folder": folder})
    except ValidationError as e:
        raise InputError(f"{where}: {explain(e)}") from e


def explain(error: ValidationError) -> str:
    """Describe the first error of a scene in one line: the key, the fault, and possible values."""
    problems = error.errors(include_url=False)
    first = problems[0]
    key = ".".join(str(k + 1) if isinstance(k, int) else str(k) for k in first["loc"])
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"{key}: there is no such key; {_known(first['loc'])}{more}"
    if first["type"].startswith("union_tag"):
        return f"{key}: {_tag(first)}{more}"
    message = plain_words(first["msg"])
    return f"{key}: {message[0].lower()}{message[1:]}, not {first.get('input')!r:.60}{more}"


def _tag(problem: Any) -> str:
    context = problem.get("ctx", {})
    names = context.get("expected_tags") or ", ".join(f"'{k}'" for k in things())
    why = f"no thing is called {context['tag']!r}" if "tag" in context else "a layer needs `thing: name`"
    return f"{why}; use one of: {str(names).replace(chr(39), '')}"


def _known(loc: tuple[int | str, ...]) -> str:
    section: Any = Scene
    kinds = things()
    for part in loc[:-1]:
        if isinstance(part, str) and part in kinds:
            section = kinds[part]
        elif isinstance(part, str) and part in getattr(section, "model_fields", {}):
            section = _inner(section.model_fields[part].annotation)
    fields = getattr(section, "model_fields", {})
    return f"use one of: {', '.join(fields)}" if fields else "leave it out"


def _inner(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    for part in getattr(annotation, "__args__", ()):
        found = _inner(part)
        if found is not None:
            return found
    return None


def things() -> dict[str, type[Section]]:
    """Return the models of the things that layers may hold, by name."""
    union = Thing.__args__[0]
    return {kind.model_fields["thing"].annotation.__args__[0]: kind for kind in union.__args__}
