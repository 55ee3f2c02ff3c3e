"""What covers the ground, from evidence that is weighed; it may refuse ground and never permits it alone."""

from alight.terrain.classify import classify, says
from alight.terrain.model import Model
from alight.terrain.water import open_water

__all__ = ["Model", "classify", "open_water", "says"]
