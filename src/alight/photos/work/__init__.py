"""Work of a set of photos, whose results from before an interruption are kept."""

from alight.photos.work.saved import SavedJobs, work_key
from alight.photos.work.work_folder import WorkFolder

__all__ = ["SavedJobs", "WorkFolder", "work_key"]
