"""Cache folder of compiled loops: private to the user, else temporary.

Code in the cache runs with the user's rights. A folder that another user owns or can write to is therefore never read.
"""

import atexit
import logging
import os
import shutil
import stat
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path

log = logging.getLogger(__name__)

BROUGHT = Path(__file__).parent / "loops"  # compiled loops of a wheel made by `make ready`
NAMED = "NUMBA_CACHE_DIR"  # variable that names another folder; child processes inherit it
COST = "loops are compiled anew by this command, about 4 minutes"
THREADS = ("NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
MOST_THREADS = 16  # per processor; a larger number is a typing error, and no thread could be started


def is_private(folder: Path) -> bool:
    """Whether the folder belongs to this user, is not a link, and no other user can write to it."""
    try:
        about = folder.lstat()
    except OSError:
        return False
    own = not hasattr(os, "getuid") or about.st_uid == os.getuid()
    return stat.S_ISDIR(about.st_mode) and own and (os.name == "nt" or not about.st_mode & 0o022)


def is_writable(folder: Path) -> bool:
    """Whether a file can be created and filled in the folder."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))
            file.flush()
    except OSError:
        return False
    return True


def _usual(name: str) -> Path | None:
    """Return the folder of this name in the user's cache; None without a home folder.

    A new folder begins with the loops that the package brings.
    """
    given = os.environ.get("XDG_CACHE_HOME") or ""
    try:
        root = Path(given) if Path(given).is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # no HOME, and the system has no entry for the user
        return None
    folder = root / "alight" / name
    with suppress(OSError):
        if BROUGHT.is_dir() and not folder.exists():
            folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder.parent, ignore_cleanup_errors=True) as half:
                Path(shutil.copytree(BROUGHT, half, dirs_exist_ok=True)).rename(folder)  # whole, or not at all
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_private(folder):
            folder.chmod(0o700)
    return folder


def _temporary(source: Path | None) -> Path | None:
    """Create a private folder for this process and its children, with a copy of folder `source`; None on failure."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="alight-kernels-"))
    except OSError:
        return None
    atexit.register(_remove, folder, os.getpid())
    if source is not None:
        try:
            shutil.copytree(source, folder, dirs_exist_ok=True)
            folder.chmod(0o700)
        except (OSError, shutil.Error):
            shutil.rmtree(folder, ignore_errors=True)
            return _temporary(None)
    return folder


def _remove(folder: Path, maker: int) -> None:
    if os.getpid() == maker:
        shutil.rmtree(folder, ignore_errors=True)


def cache_folder(name: str) -> Path | None:
    """Return the folder that compiled loops are loaded from and saved in; None: loops are kept in memory only.

    A folder that is not private or not writable is replaced by a temporary folder. A warning names the cost.

    Args:
        name: name of the folder in the user's cache; it identifies the kernel sources.
    """
    named = os.environ.get(NAMED)
    folder = Path(named) if named else _usual(name)
    if named:
        with suppress(OSError):
            Path(named).mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder is not None and is_private(folder) and is_writable(folder):
        return folder
    where = "the home folder" if folder is None else str(folder)
    if folder is not None and is_private(folder):
        kept, why = _temporary(folder), "cannot be written; it is copied for this command, and new loops are not kept"
    else:
        there = folder is not None and folder.exists()
        why = f"{'is not yours alone' if there else 'cannot be made'}; {COST}"
        kept = _temporary(None)
    log.warning("%s: the cache of compiled loops %s; name a folder of your own with %s", where, why, NAMED)
    return kept


def mend_threads() -> None:
    """Remove thread counts from the environment that are not numbers or are too large for this machine.

    Also silence a warning: without a writable /dev/shm, numba warns of a lock that only concurrent imports need.
    """
    warnings.filterwarnings("ignore", message="Could not obtain multiprocessing lock")
    most = MOST_THREADS * (os.cpu_count() or 1)
    for name in THREADS:
        given = os.environ.get(name, "1")
        if not (given.isascii() and given.isdigit() and 1 <= int(given[:9]) <= most):
            del os.environ[name]
            log.warning("%s=%s: not a number from 1 to %d; all processors are used", name, given[:40], most)
