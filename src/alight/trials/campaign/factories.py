"""Worlds of other packages, by the name of the function that makes them: `package.module:factory`."""

from __future__ import annotations

import importlib
import os
import re
import sys
from pathlib import Path
from types import ModuleType

from alight.records import InputError
from alight.trials.campaign.error_line import error_line
from alight_sim.world import World

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
FORM = "give package.module:factory, a function that takes a seed and returns a world"


def is_factory(scene: str) -> bool:
    """Whether a scene's name is that of a factory."""
    return _NAME.fullmatch(scene) is not None


def made_world(name: str, seed: int) -> World:
    """Call a factory with a seed.

    Raises:
        InputError: it cannot be imported, raises, or returns something that is no `alight_sim.world.World`.
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


def source_of(name: str) -> Path:
    """File of the module of a factory.

    Raises:
        InputError: it cannot be imported.
    """
    return Path(_module(name).__file__ or "")


def _module(name: str) -> ModuleType:
    """Import the module of a factory, also from the working directory, as `python -m` does."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    module = name.partition(":")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as e:
        if e.name is None or not f"{module}.".startswith(f"{e.name}."):
            raise InputError(f"world {name}: importing {module} raised {error_line(e)}") from e
        raise InputError(
            f"world {name}: there is no module {e.name!r} in the working directory or where Python looks"
        ) from e
    except Exception as e:
        raise InputError(f"world {name}: importing {module} raised {error_line(e)}") from e
