"""Digests of the files that a campaign reads, on which it depends besides the program, seed and settings."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from alight.program import DIGITS
from alight.records import InputError
from alight.settings import Settings
from alight.trials.campaign.factories import is_factory, source_of
from alight_sim.campaign import campaign_worlds
from alight_sim.scene import built_in, read_scene


def file_digests(scenes: Sequence[str], settings: Settings) -> dict[str, str]:
    """Digests of scene files with their rasters, of factories' modules, and of the model of appearance, by name.

    Raises:
        InputError: one cannot be read.
    """
    named = [source_of(s) for s in scenes if is_factory(s)]
    files = [Path(s) for s in scenes if s not in {*campaign_worlds(), *built_in()} and not is_factory(s)]
    named += [path for scene in files for path in (scene, *_paths(read_scene(scene).model_dump()))]
    model = settings.terrain.model
    if model is not None and model != "default" and settings.terrain.enabled:
        named.append(Path(model))
    try:
        return {str(p): hashlib.sha256(p.read_bytes()).hexdigest()[:DIGITS] for p in named if p.is_file()}
    except OSError as e:
        raise InputError(f"{e.filename}: cannot be read ({e.strerror})") from e


def _paths(tree: Any) -> Iterator[Path]:
    """All paths in a tree of plain values."""
    if isinstance(tree, Path):
        yield tree
    for part in tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list | tuple) else ():
        yield from _paths(part)
