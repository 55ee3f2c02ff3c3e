"""Land cover: a reason to refuse ground, never alone one to permit it."""

from alight.terrain.classify import Tables, classify, describe
from alight.terrain.model import Model
from alight.terrain.water import open_water

__all__ = ["Model", "Tables", "classify", "describe", "open_water"]
