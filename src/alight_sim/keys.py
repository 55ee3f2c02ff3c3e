"""Tables of every key of a scene file, made from the models; `alight simulate --keys` prints them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic.fields import FieldInfo

from alight_sim.scene import Scene, things
from alight_sim.section import Section

HEAD = "| key | default | what |\n| --- | --- | --- |"


def reference() -> str:
    """Return Markdown tables of all sections, then of all things that layers may hold."""
    parts = ["# Keys of a scene file", _table("The scene", Scene, "", 2)]
    parts += [_table(f"`{path}`", model, path, 3) for path, model in _sections(Scene, "")]
    parts.append("## Things\n\nItems of `ground.layers`, drawn in their order: `{thing: rocks, per_hectare: 400}`.")
    parts += [_table(f"`thing: {name}`", kind, "", 3) for name, kind in things().items()]
    return "\n\n".join(parts) + "\n"


def _sections(model: type[Section], path: str) -> Iterator[tuple[str, type[Section]]]:
    """Yield key path and model of each section in `model`, depth first, except things; `path`: prefix of all paths."""
    for name, field in model.model_fields.items():
        inner = section_of(field)
        if inner is not None and "thing" not in inner.model_fields:
            yield f"{path}{name}", inner
            yield from _sections(inner, f"{path}{name}.")


def section_of(field: FieldInfo) -> type[Section] | None:
    """Return the model of the section that a field holds, alone or in a list; None: it holds no section."""
    return _find(field.annotation)


def _find(annotation: Any) -> type[Section] | None:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    return next((s for a in get_args(annotation) if (s := _find(a)) is not None), None)


def _table(title: str, model: type[Section], path: str, level: int) -> str:
    rows = [_row(name, field) for name, field in model.model_fields.items() if name != "thing"]
    text = " ".join((model.__doc__ or "").split())
    return "\n".join([f"{'#' * level} {title}", "", text, "", HEAD, *rows])


def _row(name: str, field: FieldInfo) -> str:
    return f"| `{name}` | {_default(field)} | {(field.description or '').replace('|', '/')} |"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    return f"`{_plain(field.default)}`" if section_of(field) is None else "see below"


def _plain(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_plain(v) for v in value)}]"
    if hasattr(value, "name"):
        return str(value.name).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)
