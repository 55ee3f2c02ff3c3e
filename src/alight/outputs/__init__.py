"""What a run leaves behind, and how it is read back."""

from alight.outputs.folder import FILES, prepare, timing_summary, write_run
from alight.outputs.rasters import ellipsoidal_height, world_up
from alight.outputs.reading import Run, read_run
from alight.outputs.spill import Spill
from alight.records import RunResult

__all__ = [
    "FILES",
    "Run",
    "RunResult",
    "Spill",
    "ellipsoidal_height",
    "prepare",
    "read_run",
    "timing_summary",
    "world_up",
    "write_run",
]
