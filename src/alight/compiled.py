"""The package's only import of Numba: cache location, threading layer, processor and the `kernel` decorators.

Numba keys its cache by each file alone, so a changed helper in another file leaves stale callers. The cache folder is
therefore named by a hash of all kernel sources: the files `*kernels.py` of the stages, and those of the simulator,
which come in the same wheel. Nothing in it depends on where the package or the folder lies.

Loops are compiled for x86-64-v3 on every processor that has it: all such machines compute the same bits, and a wheel
can bring the loops (`make ready`).
"""

import hashlib
import importlib
import logging
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Protocol, TypeVar, cast

from alight.file_lock import locked
from alight.loop_cache import NAMED, cache_folder, mend_threads

R = TypeVar("R")

log = logging.getLogger(__name__)
_DIGEST = hashlib.sha256().digest_size
V3 = {"avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"}  # what x86-64-v3 has beyond older processors
LONGEST_TURN, _LOOK_AGAIN = 60.0, 0.01  # s: longest wait for another process, time between tries


class _Compile(Protocol):
    """Decorator that compiles a function; the compiler, not the annotations, decides which arguments it accepts."""

    def __call__(self, function: Callable[..., R]) -> Callable[..., R]: ...


os.environ.setdefault("GOMP_SPINCOUNT", "0")  # spinning makes p95 sixteen times as long on a busy machine


def kernel_sources() -> Iterator[Path]:
    """Yield the files that hold compiled loops, in a fixed order."""
    here = Path(__file__).parent
    yield from sorted(here.rglob("*kernels.py"))
    yield from sorted((here.parent / "alight_sim" / "kernels").glob("*.py"))


def _sources_digest() -> str:
    digest = hashlib.sha256()
    for source in (Path(__file__), *kernel_sources()):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


SOURCES = _sources_digest()
CACHE = cache_folder(f"kernels-{SOURCES}")  # None: loops are kept in memory only
if CACHE is not None:
    os.environ[NAMED] = str(CACHE)  # for child processes as well
mend_threads()

import numba  # noqa: E402  (the environment must be set first)
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name  # noqa: E402
from numba.core import event, sigutils  # noqa: E402
from numba.core.caching import (  # noqa: E402
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)
from numba.core.registry import CPUDispatcher  # noqa: E402

# needed if numba was imported before this module: it would cache next to the sources and leave stale callers
numba.config.CACHE_DIR = str(CACHE or "")
numba.config.CACHE_LOCATOR_CLASSES = ""  # of the environment: they would be used instead of `_Locator`
if numba.config.CPU_NAME is None and {name for name, has in get_host_cpu_features().items() if has} >= V3:
    numba.config.CPU_NAME, numba.config.CPU_FEATURES = "x86-64-v3", ""
if not numba.config.DISABLE_JIT:
    numba.config.THREADING_LAYER = "omp"  # two Python threads calling parallel kernels abort on `workqueue`


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Cache files of one loop, each compiled form with a digest; a damaged file is treated as missing."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except Exception:  # damaged bytes can make pickle raise any exception
            return {}

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        digest, data = content[:_DIGEST], content[_DIGEST:]
        if hashlib.sha256(data).digest() != digest:
            raise OSError(f"{name}: damaged")  # the compiler treats this as a missing file
        return pickle.loads(data)

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(content).digest() + content)


class _Turns(event.Listener):  # type: ignore[misc]
    """Locks of the loops that this process is compiling, innermost last; other processes wait instead of compiling too.

    A lock covers all forms of a loop. The forms share one index file, so two writers would lose forms. Two processes
    never wait for each other: the holder of a lock waits only for loops that its own loop calls. Numba's own lock lets
    one thread of a process compile at a time.
    """

    def __init__(self) -> None:
        self._held: list[IO[bytes] | None] = []
        event.register("numba:compile", self)

    def take(self, path: Path) -> None:
        """Wait for the lock of a loop, `LONGEST_TURN` at most; its previous holder may have compiled the loop."""
        file, end = None, time.monotonic() + LONGEST_TURN
        with suppress(OSError):  # the folder cannot be written
            file = path.open("wb")
            while not locked(file) and time.monotonic() < end:
                time.sleep(_LOOK_AGAIN)
        self._held.append(file)

    def leave(self) -> None:
        """Release the lock of the innermost loop."""
        if self._held and (file := self._held.pop()) is not None:
            file.close()

    def on_start(self, event: Any) -> None:
        """Do nothing: the lock was taken when the loop was not found in the cache."""

    def on_end(self, event: Any) -> None:
        """Release the lock of a loop whose compilation failed, as it will not be saved."""
        if any(getattr(event, "_exc_details", None) or ()):  # `is_failed` is False for every event that has ended
            self.leave()


_turns = _Turns()


class _Locator(UserProvidedCacheLocator):  # type: ignore[misc]
    """Place of a loop in the cache folder, wherever the package lies."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the folder of a source file relative to the package; for another file, a name of Numba's."""
        folder, packages = Path(py_file).parent, Path(__file__).parents[1]
        own = folder.is_relative_to(packages)
        return str(folder.relative_to(packages)) if own else str(super().get_suitable_cache_subpath(py_file))

    def get_source_stamp(self) -> tuple[str, Any]:
        """Return the hash of the sources of all loops, and Numba's of the file."""
        return SOURCES, super().get_source_stamp()


class _Found(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)  # no fallback to a folder in the package


class _Cache(FunctionCache):  # type: ignore[misc]
    """Compiled forms of one loop on disk; a full or read-only disk slows down later runs but raises nothing."""

    _impl_class = _Found
    _cache_file: Any

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        own = self._cache_file
        self._cache_file = _CheckedFile(own._cache_path, self._impl.filename_base, own._source_stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled form; None: this process then holds the lock, and must compile the loop."""
        found = super().load_overload(sig, target_context)
        if found is None:
            _turns.take(Path(self._cache_file._index_path).with_suffix(".turn"))
            found = super().load_overload(sig, target_context)
            if found is not None:
                _turns.leave()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled form, if the disk allows it, and release the lock."""
        try:
            super().save_overload(sig, data)
        except OSError as e:
            log.info("%s: a compiled loop is not kept (%s)", CACHE, e.strerror)
        finally:
            _turns.leave()


def _compiler(**options: Any) -> _Compile:
    """Return a decorator that compiles with these options and keeps the result in the cache."""

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        loop: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
        if CACHE is not None and not numba.config.DISABLE_JIT:
            with suppress(RuntimeError):  # the folder was removed in the meantime
                loop._cache = _Cache(function)
        return cast(Callable[..., R], loop)

    return decorate


kernel: _Compile = _compiler()
parallel_kernel: _Compile = _compiler(parallel=True)
# for minima of values without NaN: any order gives the same bits
minimum_kernel: _Compile = _compiler(fastmath={"nnan", "nsz", "reassoc"})
# for sums of values without NaN: their order, and so their last bits, depend on the machine. Inlined into the caller:
# a separate copy, optimised once more or less, made the run that compiles differ from all later runs
sum_kernel: _Compile = _compiler(fastmath={"nnan", "nsz", "reassoc", "contract"}, forceinline=True)
inline: _Compile = _compiler(inline="always")
prange = numba.prange
# inside a loop over a row of pixels: inlined by LLVM before it vectorises (texture noise 27 -> 2.3 ns per sample)
pixelwise: _Compile = _compiler(forceinline=True)


def most_threads() -> int:
    """Return the number of threads that this process may use: all of the machine, or the user's limit."""
    return int(numba.config.NUMBA_NUM_THREADS)


def use_threads(count: int) -> None:
    """Set the number of threads for compiled loops that this thread calls, limited to `most_threads()`."""
    numba.set_num_threads(min(count, most_threads()))


def _stage_kernels() -> Iterator[Any]:
    """Yield the compiled functions of all stages."""
    here = Path(__file__).parent
    for source in sorted(here.rglob("*kernels.py")):
        name = ".".join(("alight", *source.relative_to(here).with_suffix("").parts))
        for found in vars(importlib.import_module(name)).values():
            if isinstance(found, CPUDispatcher) and found.py_func.__module__ == name:
                yield found


def load_cached(parallel: bool) -> int:
    """Load all cached forms of the stages' loops; return the number of forms loaded.

    Args:
        parallel: whether to load the loops with several threads or the loops with one. Parallel loops start threads,
            and a process with threads must not fork.
    """
    loaded = 0
    for loop in _stage_kernels():
        if bool(loop.targetoptions.get("parallel")) is not parallel:
            continue
        cache = loop._cache
        if not isinstance(cache, _Cache):
            continue
        for key in cache._cache_file._load_index():
            if key == cache._index_key(key[0], loop.targetctx.codegen()):
                loop.compile(key[0])
                loaded += 1
    return loaded


def compile_form(loop: Any, types: str) -> None:
    """Compile a form of a loop, or load it from the cache; `types`: of its arguments, as the compiler prints them."""
    loop.compile(sigutils.normalize_signature(types)[0])  # the cache keeps a form by its types, not by their text


def _mark(folder: Path, use: str) -> Path:
    """Return the file that marks the loops of `use` as compiled by this Python and Numba, for this processor."""
    processor = numba.config.CPU_NAME or get_host_cpu_name()
    return folder / f"warm-{use}-{sys.implementation.cache_tag}-{numba.__version__}-{processor}-{SOURCES}"


def is_warm(use: str = "flight") -> bool:
    """Whether the loops of a kind of run (`loop_forms.Use`) were compiled for this machine, from these sources."""
    return CACHE is not None and _mark(CACHE, use).exists()


def mark_warm(use: str = "flight") -> None:
    """Record that the loops of a kind of run were compiled for this machine, from these sources."""
    if CACHE is not None:
        with suppress(OSError):
            _mark(CACHE, use).touch()


class CompilationListener(event.Listener):  # type: ignore[misc]
    """Recorder of the names of the loops that this process compiles from now on."""

    def __init__(self) -> None:
        self.names: list[str] = []
        event.register("numba:compile", self)

    def on_start(self, event: Any) -> None:
        """Record the name of the loop that is being compiled."""
        self.names.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event: Any) -> None:
        """Do nothing."""
