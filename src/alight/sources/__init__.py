"""Sources: a flight log or a folder of photos -> ordered events. The one place that takes the names of input files."""

from alight.sources.opening import open_source
from alight.sources.source import Described, Source
from alight.sources.tum import read_tum

__all__ = ["Described", "Source", "open_source", "read_tum"]
