"""The schedule of a live run as it grows."""

from __future__ import annotations

from collections import deque
from typing import Any

from alight.arrays import F64
from alight.flight.live.interface import Diary
from alight.records import Schedule
from alight.records.schedule import Spot


class ScheduleLog:
    """Keeps the last exposures that each lane used, and writes every one into the diary. A lane calls its own methods.

    Args:
        most: entries of a kind that are kept; None: all of them.
        diary: log of the run.
    """

    def __init__(self, most: int | None, diary: Diary) -> None:
        self._diary = diary
        self._kinds = {k: deque[Any](maxlen=most) for k in Schedule.__dataclass_fields__}

    @property
    def schedule(self) -> Schedule:
        """The entries so far."""
        return Schedule(**{k: tuple(v) for k, v in self._kinds.items()})

    def anew(self, lane: str, t_ns: int) -> None:
        """Note that a lane, `navigation` or `mapping`, began anew before an exposure."""
        self._entry(f"{lane}_anew", t_ns)

    def tracked(self, t_ns: int) -> None:
        """Note that the navigation lane used an exposure."""
        self._entry("tracked", t_ns)

    def mapped(self, t_ns: int, effort: int) -> None:
        """Note that the mapping lane used an exposure with an effort: 0 all of it, higher numbers less."""
        self._entry("mapped", t_ns, effort)
        self._kinds["effort"].append(effort)

    def judged(self, t_ns: int, about: F64 | None) -> None:
        """Note a judged map: its newest exposure, and the place (2,) that it is about, metres in the map's frame."""
        place = None if about is None else (float(about[0]), float(about[1]))
        self._entry("judged", t_ns, about=place)
        self._kinds["about"].append(place)

    def _entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        self._kinds[kind].append(t_ns)
        self._diary.entry(kind, t_ns, value, about)
