"""Imports code and compiled loops of all lanes in the fork server, so that a new lane starts in milliseconds.

Each lane loads its parallel loops itself: they start threads, and a process with threads must not fork.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
os.environ["NUMBA_NUM_THREADS"] = str(max(1, (os.cpu_count() or 1) - 2))  # mapping leaves two cores to other lanes

# isort: split
from alight import compiled
from alight.flight.live import lanes as lanes

compiled.load_cached(parallel=False)
