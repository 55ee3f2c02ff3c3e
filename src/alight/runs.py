"""Start and end of any run: its model of appearance, its home and its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from alight.landing.zones import MapZones
from alight.pipeline import Decision
from alight.records import NO_ZONES, Home, InputError, PhotoRow, RunResult, Telemetry
from alight.settings import Settings
from alight.sources import Described
from alight.terrain import Model

FARTHEST = 50_000.0  # metres from the site: no vehicle that looks for a site flies so far
STEEPEST = 1000.0  # metres above or below the site


def wanted_home(text: str | None, geoid: Path | None = None) -> Home | None:
    """Read the home that a user names; None: no home is named.

    Its separation is the user's number, else the value of a geoid grid, else NaN.

    Raises:
        InputError: the text is no home, the grid cannot be used, or there is a grid and no home.
    """
    if text is None:
        if geoid is not None:
            raise InputError(f"--geoid {geoid}: is for --home LAT,LON,ALT_MSL; give the home as well")
        return None
    home = Home.parse(text)
    if geoid is None or math.isfinite(home.separation):
        return home
    from alight.sources.geoid import separation_at

    return home.with_separation(separation_at(geoid, home.latitude, home.longitude))


def known_home(text: str | None, geoid: Path | None = None) -> Home | None:
    """Read the home for a recording, which gives no separation; see `wanted_home`.

    Raises:
        InputError: as for `wanted_home`, or the separation is missing.
    """
    home = wanted_home(text, geoid)
    if home is not None and not math.isfinite(home.separation):
        raise InputError(
            f"home {text!r}: is above the sea, and the map above the ellipsoid: add the SEPARATION there as a fourth "
            "number (GPS_RAW_INT: alt_ellipsoid minus alt; or a geoid calculator), or name a grid with --geoid"
        )
    return home


def flown_home(wanted: Home | None, telemetry: Telemetry | None, separation: float | None) -> Home | None:
    """Return the home of a vehicle on a link, with its separation (NaN: unknown); None: no home is known.

    Args:
        wanted: home that the user names; None: the autopilot's own home.
        telemetry: newest telemetry; None: not received.
        separation: ellipsoidal height minus altitude above the sea, metres, by the user; None: the receiver's.
    """
    reported = math.nan if telemetry is None else telemetry.gps.separation
    if wanted is None and telemetry is not None and (own := telemetry.home) is not None:
        wanted = Home(own.latitude, own.longitude, own.altitude_msl)
    if wanted is None:
        return None
    return wanted.with_separation(reported if separation is None else separation)


def with_home(result: RunResult, home: Home | None) -> RunResult:
    """Return the result with the home of its route; add a warning if the home is not used or is implausible."""
    if home is not None and (why := _of_no_use(result, home)):
        return replace(result, warnings=[*result.warnings, f"the home is not used: {why}"])
    if home is None or result.route is None or not result.route.waypoints:
        return replace(result, home=home)
    site = result.route.waypoints[-1].position_world
    east, north, up = result.local.to_enu(home.latitude, home.longitude, home.height)
    away, below = math.hypot(east - site[0], north - site[1]), float(site[2]) - float(up)
    if away > FARTHEST:
        where = f"{1e-3 * away:,.0f} km from the site"
    elif abs(below) > STEEPEST:
        where = f"{abs(below):,.0f} m {'below' if below > 0 else 'above'} the site"
    else:
        return replace(result, home=home)
    warning = f"route.plan: the home lies {where}; give LAT,LON,ALT_MSL of the place where the vehicle is armed"
    return replace(result, home=home, warnings=[*result.warnings, warning])


def _of_no_use(result: RunResult, home: Home) -> str:
    """Return the reason why heights cannot refer to the home; empty: they can."""
    if not result.georeferenced:
        return f"{result.source_name} has no place on Earth"
    if not math.isfinite(home.separation):
        return "the receiver does not report both heights; give --separation, metres from sea level to the ellipsoid"
    return ""


def zones_of(source: Described, settings: Settings, file: Path | None) -> MapZones | None:
    """Read the zones of a file for the world of a source; without a file, those of a recording; None: there are none.

    Raises:
        InputError: the file cannot be used, or the source has no place on Earth.
    """
    if file is None:
        kept = getattr(source, "zones", NO_ZONES)  # events of another program may come without
        return MapZones(kept, settings.lander.reach) if kept.zones else None
    from alight.sources.zones import read_zones

    zones = read_zones(file)
    if not source.georeferenced:
        raise InputError(f"--zones: {source.name} has no place on Earth; run it without")
    return MapZones(zones.in_world(source.local), settings.lander.reach)


def appearance_of(settings: Settings) -> Model | None:
    """Read the model of appearance that the settings name; None: the settings name no model.

    Raises:
        InputError: the file is not a model.
    """
    name = settings.terrain.model
    if name is None or not settings.terrain.enabled:
        return None
    from alight.sources.appearance import read_model

    return read_model(None if name == "default" else Path(name))


def result_of(
    source: Described,
    settings: Settings,
    d: Decision,
    timings: Mapping[str, Sequence[float]],
    photos: Sequence[PhotoRow] = (),
) -> RunResult:
    """Return a run's result for the output folder and the report, from the decision `d` on the whole run.

    `timings`: seconds of every step, by stage; `photos`: one row per photo, empty for a flight.
    """
    found: dict[str, Any] = vars(d) | {
        "notes": {**source.notes, **d.notes}, "warnings": [*source.warnings, *d.warnings],
    }  # fmt: skip
    return RunResult(
        source_name=source.name, source_kind=source.kind, local=source.local, georeferenced=source.georeferenced,
        settings=settings, cameras=[c.camera for c in source.rig.cameras], counts=source.counts, photos=photos,
        timings=timings, **found,
    )  # fmt: skip
