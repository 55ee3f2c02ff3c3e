"""Saved work on a set of photos, from which an interrupted run continues."""

from alight.photos.work.saved import SavedJobs, WorkFolder, work_key

__all__ = ["SavedJobs", "WorkFolder", "work_key"]
