"""The compiler's one doorway: cache location, threading layer and the `kernel` decorators.

Numba keys its cache by each file's own time stamp, so a change in a helper of another file leaves stale callers. The
cache folder is therefore named by a hash of every kernel source: `*kernels.py` beside the stages, and those of the
simulator, which come in the same wheel.
"""

import hashlib
import importlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

R = TypeVar("R")


class _Compile(Protocol):
    """A decorator that compiles a function; the compiler, not the annotations, decides which arguments fit."""

    def __call__(self, function: Callable[..., R]) -> Callable[..., R]: ...


os.environ.setdefault("GOMP_SPINCOUNT", "0")  # a busy neighbour stretches p95 sixteenfold otherwise


def kernel_sources() -> Iterator[Path]:
    """The files that hold compiled loops, in a fixed order."""
    here = Path(__file__).parent
    yield from sorted(here.rglob("*kernels.py"))
    yield from sorted((here.parent / "alight_sim" / "kernels").glob("*.py"))


def _cache_dir() -> Path:
    digest = hashlib.sha256()
    for source in (Path(__file__), *kernel_sources()):
        digest.update(source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = root / "alight" / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # no home to write to: a kernel cache for this machine's lifetime
        folder = Path(tempfile.gettempdir()) / f"alight-kernels-{digest.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
    return folder


os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache_dir()))

import numba  # noqa: E402  (the environment must be set first)
from numba.core import event  # noqa: E402
from numba.core.registry import CPUDispatcher  # noqa: E402

# who imported numba before us has it caching beside the sources, by each file's own time: stale callers again
numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
if not numba.config.DISABLE_JIT:
    numba.config.THREADING_LAYER = "omp"  # two Python threads calling parallel kernels abort on `workqueue`

kernel: _Compile = numba.njit(cache=True, nogil=True, error_model="numpy")
parallel_kernel: _Compile = numba.njit(cache=True, nogil=True, parallel=True, error_model="numpy")
# for reductions to a minimum of numbers that are none of them NaN: any order gives the same bits
minimum_kernel: _Compile = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
# for sums of numbers that are none of them NaN: their order, and so their last bits, are the machine's. Inlined into
# the caller: a copy of its own, optimised once more or once less, made the compiling run differ from all later ones
sum_kernel: _Compile = numba.njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz", "reassoc", "contract"}, forceinline=True
)
inline: _Compile = numba.njit(cache=True, nogil=True, inline="always", error_model="numpy")
prange = numba.prange
# inside a loop over a row of pixels: inlined by LLVM before it vectorises (texture noise 27 -> 2.3 ns a sample)
pixelwise: _Compile = numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)


def use_threads(count: int) -> None:
    """Let compiled loops of this process use so many threads, no more than there were allowed at its start."""
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


def _stage_kernels() -> Iterator[Any]:
    """The compiled functions of all stages."""
    here = Path(__file__).parent
    for source in sorted(here.rglob("*kernels.py")):
        name = ".".join(("alight", *source.relative_to(here).with_suffix("").parts))
        for found in vars(importlib.import_module(name)).values():
            if isinstance(found, CPUDispatcher) and found.py_func.__module__ == name:
                yield found


def load_cached(parallel: bool) -> int:
    """Load every loop of the stages that is in the cache, for all the types it is there for; return how many.

    Args:
        parallel: those that use several threads; they start them, and a process with threads may not fork.
    """
    loaded = 0
    for loop in _stage_kernels():
        if bool(loop.targetoptions.get("parallel")) is not parallel:
            continue
        cache = loop._cache
        for key in cache._cache_file._load_index():
            if key == cache._index_key(key[0], loop.targetctx.codegen()):
                loop.compile(key[0])
                loaded += 1
    return loaded


def is_warm() -> bool:
    """Whether every loop of a run was compiled on this machine, of these sources."""
    return (Path(os.environ["NUMBA_CACHE_DIR"]) / "warm").exists()


def mark_warm() -> None:
    """Note that it was."""
    with suppress(OSError):
        (Path(os.environ["NUMBA_CACHE_DIR"]) / "warm").touch()


class CompilationListener(event.Listener):  # type: ignore[misc]
    """Notes the loops that this process compiles from now on."""

    def __init__(self) -> None:
        self.names: list[str] = []
        event.register("numba:compile", self)

    def on_start(self, event: Any) -> None:
        """A loop is being compiled."""
        self.names.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event: Any) -> None:
        """It is compiled."""
