"""Scenes that differ from seed to seed: values of a scene file that are drawn, by name."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np

from alight.records import InputError

SIGN = "$"
DIGITS = 4  # of a drawn number: a scene that is written down stays readable


def resolve(tree: dict[str, Any], seed: int, where: str) -> dict[str, Any]:
    """The tree of a scene file with its drawn values put in; a tree without `draw` is returned as it is.

    `draw` maps a name to `{between: [a, b]}`, to `{between: [a, b], log: true}` or to `{one_of: [...]}`. The text
    `$name` anywhere in the tree stands for the value. In a list, a drawn list of mappings is put in item by item and
    a drawn null is left out. Every name has a random stream of its own.

    Raises:
        InputError: a draw that is none of these, or a name that is not drawn.
    """
    if "draw" not in tree:
        return tree
    draws = tree["draw"]
    if not isinstance(draws, dict):
        raise InputError(f"{where}: draw: must be names with {{between: [a, b]}} or {{one_of: [...]}}")
    values = {name: _value(spec, [seed, zlib.crc32(str(name).encode())], name, where) for name, spec in draws.items()}
    out = _filled({key: value for key, value in tree.items() if key != "draw"}, values, where)
    assert isinstance(out, dict)
    return out


def _value(spec: Any, stream: list[int], name: str, where: str) -> Any:
    rng = np.random.default_rng(stream)
    keys = set(spec) if isinstance(spec, dict) else set()
    if keys == {"one_of"} and isinstance(spec["one_of"], list) and spec["one_of"]:
        return spec["one_of"][int(rng.integers(len(spec["one_of"])))]
    try:
        if "between" not in keys or not keys <= {"between", "log"}:
            raise ValueError
        low, high = (float(v) for v in spec["between"])
        if spec.get("log"):
            low, high = math.log(low), math.log(high)
        drawn = float(rng.uniform(low, high))
        return round(math.exp(drawn) if spec.get("log") else drawn, DIGITS)
    except (TypeError, ValueError) as e:
        raise InputError(f"{where}: draw.{name}: must be {{between: [a, b]}} or {{one_of: [...]}}") from e


def _filled(part: Any, values: dict[str, Any], where: str) -> Any:
    """A part of the tree with the values in it; a value may name others that are drawn."""
    if isinstance(part, str) and part.startswith(SIGN):
        if part[1:] not in values:
            raise InputError(f"{where}: {part}: nothing of this name is drawn; use one of: {', '.join(values)}")
        rest = {name: value for name, value in values.items() if name != part[1:]}
        return _filled(values[part[1:]], rest, where)
    if isinstance(part, dict):
        return {key: _filled(value, values, where) for key, value in part.items()}
    if not isinstance(part, list):
        return part
    out: list[Any] = []
    for item in part:
        value = _filled(item, values, where)
        if isinstance(item, str) and value is None:
            continue
        out += value if isinstance(item, str) and _are_mappings(value) else [value]
    return out


def _are_mappings(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(v, dict) for v in value)
