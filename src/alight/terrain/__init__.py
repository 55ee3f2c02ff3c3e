"""What covers the ground, from evidence that is weighed; it may refuse ground and never permits it alone."""

from alight.terrain.classify import classify, says
from alight.terrain.fusion import Looks, fused, remember
from alight.terrain.model import Model

__all__ = ["Looks", "Model", "classify", "fused", "remember", "says"]
