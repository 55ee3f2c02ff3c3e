"""Base of all sections that a user may write in a scene file."""

from typing import Annotated

from pydantic import Field

from alight.settings.base import FrozenModel

Coordinate = Annotated[float, Field(ge=-20_000.0, le=20_000.0)]  # metres east or north of the origin
Side = Annotated[float, Field(ge=0.5, le=1000.0)]  # metres, of a level area


class Section(FrozenModel):
    """One section of a scene, validated like settings."""
