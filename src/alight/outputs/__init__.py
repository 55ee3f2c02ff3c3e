"""Files of a run: writing and reading them."""

from alight.outputs.file_store import FileStore
from alight.outputs.folder import FILES, is_finished, prepare_folder, timing_summary, write_run
from alight.outputs.rasters import ellipsoidal_height
