"""Sources: flight logs, recordings, cameras, rasters -> ordered events and maps; what could not be read."""

from alight.sources.source import Described, Source

__all__ = ["Described", "Source"]
