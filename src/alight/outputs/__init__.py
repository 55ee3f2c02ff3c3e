"""What a run leaves behind, and how it is read back."""

from alight.outputs.file_store import FileStore
from alight.outputs.folder import FILES, prepare_folder, timing_summary, write_run
from alight.outputs.rasters import ellipsoidal_height, world_up
from alight.outputs.reading import Run, read_bands, read_run
from alight.records import RunResult

__all__ = [
    "FILES",
    "FileStore",
    "Run",
    "RunResult",
    "ellipsoidal_height",
    "prepare_folder",
    "read_bands",
    "read_run",
    "timing_summary",
    "world_up",
    "write_run",
]
