"""The page of all settings (docs/settings.md), made from the models."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from pydantic.fields import FieldInfo

from alight.settings.base import FrozenModel
from alight.settings.keys import all_keys, user_keys
from alight.settings.whole import Settings

_HEAD = """# Settings

None is needed. `--set KEY=VALUE` changes one, `--settings FILE` takes YAML, and `alight settings` prints them all.
Every run stores its settings in `run.json`. This page is made by `alight settings --markdown`.
"""

_TUNING = """
## Tuning

Constants that were fitted or chosen on data, by stage. They are stored with every run and hidden from `alight settings`
(`alight settings --all` shows them). Changing one changes what was measured and calibrated;
[where the values come from](lab/tuning-constants.md).
"""


def settings_page() -> str:
    """The page as Markdown."""
    user, everything = user_keys(), all_keys()
    tuning = {key: info for key, info in everything.items() if key not in user}
    return _HEAD + _tables(user, "##") + _TUNING + _tables(tuning, "###")


def _tables(keys: dict[str, FieldInfo], heading: str) -> str:
    """One table for each group of keys."""
    parts = []
    for group, members in groupby(keys.items(), lambda item: item[0].rpartition(".")[0]):
        rows = [f"| `{key}` | {_shown(info.default)} | {info.description} |" for key, info in members]
        title = f"\n{heading} `{group}`\n\n{_about(group)}\n\n"
        parts.append(title + "\n".join(["| key | default | meaning |", "| --- | --- | --- |", *rows]) + "\n")
    return "".join(parts)


def _about(group: str) -> str:
    """The first line of the docstring of a group's model."""
    model: type[Any] = Settings
    for name in group.split("."):
        inner = model.model_fields[name].annotation
        assert isinstance(inner, type)
        assert issubclass(inner, FrozenModel)
        model = inner
    return (model.__doc__ or "").partition("\n")[0]


def _shown(value: object) -> str:
    """A default as YAML has it; numbers to six digits."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
