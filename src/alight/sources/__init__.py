"""Sources: flight logs, recordings, cameras, rasters -> ordered events and maps; what could not be read."""

from alight.sources.source import Described, Source
from alight.sources.tum import read_tum

__all__ = ["Described", "Source", "read_tum"]
