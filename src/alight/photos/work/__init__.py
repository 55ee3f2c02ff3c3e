"""Work of a set of photos, whose results from before an interruption are kept."""

from alight.photos.work.saved import SavedJobs, work_key

__all__ = ["SavedJobs", "work_key"]
