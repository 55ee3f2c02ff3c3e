"""Judge every cell of a map as the centre of a touchdown."""

from alight.hazards.assessment import assess

__all__ = ["assess"]
