"""Reading settings from keys, YAML text, `key=value` assignments, and the run.json of an earlier run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from difflib import SequenceMatcher, get_close_matches
from functools import cache
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from alight.documents import DocumentError, parse_yaml, plain_words
from alight.settings.units import is_ambiguous, unit_of
from alight.settings.whole import Settings

Tree = dict[str, Any]


def load_settings(text: str = "", assignments: Iterable[str] = ()) -> Settings:
    """Return settings from YAML text and `key=value` assignments, which override the text.

    Raises:
        ValueError: the text is not YAML, a key is unknown, or a value is out of range; the message names the key.
    """
    try:
        tree = parse_yaml(text) or {}
        if not isinstance(tree, dict):
            raise ValueError("settings: needs a mapping of keys at the top")
        for a in assignments:
            _assign(tree, a)
    except DocumentError as e:
        raise ValueError(f"settings: {e}") from e
    return _to_fly(tree)


def settings_of_keys(given: Mapping[str, Any]) -> Settings:
    """Return settings from keys such as `parallax.cell`, or groups of keys; a later item overrides an earlier one.

    Raises:
        ValueError: a key is unknown, or a value is out of range; the message names the key.
    """
    return _to_fly(_tree((key.strip(), value) for key, value in given.items()))


def settings_of_run(stored: Mapping[str, Any]) -> Settings:
    """Return the settings stored in a run.json; unknown keys are ignored.

    Raises:
        ValueError: the value of a known key is not valid; the message names the key.
    """
    return _validated(_tree(item for item in leaves(stored) if item[0] in all_keys()))


def _to_fly(tree: Tree) -> Settings:
    for key, value in leaves(tree):
        if key in all_keys() and is_ambiguous(value, unit_of(all_keys()[key])):
            raise ValueError(f"{key}: {value} may be degrees or radians; write {value}deg or {value}rad")
    settings = _validated(tree)
    if settings.too_low:
        raise ValueError(settings.too_low)
    return settings


def _validated(tree: Tree) -> Settings:
    try:
        return Settings.model_validate(tree)
    except ValidationError as e:
        raise ValueError(_explain(e)) from e


def _assign(tree: Tree, assignment: str) -> None:
    key, sep, value = assignment.partition("=")
    if not sep or not all(part.strip() for part in key.split(".")):
        raise ValueError(f"--set takes key=value, got {assignment!r}")
    try:
        _put(tree, key.strip(), parse_yaml(value))
    except DocumentError as e:
        raise ValueError(f"{key.strip()}: {e}") from e


def _tree(pairs: Iterable[tuple[str, Any]]) -> Tree:
    tree: Tree = {}
    for key, value in pairs:
        _put(tree, key, value)
    return tree


def _put(tree: Tree, key: str, value: Any) -> None:
    """Put a value into the tree at a dotted `key`; a group of keys is merged with the group that the tree holds."""
    *path, last = key.split(".")
    for part in path:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise ValueError(f"{key}: {part} is not a group of settings")
    _merge(tree, last, value)


def _merge(tree: Tree, name: str, value: Any) -> None:
    if isinstance(value, Mapping) and isinstance(tree.get(name), dict):
        for inner, part in value.items():
            _merge(tree[name], inner, part)
    else:
        tree[name] = value


def leaves(tree: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a nested mapping by their dotted keys; `before`: prefix of the keys."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.6g}deg"


def _explain(error: ValidationError) -> str:
    lines: list[str] = []
    for e in error.errors():
        key = ".".join(str(k) for k in e["loc"])
        if e["type"] != "extra_forbidden":
            message = plain_words(e["msg"])
            got, limit, known = e["input"], [*e.get("ctx", {}).values()], all_keys().get(key)
            if known is not None and unit_of(known) == "rad" and isinstance(got, float):
                lines.append(f"{key}: {message.replace(str(limit[0]), _degrees(limit[0]))} (got {_degrees(got)})")
                continue
            lines.append(f"{key}: {message} (got {got!r})")
        else:
            like = nearest(key)
            lines.append(f"{key}: unknown key" + (f", did you mean {like}?" if like else ""))
    return "; ".join(lines) + "; 'alight settings' lists every key"


def walk(model: type[BaseModel] = Settings, before: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Yield every key of a model with its field, such as `lander.radius`; `before`: prefix of the keys."""
    for name, info in model.model_fields.items():
        inner = info.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from walk(inner, f"{before}{name}.")
        else:
            yield before + name, info


@cache
def all_keys() -> Mapping[str, FieldInfo]:
    """Return the fields of all keys, in order, with the keys for users first."""
    return MappingProxyType(dict(walk()))


def user_keys() -> dict[str, FieldInfo]:
    """Return the fields of the keys for users."""
    return {k: v for k, v in all_keys().items() if not k.startswith("tuning.")}


def nearest(key: str) -> str | None:
    """Return the known key or group that is most similar to an unknown key; None if there is no similar one."""
    names = dict.fromkeys(name for k in all_keys() for name in (k, k.rpartition(".")[0]))
    found = get_close_matches(key, names, n=3, cutoff=0.75) or [k for k in names if k.endswith(f".{key}")][:1]
    last = key.rpartition(".")[2]
    return max(found, key=lambda name: SequenceMatcher(None, name.rpartition(".")[2], last).ratio(), default=None)
