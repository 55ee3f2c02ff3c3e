"""What covers the ground, from evidence that needs no model; it may refuse ground and never permits it alone."""

from alight.terrain.classify import classify

__all__ = ["classify"]
