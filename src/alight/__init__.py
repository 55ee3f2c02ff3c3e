"""Alight: find a safe place to land, from an aircraft's cameras and its GPS/INS.

>>> import alight
>>> result = alight.run("photos/", lander=alight.Lander(radius=0.8))
>>> result.sites, result.reason
>>> result.save("out/first")

Names are imported when they are first used, so that `import alight` takes almost no time (PEP 562).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from alight.api import (
        campaign,
        check,
        demo,
        evaluate,
        evaluate_appearance,
        judge,
        run,
        simulate,
        train_appearance,
        warmup,
    )
    from alight.pipeline import Pipeline
    from alight.records import AlightError
    from alight.result import Result, read_result
    from alight.runner.opening import open_source
    from alight.settings import Lander, Settings

_HOME = {
    "run": "api",
    "simulate": "api",
    "campaign": "api",
    "check": "api",
    "evaluate": "api",
    "demo": "api",
    "warmup": "api",
    "train_appearance": "api",
    "evaluate_appearance": "api",
    "judge": "api",
    "open_source": "runner.opening",
    "Pipeline": "pipeline",
    "Settings": "settings",
    "Lander": "settings",
    "Result": "result",
    "read_result": "result",
    "AlightError": "records",
}

__all__ = [
    "AlightError",
    "Lander",
    "Pipeline",
    "Result",
    "Settings",
    "campaign",
    "check",
    "demo",
    "evaluate",
    "evaluate_appearance",
    "judge",
    "open_source",
    "read_result",
    "run",
    "simulate",
    "train_appearance",
    "warmup",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its module at the first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'alight' has no attribute {name!r}")
    value = getattr(import_module(f"alight.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return sorted([*__all__, "__version__"])
