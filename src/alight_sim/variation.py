"""Scenes that differ from seed to seed: named values of a scene file are drawn at random."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np

from alight.records import InputError

SIGN = "$"
DIGITS = 4  # of a drawn number, so that a written scene stays readable


def resolve(tree: dict[str, Any], seed: int, where: str) -> dict[str, Any]:
    """Return the tree of a scene file with its drawn values; a tree without `draw` is returned unchanged.

    `draw` maps a name to `{between: [a, b]}`, to `{between: [a, b], log: true}` or to `{one_of: [...]}`. The text
    `$name` anywhere in the tree is replaced by the value. In a list, a drawn list of mappings is inserted item by item,
    and a drawn null is omitted. Every name has its own random stream.

    Raises:
        InputError: a draw has another form, or a name is not drawn.
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
    """Return a part of the tree with every `$name` replaced from `values`; a value may refer to other drawn names."""
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
