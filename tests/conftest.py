"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: as the command line has it

# isort: split
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numba
import pytest
from damage import write_flight, write_photos
from hypothesis import settings
from refusal import Refused, refused_by

from alight.loop_forms import compile_loops

T = TypeVar("T")

# Files that begin: the longest ones, so that two workers end together.
BEGIN = (
    "flight/live/test_live.py", "pipeline/test_levels.py", "photos/test_bundle.py", "parallax/test_kernels_parallax.py",
    "hazards/test_hazards_kernels.py", "flight/executive/test_executive.py", "test_loop_cache.py",
    "flight/session/test_fly.py", "trials/test_campaign.py", "pipeline/test_pipeline.py", "trials/test_demo.py",
    "flight/live/test_live_recording.py", "test_places.py", "flight/session/test_fly_down.py",
    "flight/session/test_fly_hands.py", "trials/test_own_world.py",
)  # fmt: skip

# the same examples in each run, whichever tests run beside them
settings.register_profile("fixed", derandomize=True, database=None, deadline=None, max_examples=60)
settings.load_profile("fixed")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files of `BEGIN` first."""
    rank = {Path(__file__).parent / name: k for k, name in enumerate(BEGIN)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


def pytest_collection_finish() -> None:
    """Take what was imported out of later garbage collections, which would go through all of it each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _frozen() -> Iterator[None]:
    """Take what a module has left, such as the trees of the source in `parsed`, out of them too."""
    yield
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real recordings that is not part of the project; tests that need it are skipped without it."""
    folder = Path(os.environ.get("ALIGHT_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recordings in {folder}: set ALIGHT_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def warm() -> None:
    """Compile all loops of a run, as before a live run."""
    compile_loops("flight")


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """A tiny healthy flight log with two cameras, nav0, imu0 and truth."""
    return write_flight(tmp_path / "flight")


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A tiny healthy folder of photos as DJI writes them."""
    return write_photos(tmp_path / "survey")


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """Return a function that runs a command which must fail, and returns the line of its error."""
    return refused_by(capsys)


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """Yield the setter of the number of threads of the kernels; the number is restored after the test."""
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.fixture
def on_one_and_all(threads: Callable[[int], None]) -> Callable[[Callable[[], T]], tuple[T, T]]:
    """Return a function that makes a call on one thread and on all threads, and returns both results."""

    def both(call: Callable[[], T]) -> tuple[T, T]:
        threads(1)
        alone = call()
        threads(numba.config.NUMBA_NUM_THREADS)
        return alone, call()

    return both
