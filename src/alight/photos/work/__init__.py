"""Work of a set of photos, whose results from before an interruption are kept."""

from alight.photos.work.saved import SavedJobs, WorkFolder, work_key

__all__ = ["SavedJobs", "WorkFolder", "work_key"]
