"""Digest of the program: which state of it computed a result."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

DIGITS = 16
PACKAGES = ("alight", "alight_sim")  # installed together; found by path, so that the simulator is not imported
PARTS = (".py", ".npz", ".yaml")  # of the program: code, fitted tables, built-in scenes


@cache
def sources_digest() -> str:
    """Digest of the program, so that landings of two states of it are not mixed."""
    digest = hashlib.sha256()
    for root in (Path(__file__).parents[1] / name for name in PACKAGES):
        for path in sorted(p for p in root.rglob("*") if p.suffix in PARTS):
            digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:DIGITS]
