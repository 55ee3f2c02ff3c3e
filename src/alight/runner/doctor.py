"""Facts about this machine and installation that a bug report needs: `alight doctor`."""

from __future__ import annotations

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from alight import __version__, compiled

EXTRAS = {  # what each extra is for
    "photos": "folders of photos", "heic": "photos of phones (HEIC)", "raw": "photos as DNG",
    "films": "telemetry in the tracks of a film, without ffmpeg", "logs": "logs of PX4 and ArduPilot beside frames",
    "fly": "an autopilot over MAVLink", "las": "point clouds (alight export --las)",
    "cluster": "several machines, by Dask", "notebooks": "rasters as xarray",
    "view": "flights in three dimensions (alight view)",
}  # fmt: skip
LINKS = ("ttyACM*", "ttyUSB*", "ttyAMA*", "ttyTHS*", "cu.usb*")  # files of serial links in /dev


def facts() -> Iterator[tuple[str, str]]:
    """Yield facts as (name, value): versions, processors, memory, disk, compiled loops, devices, missing extras."""
    yield "alight", f"{__version__}, in {Path(__file__).parents[1]}"
    yield "system", f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}"
    wanted = _wanted()
    yield "packages", _several(f"{name} {_version(name) or 'MISSING'}" for name in wanted.pop("", []))
    yield "processor", _processor()
    yield "threads", _threads()
    yield "memory", _memory()
    for name, folder in (("this folder", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        yield f"disk, {name}", f"{folder}: {_free(folder)}"
    yield "compiled loops", _loops()
    yield "cameras", _several(_cameras(Path("/dev"), Path("/sys/class/video4linux")))
    yield "serial links", _several(str(path) for name in LINKS for path in sorted(Path("/dev").glob(name)))
    yield "programs", _several(f"{name} {shutil.which(name) or 'not found'}" for name in ("ffmpeg", "exiftool"))
    for extra, names in wanted.items():
        missing = [name for name in names if not _version(name)]
        if extra in EXTRAS and missing:
            yield f"no extra {extra}", f"{EXTRAS[extra]}: pip install 'alight[{extra}]' ({', '.join(missing)})"


def _several(values: Iterable[str]) -> str:
    return ", ".join(values) or "none"


def _wanted() -> dict[str, list[str]]:
    """Return the names of the packages that Alight requires, by extra; those that it always needs under ''."""
    out: dict[str, list[str]] = {"": []}
    try:
        lines = requires("alight") or []
    except PackageNotFoundError:  # imported from a folder without being installed
        lines = []
    for line in lines:
        name, extra = re.match(r"[\w.-]+", line), re.search(r"extra == ['\"](\w+)['\"]", line)
        if name is not None:
            out.setdefault(extra[1] if extra else "", []).append(name[0])
    return out


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    try:
        found = re.search(r"^(?:model name|Model)\s*: (.*)$", Path("/proc/cpuinfo").read_text(errors="replace"), re.M)
    except OSError:
        found = None
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    name = found[1] if found else platform.processor() or "unknown"
    return f"{name}; {os.cpu_count()} cores, {usable} for this process; load {os.getloadavg()[0]:.1f}"


def _threads() -> str:
    import cv2

    given = [f"{k}={os.environ[k]}" for k in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS") if k in os.environ]
    return f"{compiled.most_threads()} for compiled loops, {cv2.getNumThreads()} for OpenCV; {_several(given)} set"


def _memory() -> str:
    page = os.sysconf("SC_PAGE_SIZE")
    total, free = (os.sysconf(name) * page for name in ("SC_PHYS_PAGES", "SC_AVPHYS_PAGES"))
    try:
        found = re.search(r"^MemAvailable:\s*(\d+) kB$", Path("/proc/meminfo").read_text(), re.M)
    except OSError:
        found = None
    return f"{(int(found[1]) << 10 if found else free) / 1e9:.1f} of {total / 1e9:.1f} GB free"


def _free(folder: Path) -> str:
    try:
        return f"{shutil.disk_usage(folder).free / 1e9:.1f} GB free"
    except OSError as e:
        return f"unknown ({e.strerror})"


def _loops() -> str:
    if compiled.CACHE is None:
        return "kept in memory only: each command compiles its loops anew"
    count = sum(1 for _ in compiled.CACHE.rglob("*.nbi"))
    rest = "all that a run needs" if compiled.is_warm() else "the others at their first use, or by alight warmup"
    return f"{count} in {compiled.CACHE} ({rest})"


def _cameras(devices: Path, about: Path) -> Iterator[str]:
    """Yield the cameras of this machine with their names, as `alight live` takes them."""
    for path in sorted(devices.glob("video[0-9]*")):
        try:
            name = (about / path.name / "name").read_text().strip()
        except OSError:
            name = "unnamed"
        yield f"camera:{path.name.removeprefix('video')} ({name})"
