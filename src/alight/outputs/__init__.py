"""Writing and reading the files of a run."""

from alight.outputs.file_store import FileStore
from alight.outputs.folder import FILES, is_finished, prepare_folder, timing_summary, write_run
from alight.outputs.rasters import ellipsoidal_height
