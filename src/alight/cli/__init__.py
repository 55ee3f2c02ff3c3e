"""The command line: the only place that catches, prints and exits. Each file holds a group of commands."""

import os

# before NumPy is imported: with several threads the filter's small matrices only cause waiting
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

try:
    from alight.cli import exported as exported
    from alight.cli import flown as flown
    from alight.cli import recorded as recorded
    from alight.cli import shown as shown
    from alight.cli import simulated as simulated
    from alight.cli.app import call, main
except KeyboardInterrupt:  # Ctrl-C in the first second or two
    raise SystemExit(130) from None

__all__ = ["call", "main"]
