"""What a raster file may raise when it is opened or read."""

from __future__ import annotations

from rasterio.errors import RasterioError

UNREADABLE = (RasterioError, UnicodeDecodeError)  # the latter: the name of its coordinate system is no text
