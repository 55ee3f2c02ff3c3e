"""A lock on a file, which the system releases in whatever way the process ends."""

from typing import IO, Any


def locked(file: IO[Any]) -> bool:
    """Lock an open file for this process until it is closed; return False if another process has locked it.

    Return True if files cannot be locked: on Windows, and on file systems without locks.
    """
    try:
        import fcntl  # not on Windows; a record lock: processes that are forked do not inherit it

        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except (ImportError, OSError):
        pass
    return True
