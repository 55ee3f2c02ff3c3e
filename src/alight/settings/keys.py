"""The names of all keys, and the nearest name to a wrong one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import SequenceMatcher, get_close_matches
from functools import cache
from types import MappingProxyType

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from alight.settings.whole import Settings


def walk(model: type[BaseModel] = Settings, before: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Every key with its field: `lander.radius`, ..., `tuning.filter.gate`."""
    for name, info in model.model_fields.items():
        inner = info.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from walk(inner, f"{before}{name}.")
        else:
            yield before + name, info


@cache
def all_keys() -> Mapping[str, FieldInfo]:
    """All keys in order, those of a user first."""
    return MappingProxyType(dict(walk()))


def user_keys() -> dict[str, FieldInfo]:
    """The keys of a user."""
    return {k: v for k, v in all_keys().items() if not k.startswith("tuning.")}


def nearest(key: str) -> str | None:
    """The known key or group that is most like an unknown one; None where none is alike."""
    names = dict.fromkeys(name for k in all_keys() for name in (k, k.rpartition(".")[0]))
    found = get_close_matches(key, names, n=3, cutoff=0.75)
    return max(found, key=lambda name: _likeness(name, key), default=None)


def _likeness(one: str, other: str) -> float:
    """Likeness of the last parts of two keys, 0 to 1."""
    return SequenceMatcher(None, one.rpartition(".")[2], other.rpartition(".")[2]).ratio()
