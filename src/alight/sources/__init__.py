"""Sources: flight logs, recordings, cameras and rasters become ordered events and maps; losses are recorded."""

from alight.sources.source import Described, Source

__all__ = ["Described", "Source"]
