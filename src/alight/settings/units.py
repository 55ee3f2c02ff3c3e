"""Units of settings: each key's description declares its unit; a user may write others (30cm, 5deg)."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

# units that may be written, by the declared unit, with their size in it; degrees: `math.radians`
UNITS = {
    "m": {"m": "1", "cm": "1/100", "mm": "1/1000", "km": "1000"},
    "rad": {"deg": "", "rad": "1", "mrad": "1/1000"},
    "m/s": {"m/s": "1", "cm/s": "1/100", "km/h": "5/18"},
    "rad/s": {"deg/s": "", "rad/s": "1"},
    "s": {"s": "1", "ms": "1/1000", "min": "60", "h": "3600"},
}
_DECLARED = re.compile(rf"[,:] ({'|'.join(sorted(UNITS, key=len, reverse=True))})(?=[;:,.]|$| (?!per ))")
_QUANTITY = re.compile(r"\s*([-+]?(?:\d{1,30}\.?\d{0,30}|\.\d{1,30})(?:[eE][-+]?\d{1,2})?)\s*([a-zA-Z/°]+)\s*")


@cache
def declared_unit(description: str | None) -> str:
    """Return the unit that a description declares, as in `Radius of the footprint, m`; empty: no unit of `UNITS`."""
    found = _DECLARED.search(description or "")
    return found[1] if found else ""


def unit_of(info: FieldInfo) -> str:
    """Return the unit of a key that has numbers; empty: none of `UNITS`."""
    return declared_unit(info.description)


def in_declared(value: Any, unit: str) -> Any:
    """Return a value as a number of the declared `unit` if it is a text with a unit; lists are converted inside.

    Raises:
        ValueError: the value has a unit of another kind.
    """
    if isinstance(value, list | tuple):
        return [in_declared(v, unit) for v in value]
    found = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        return value
    size = UNITS[unit].get(found[2].replace("°", "deg"))
    if size is None:
        *others, last = UNITS[unit]
        raise ValueError(f"give it in {', '.join(others)} or {last}")
    return float(Fraction(found[1]) * Fraction(size)) if size else math.radians(float(found[1]))


def is_ambiguous(value: Any, unit: str) -> bool:
    """Whether an angle without a unit is so large that degrees may be meant."""
    try:
        return unit == "rad" and not isinstance(value, bool | list) and 1 <= abs(float(value)) < math.inf
    except (TypeError, ValueError):
        return False


def degrees_text(angle: float) -> str:
    """Return an angle in degrees with as few digits as give the same angle; in radians if none do."""
    texts = (f"{round(math.degrees(angle), digits)!r}".removesuffix(".0") + "deg" for digits in range(18))
    return next((text for text in texts if in_declared(text, "rad") == angle), f"{angle!r}rad")


def with_degrees(tree: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the values of a model, as `model_dump` gives them, with the angles as text in degrees."""
    out = dict(tree)
    for name, value in tree.items():
        info = model.model_fields[name]
        if isinstance(value, dict) and isinstance(info.annotation, type):
            out[name] = with_degrees(value, info.annotation)
        elif unit_of(info) == "rad" and isinstance(value, float):
            out[name] = degrees_text(value)
    return out
