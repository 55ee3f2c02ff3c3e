"""Schedule of a live run, which writes it down so that a replay can repeat it."""

from __future__ import annotations

from dataclasses import dataclass

Spot = tuple[float, float]  # east, north, metres in the map's frame


@dataclass(frozen=True)
class Schedule:
    """Exposures of a flight that each lane used, by their stamps in ns; it left out the others because it was busy.

    A lane that was lost begins anew with an exposure: its state is gone, in a replay too.
    """

    tracked: tuple[int, ...] = ()  # exposures that the navigation lane took
    mapped: tuple[int, ...] = ()  # exposures that the mapping lane took
    effort: tuple[int, ...] = ()  # of the mapping lane for each of them: 0 full, higher numbers less
    judged: tuple[int, ...] = ()  # exposures whose map was judged
    about: tuple[Spot | None, ...] = ()  # the place that each of these maps showed too; None: none
    navigation_anew: tuple[int, ...] = ()  # exposures before which the navigation lane began anew
    mapping_anew: tuple[int, ...] = ()  # exposures before which the mapping lane began anew
