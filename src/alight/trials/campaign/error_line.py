"""An unexpected error as one line of text."""

from __future__ import annotations

import traceback


def error_line(error: BaseException) -> str:
    """Return the kind of an error, its message and the place where it was raised, in one line."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}".split()) + where
