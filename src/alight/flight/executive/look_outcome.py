"""The event of a look: the place is confirmed, looked at from lower down, or left for a better one."""

from __future__ import annotations

from alight.flight.executive.opinion import Opinion, Standing
from alight.records import Site, p_safe_text
from alight.records.executive import FlightEvent
from alight.settings import ExecutiveSettings

E = FlightEvent
ABOUT = 1.05  # a look from up to this factor of a height counts as one from there


def look_outcome(
    said: Opinion, height: float, better: Site | None, keys: ExecutiveSettings
) -> tuple[FlightEvent, str] | None:
    """Return the event of a look and its reason; None: the place is refused, or in doubt from the lowest look.

    Args:
        said: opinion on the place, from the end of the look.
        height: of the look, metres above the place.
        better: a place elsewhere for which one in doubt is left.
        keys: heights of the looks.
    """
    seen_from = f"P(safe) {p_safe_text(said.p_safe)} from {height:.1f} m"
    candidate, lowest = said.standing is Standing.CANDIDATE, height <= keys.commit_height * ABOUT
    if candidate and better is not None:
        return E.REFUSED, f"{seen_from}, and {p_safe_text(better.p_safe)} elsewhere"
    if said.standing is Standing.SITE and lowest:
        return E.CONFIRMED, seen_from
    if said.standing in (Standing.SITE, Standing.CANDIDATE) and not lowest:
        return E.LOWER, f"{said.standing.value}, {seen_from}"
    if candidate and height > keys.nearest * ABOUT:
        return E.LOWER, f"in doubt, {seen_from}"
    return None
