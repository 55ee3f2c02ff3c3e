"""Base of all settings models (frozen, unknown keys refused), and the number types of their fields."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from alight.settings.units import in_declared, unit_of

MOST = 1e9  # limit of every length, time or weight in a setting; larger numbers cause overflows somewhere
Positive = Annotated[float, Field(ge=1e-9, le=MOST, allow_inf_nan=False)]
Finite = Annotated[float, Field(ge=-MOST, le=MOST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=MOST, allow_inf_nan=False)]
Vehicle = Annotated[float, Field(ge=1e-3, le=100.0, allow_inf_nan=False)]  # metres, size of a part of a vehicle
Incline = Annotated[float, Field(ge=1e-9, le=1.5707964, allow_inf_nan=False)]  # rad, from the vertical
Offset = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False)]  # metres, within a vehicle
Part = Annotated[float, Field(ge=0, le=100.0, allow_inf_nan=False)]  # metres, size of a part that may be absent
Gap = Annotated[float, Field(ge=0, le=5.0, allow_inf_nan=False)]  # metres, across which heights are bridged
Seconds = Annotated[float, Field(ge=0, le=10.0, allow_inf_nan=False)]  # between two clocks that overlap
Fraction = Annotated[float, Field(ge=0, le=1)]


class FrozenModel(BaseModel):
    """A group of keys that a user may write: frozen, every default validated, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truth_for_a_number(cls, tree: Any) -> Any:
        """Refuse `true` or `false` for a key that is not boolean: pydantic would convert it to 1 or 0."""
        given = {k: v for k, v in tree.items() if isinstance(v, bool)} if isinstance(tree, dict) else {}
        kinds = {k: field.annotation for k, field in cls.model_fields.items() if k in given}
        error = PydanticCustomError("no_number", "Input should be a number or a word, not true or false")
        wrong = [
            InitErrorDetails(type=error, loc=(k,), input=given[k])
            for k, kind in kinds.items()
            if bool not in (kind, *get_args(kind))
        ]
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return tree

    @model_validator(mode="before")
    @classmethod
    def _with_units(cls, tree: Any) -> Any:
        """Convert values with a unit, such as 30cm, to the unit that the key declares."""
        given = {k: v for k, v in tree.items() if k in cls.model_fields} if isinstance(tree, dict) else {}
        wrong, converted = list[InitErrorDetails](), dict[str, Any]()
        for name, value in given.items():
            if unit := unit_of(cls.model_fields[name]):
                try:
                    converted[name] = in_declared(value, unit)
                except ValueError as e:
                    error = PydanticCustomError("unit", "{why}", {"why": str(e)})
                    wrong.append(InitErrorDetails(type=error, loc=(name,), input=value))
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return {**tree, **converted} if converted else tree
