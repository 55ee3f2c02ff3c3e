"""The base of everything a person may write in a scene file."""

from alight.settings.base import FrozenModel


class Section(FrozenModel):
    """One section of a scene: checked as settings are."""
