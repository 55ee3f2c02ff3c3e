"""Land cover: evidence that can refuse ground but never permit it alone."""

from alight.terrain.classify import Tables, classify, describe
from alight.terrain.model import Model
from alight.terrain.water import open_water

__all__ = ["Model", "Tables", "classify", "describe", "open_water"]
