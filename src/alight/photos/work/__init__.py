"""Workers for a set of photos: this process or a cluster; results from before an interruption are kept."""

from alight.photos.work.cluster import ClusterJobs, cluster_jobs
from alight.photos.work.saved import SavedJobs, work_key
from alight.photos.work.work_folder import WorkFolder

__all__ = ["ClusterJobs", "SavedJobs", "WorkFolder", "cluster_jobs", "work_key"]
