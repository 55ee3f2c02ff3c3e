"""A lock on a file, which the system releases however the process ends."""

from typing import IO, Any


def locked(file: IO[Any]) -> bool:
    """Take an open file for this process until it is closed; False: another process has it.

    True also where files cannot be locked: on Windows, and on file systems without locks.
    """
    try:
        import fcntl  # not on Windows; a record lock: processes that are forked do not inherit it

        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except (ImportError, OSError):
        pass
    return True
