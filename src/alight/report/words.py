"""Numbers and names as text for the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from alight.records import Doubt, NearZone, NextView, RunResult, Site, p_safe_text

UNKNOWN = "unknown"

DOUBTS: Mapping[Doubt, str] = {
    "relief": "relief",
    "obstacle": "unseen obstacles",
    "ground": "kind of ground",
    "wires": "wires",
    "zone": "a zone to be avoided",
}


def metres(value: float) -> str:
    """Return a length as text: 4 cm, 32 cm, 6.3 m."""
    if not math.isfinite(value):
        return UNKNOWN
    if abs(value) < 0.0095:
        return f"{value * 100:.1f} cm"
    return f"{value * 100:.0f} cm" if abs(value) < 0.995 else f"{value:.1f} m"


def angle(value: float) -> str:
    """Return an angle in radians as text in degrees."""
    return f"{math.degrees(value):.1f}°" if math.isfinite(value) else UNKNOWN


def bearing(value: float) -> str:
    """Return a heading in radians as three figures in degrees."""
    return f"{round(math.degrees(value)) % 360:03d}°" if math.isfinite(value) else UNKNOWN


def percent(value: float) -> str:
    """Return a share in percent, never rounded up to 100 % nor down to 0 %."""
    if not math.isfinite(value):
        return UNKNOWN
    if 0 < value < 0.0005:
        return "< 0.1 %"
    if 0.9995 < value < 1:
        return "> 99.9 %"
    return f"{value * 100:.0f} %" if value in (0.0, 1.0) else f"{value * 100:.1f} %"


def near(it: NearZone) -> str:
    """Return what is nearest to a site, as "keep-out zone farm, 12.3 m, bearing 045°" or "in avoid zone road"."""
    if it.distance == 0.0:
        return f"in {it.label}"
    return f"{it.label}, {metres(it.distance)}, bearing {bearing(it.bearing)}"


def near_by(found: Sequence[NearZone]) -> str:
    """Return the road, car, person and building nearest to a site, by `near`."""
    return "; ".join(map(near, found))


def chance(probability: float) -> str:
    """Return a probability in percent, never as 100 %."""
    return "> 99.9 %" if probability > 0.9995 else percent(probability)


def seconds(value: float) -> str:
    """Return a duration as text: 76 µs, 4.2 ms, 1.25 s, 2 min 5 s."""
    if value < 0.9995e-3:
        return f"{value * 1e6:.0f} µs"
    if value < 0.9995:
        return f"{value * 1e3:.3g} ms"
    if value < 99.5:
        return f"{value:.3g} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest} s"


def probability(p: float) -> str:
    """Return a probability as text: 0.93, 0.987; never rounded up to 1."""
    if not math.isfinite(p):
        return UNKNOWN
    return f"{p:.2f}" if p < 0.985 else p_safe_text(p)


def factors(site: Site) -> str:
    """Return the factors of P(safe) as text, such as "relief 0.99, unseen obstacles 0.93, ground 1"."""
    smallest = f" (smallest that would be found: {metres(site.resolved)})" if math.isfinite(site.resolved) else ""
    ground = probability(site.p_ground) if math.isfinite(site.p_ground) else "not judged"
    return (
        f"relief {probability(site.p_relief)}, unseen obstacles {probability(site.p_obstacle)}{smallest}, "
        f"ground {ground}"
    )


def doubt(site: Site) -> str:
    """Return the name of the factor that limits P(safe)."""
    return UNKNOWN if site.doubt is None else DOUBTS[site.doubt]


def look_from(site: Site) -> str:
    """Return the height of the next view as text, such as "12 m above it"."""
    return "no nearer view settles it" if site.look is None else f"{site.look.height:.0f} m above it"


def counted(number: int, name: str) -> str:
    """Return a count with its noun in lower case: one candidate, three candidates, 12 candidates."""
    small = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")
    return f"{small[number] if number < len(small) else number} {name}{'s' * (number != 1)}"


def place(result: RunResult, at: Site | NextView) -> str:
    """Return the horizontal position of a site or view as text, geographic or relative to the origin."""
    if not result.georeferenced:
        ew, ns = ("east" if at.east >= 0 else "west"), ("north" if at.north >= 0 else "south")
        return f"{abs(at.east):.1f} m {ew}, {abs(at.north):.1f} m {ns} of the origin"
    latitude, longitude, _ = result.local.to_geodetic([at.east, at.north, at.up])
    ns, ew = ("N" if latitude >= 0 else "S"), ("E" if longitude >= 0 else "W")
    return f"{abs(float(latitude)):.6f}°\N{NO-BREAK SPACE}{ns}, {abs(float(longitude)):.6f}°\N{NO-BREAK SPACE}{ew}"


def altitude(result: RunResult, site: Site) -> str:
    """Return the height of a site as text: above the WGS84 ellipsoid or, without a place on Earth, above the origin."""
    up = result.local.to_geodetic([site.east, site.north, site.up])[2] if result.georeferenced else site.up
    return f"{float(up):.1f} m"


def geo_uri(result: RunResult, site: Site) -> str:
    """Return the position of a site as a `geo:` link for map programs; empty if its place on Earth is unknown."""
    if not result.georeferenced:
        return ""
    latitude, longitude, _ = result.local.to_geodetic([site.east, site.north, site.up])
    return f"geo:{float(latitude):.7f},{float(longitude):.7f}"


def name(key: str) -> str:
    """Return a key as words: `focal_px` as 'focal px'."""
    return key.replace("_", " ")


def value(thing: object) -> str:
    """Return a note's value as text: numbers with four figures, lists with commas, mappings with colons."""
    if isinstance(thing, Mapping):
        return ", ".join(f"{k}: {value(v)}" for k, v in thing.items())
    if isinstance(thing, (list, tuple, np.ndarray)):
        return ", ".join(value(v) for v in thing)
    if isinstance(thing, bool):
        return "yes" if thing else "no"
    if isinstance(thing, (float, np.floating)):
        return f"{float(thing):.4g}" if abs(float(thing)) < 1000 else f"{float(thing):.1f}"
    return str(thing)


def ground(name: str) -> str:
    """Return a class name as words: SHORT_GRASS as 'short grass'."""
    return name.lower().replace("_", " ")
