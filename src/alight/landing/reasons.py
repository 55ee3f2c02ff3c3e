"""Reasons against a landing, in words."""

from __future__ import annotations

from alight.records import ElevationMap, Hazard, HazardMap
from alight.settings import Lander, SitesSettings

REASON_WORDS = {
    Hazard.ROUGHNESS: "is too rough",
    Hazard.SLOPE: "is too steep",
    Hazard.STEP: "has too high a step",
    Hazard.CLEARANCE: "leaves the rotor or the belly no room",
    Hazard.TERRAIN: "is covered by what cannot be landed on (water, plants, structures)",
    Hazard.TRAFFIC: "is where something moved a moment ago",
    Hazard.UNKNOWN: "has unknown ground within the footprint",
    Hazard.EDGE: "is too near to the map's edge",
    Hazard.DOUBT: "meets every limit, but not surely enough",
}


def why_no_site(hazards: HazardMap, elevation: ElevationMap, settings: SitesSettings, lander: Lander) -> str:
    """The reasons against a landing in one sentence, as shares of the ground that was seen; they may overlap."""
    seen, cell, hazards = elevation.trusted, hazards.grid.cell, hazards.on(elevation.grid)
    if not seen.any():
        return "no safe site: no ground was seen well enough to know its height"
    if ((hazards.reasons[seen] & Hazard.EDGE) != 0).all():
        return "no safe site: the map is smaller than the footprint"
    safe = seen & (hazards.reasons == 0)
    if safe.any():
        room = float(hazards.clearance[safe].max())
        return (
            f"no safe site: {safe.sum() / seen.sum():.1%} of the seen ground is safe, but the most room there is "
            f"{room:.2f} m and {settings.margin:.2f} m is wanted"
        )
    shares = {bit: float(((hazards.reasons[seen] & bit) != 0).mean()) for bit in REASON_WORDS}
    ranked = sorted((s, b) for b, s in shares.items() if s >= 0.005)[::-1]
    parts = [f"{100 * share:.0f} % {REASON_WORDS[bit]}" for share, bit in ranked]
    too_wide = f"; cells of {cell:g} m are wider than the radius of {lander.radius:g} m, so no plane fits"
    return "no safe site: of the seen ground " + ", ".join(parts) + (too_wide if lander.radius < cell else "")
