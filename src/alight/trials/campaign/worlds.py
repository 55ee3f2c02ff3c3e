"""The worlds of a campaign by name: kinds of the simulator, scene files, and factories of other packages."""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from alight.records import InputError
from alight.settings import Settings
from alight_sim.campaign import CampaignWorld, campaign_worlds
from alight_sim.scene import built_in, read_scene
from alight_sim.world import World

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
FORM = "give package.module:factory, a function that takes a seed and returns a world"


def is_factory(scene: str) -> bool:
    """Whether the name of a scene is the name of a factory."""
    return _NAME.fullmatch(scene) is not None


def made_world(name: str, seed: int) -> World:
    """Return the world that the factory called `name` (`package.module:factory`) makes from a seed.

    Raises:
        InputError: the factory cannot be imported, raises, or does not return an `alight_sim.world.World`.
    """
    module, function = _module(name), name.partition(":")[2]
    factory = getattr(module, function, None)
    if not callable(factory):
        raise InputError(f"world {name}: {module.__name__} has no function {function!r}; {FORM}")
    try:
        world = factory(seed)
    except Exception as e:
        raise InputError(f"world {name}: {function}({seed}) raised {error_line(e)}") from e
    if not isinstance(world, World):
        missing = [part for part in dir(World) if not part.startswith("_") and not hasattr(world, part)]
        raise InputError(
            f"world {name}: {function} returns a {type(world).__name__} without {', '.join(missing)}; derive its class "
            "from alight_sim.world.World"
        )
    return world


def _module(name: str) -> ModuleType:
    """Import the module of the factory called `name`, also from the working directory, as `python -m` does."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    module = name.partition(":")[0]
    try:
        return importlib.import_module(module)
    except Exception as e:
        if isinstance(e, ModuleNotFoundError) and e.name and f"{module}.".startswith(f"{e.name}."):
            why = f"there is no module {e.name!r} in the working directory or where Python looks"
        else:
            why = f"importing {module} raised {error_line(e)}"
        raise InputError(f"world {name}: {why}") from e


def error_line(error: BaseException) -> str:
    """Return type, message and source line of an error as one line of text."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}".split()) + where


def campaign_world(scene: str) -> CampaignWorld:
    """Return the world of a scene: a kind of world of the simulator, a built-in scene, or a scene file."""
    return campaign_worlds().get(scene) or CampaignWorld(scene, scene)


def scenes_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the scenes of a campaign without repetitions; `all` means all kinds of worlds of the simulator.

    Raises:
        InputError: no scene is named, there is no such scene, or its file cannot be used.
    """
    if not names:
        raise InputError("a campaign without scenes; name some, or 'all'")
    known = campaign_worlds()
    scenes = tuple(dict.fromkeys(s for name in names for s in (known if name == "all" else (name,))))
    for scene in scenes:
        if scene in known or scene in built_in() or is_factory(scene):
            continue
        if not Path(scene).suffix:
            have = ", ".join(sorted({*known, *built_in()}))
            raise InputError(f"no scene is called {scene!r}; use 'all', a YAML file, or some of: {have}")
        read_scene(Path(scene))
    return scenes


def file_digests(scenes: Sequence[str], settings: Settings) -> dict[str, str]:
    """Return digests by file name: of scene files and their rasters, factories' modules, and the appearance model.

    Raises:
        InputError: a file cannot be read.
    """
    named = [Path(_module(s).__file__ or "") for s in scenes if is_factory(s)]
    files = [Path(s) for s in scenes if s not in {*campaign_worlds(), *built_in()} and not is_factory(s)]
    named += [path for scene in files for path in (scene, *_paths(read_scene(scene).model_dump()))]
    model = settings.terrain.model
    if model is not None and model != "default" and settings.terrain.enabled:
        named.append(Path(model))
    try:
        return {str(p): hashlib.sha256(p.read_bytes()).hexdigest()[:16] for p in named if p.is_file()}
    except OSError as e:
        raise InputError(f"{e.filename}: cannot be read ({e.strerror})") from e


def _paths(tree: Any) -> Iterator[Path]:
    if isinstance(tree, Path):
        yield tree
    for part in tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list | tuple) else ():
        yield from _paths(part)
