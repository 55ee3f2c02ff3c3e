"""Names of old: built-in scenes and how to make their world."""

from alight.simulate.scene import built_in
from alight.simulate.world import build

SCENES = built_in()

__all__ = ["SCENES", "build"]
