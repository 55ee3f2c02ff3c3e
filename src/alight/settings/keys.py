"""The names of all keys, the new names of keys of earlier versions, and the nearest name to a wrong one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from alight.settings.whole import Settings

# groups of earlier versions whose constants are now tuning, with their stage of tuning
_STAGE_OF = {
    "motion.filter": "filter",
    "motion.bundle": "bundle",
    "tracks": "tracks",
    "parallax": "parallax",
    "elevation": "elevation",
    "terrain": "terrain",
    "hazards": "hazards",
    "sites": "sites",
    "route": "route",
}


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


def moved_to(key: str) -> str | None:
    """The name of a key of an earlier version that became tuning; None for any other."""
    group, _, name = key.rpartition(".")
    new = f"tuning.{_STAGE_OF.get(group)}.{name}"
    return new if new in all_keys() else None


def nearest(key: str) -> str | None:
    """The known key or group that is most like an unknown one; None where none is alike."""
    names = {k: k for k in all_keys()}
    names |= {group: group for k in names if (group := k.rpartition(".")[0])}
    for old, stage in _STAGE_OF.items():
        start = f"tuning.{stage}."
        names |= {k.replace(start, f"{old}."): k for k in all_keys() if k.startswith(start)}
    found = get_close_matches(key, names, n=1, cutoff=0.75)
    return names[found[0]] if found else None
