"""The base of everything a person may write in a scene file."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """One section of a scene: frozen, checked when made (defaults too), and refusing keys it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)
