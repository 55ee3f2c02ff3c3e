"""Alight: a safe place to land, from an aircraft's cameras and its GPS/INS."""

import os

__version__ = "0.1.0"

# The filter's matrices are too small to share: OpenBLAS threads spent 30 of 52 s of CPU waiting for each other.
# Where NumPy was imported first, this has no effect and does no harm.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
