"""Sites and route as GeoJSON (RFC 7946); estimated body poses as TUM text for `evo`, and as CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from alight.arrays import F64
from alight.geometry import LocalFrame
from alight.records import Motion, NextView, PlaceSigma, Route, Site, Sites, Waypoint, Wire

COLUMNS = (
    "t_ns,east_m,north_m,up_m,q_w,q_x,q_y,q_z,v_e,v_n,v_u,"
    "sigma_e,sigma_n,sigma_u,sigma_roll,sigma_pitch,sigma_yaw,state,tracks"
)
UNENCODABLE = "backslashreplace"  # for file names that are not UTF-8: `\\udcff`, which JSON can read


def number(value: float, decimals: int) -> float | None:
    """Return a rounded number for JSON; None if it is not finite."""
    return round(float(value), decimals) if math.isfinite(value) else None


def degrees(angle: float, decimals: int = 2) -> float | None:
    """Return an angle in radians as rounded degrees; None if it is not finite."""
    return number(math.degrees(angle), decimals)


def heading_degrees(heading: float) -> float | None:
    """Return a heading in radians as degrees in [0, 360); None if it is not finite."""
    return number(math.degrees(heading) % 360.0, 1) if math.isfinite(heading) else None


def lon_lat_height(local: LocalFrame, east: float, north: float, up: float) -> list[float]:
    """Return a world position in GeoJSON's order: longitude, latitude (degrees), height above the ellipsoid (m)."""
    latitude, longitude, height = local.to_geodetic([east, north, up])
    return [round(float(longitude), 9), round(float(latitude), 9), round(float(height), 3)]


def site_properties(site: Site, look: Sequence[float | None] | None = None) -> dict[str, Any]:
    """Return properties of a site or candidate, as in docs/formats/outputs.md; `look`: position of its next view."""
    look_from = None if site.look is None else number(site.look.height, 2)
    of_candidates = {"doubt": site.doubt, "look": look, "look_from_m": look_from}
    return {
        "kind": site.kind,
        "rank": site.rank,
        "p_safe": number(site.p_safe, 5),
        "p_relief": number(site.p_relief, 5),
        "p_obstacle": number(site.p_obstacle, 5),
        "p_ground": number(site.p_ground, 5),
        "p_wires": number(site.p_wires, 5),
        "quality": number(site.quality, 5),
        "slope_deg": degrees(site.slope),
        "roughness_m": number(site.roughness, 4),
        "clearance_m": number(site.clearance, 3),
        "radius_m": number(site.radius, 3),
        "resolved_m": number(site.resolved, 3),
        "terrain": site.terrain.name.lower(),
        "heading_deg": heading_degrees(site.heading),
        "east_m": number(site.east, 3),
        "north_m": number(site.north, 3),
        "height_sigma_m": number(site.height_sigma, 4),
        **_near_properties(site),
        **(of_candidates if site.kind == "candidate" else {}),
    }


def _near_properties(site: Site) -> dict[str, Any]:
    out: dict[str, Any] = {} if site.zone is None else {"zone": site.zone.label}
    for near, kind in (*((n, n.kind) for n in site.near), *([(site.zone, "zone")] if site.zone else [])):
        out |= {f"{kind}_m": number(near.distance, 2), f"{kind}_deg": degrees(near.bearing, 1)}
    return out | ({"avoid": site.avoid} if site.avoid else {})


def _in_metres(site: Site) -> dict[str, Any]:
    """Return the properties of a site or candidate, with its height and next view in metres from the origin."""
    v = site.look
    look = None if v is None else [number(x, 3) for x in (v.east, v.north, v.up)]
    return site_properties(site, look) | {"up_m": number(site.up, 3)}


def answer_json(sites: Sites) -> dict[str, Any]:
    """Return the answer of run.json: numbers of sites and candidates, their properties, and the reason."""
    return {
        "counts": {"sites": len(sites.sites), "candidates": len(sites.candidates)},
        "sites": [_in_metres(s) for s in sites.sites],
        "candidates": [_in_metres(s) for s in sites.candidates],
        "reason": sites.reason,
        "ground_judged": sites.ground_judged,
    }


def feature(geometry: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    """Return one GeoJSON feature."""
    place = {"type": geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": place, "properties": properties}


def sites_geojson(sites: Sites, local: LocalFrame, covariance: F64 | None = None) -> dict[str, Any]:
    """Return sites and candidates in order of rank, as GeoJSON; if there is no site, it contains the reason.

    Args:
        covariance: (3, 3) m^2, east, north, up, of the whole map's position on Earth; None: unknown.
    """

    def place(of: Site | NextView) -> list[float]:
        return lon_lat_height(local, of.east, of.north, of.up)

    features = [
        feature("Point", place(s), site_properties(s, None if s.look is None else place(s.look))) for s in sites.listed
    ]
    tree = collection(features, sites)
    if covariance is not None:
        horizontal, vertical = (number(v, 3) for v in PlaceSigma.of(covariance))
        tree["accuracy"] = {"horizontal_m": horizontal, "vertical_m": vertical}
    return tree


def collection(features: list[dict[str, Any]], sites: Sites) -> dict[str, Any]:
    """Return a GeoJSON collection of features; if there is no site, it contains the reason."""
    none = {} if sites.sites else {"reason": sites.reason or "no site was found"}
    unjudged = {} if sites.ground_judged else {"ground_judged": False}
    return {"type": "FeatureCollection", "features": features, **unjudged, **none}


def _waypoint_properties(w: Waypoint) -> dict[str, Any]:
    return {
        "name": w.name,
        "t_s": number(w.t, 2),
        "speed_m_s": number(w.speed, 2),
        "heading_deg": heading_degrees(w.heading),
        "look": w.look,
    }


def route_geojson(route: Route, local: LocalFrame) -> dict[str, Any]:
    """Return the route as GeoJSON: one line with the time and speed of each vertex, then a point for each way-point."""
    positions = [lon_lat_height(local, *w.position_world) for w in route.waypoints]
    properties = [_waypoint_properties(w) for w in route.waypoints]
    line = {
        "times_s": [p["t_s"] for p in properties],
        "speeds_m_s": [p["speed_m_s"] for p in properties],
        "warnings": list(route.warnings),
    }
    points = [feature("Point", xyz, p) for xyz, p in zip(positions, properties, strict=True)]
    return {"type": "FeatureCollection", "features": [feature("LineString", positions, line), *points]}


def wires_geojson(wires: Sequence[Wire], local: LocalFrame) -> dict[str, Any]:
    """Return the wires over the ground as GeoJSON: a line each, with the height of both ends."""
    return {
        "type": "FeatureCollection",
        "features": [
            feature(
                "LineString",
                [lon_lat_height(local, *end) for end in (w.start, w.end)],
                {"p_wire": number(w.chance, 3), "length_m": number(w.length, 2)},
            )
            for w in wires
        ],
    }


def plain(thing: Any) -> Any:
    """Convert numbers, strings, lists, mappings and arrays to JSON types; a number that is not finite becomes None."""
    if isinstance(thing, Mapping):
        return {str(k): plain(v) for k, v in thing.items()}
    if isinstance(thing, (list, tuple, np.ndarray)):
        return [plain(v) for v in thing]
    if isinstance(thing, np.generic):
        return plain(thing.item())
    if isinstance(thing, float):
        return thing if math.isfinite(thing) else None
    return thing if isinstance(thing, (str, int, bool, type(None))) else str(thing)


def json_bytes(tree: Any) -> bytes:
    """Return strict JSON: UTF-8, without NaN, with a newline at the end."""
    text = json.dumps(tree, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode("utf-8", UNENCODABLE)


def tum_time(t_ns: int) -> str:
    """Return nanoseconds as text in seconds with nine decimals, which a float would lose."""
    sign, t = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{t // 10**9}.{t % 10**9:09d}"


def tum(motions: Sequence[Motion]) -> bytes:
    """Return poses as TUM text, one line per pose: t tx ty tz qx qy qz qw of world_from_body, s and ENU metres."""
    lines = ["# timestamp[s] tx ty tz[m, ENU] qx qy qz qw (world from body)"]
    for m in motions:
        w, x, y, z = m.world_from_body.quaternion
        e, n, u = m.world_from_body.translation
        lines.append(f"{tum_time(m.t_ns)} {e:.6f} {n:.6f} {u:.6f} {x:.9f} {y:.9f} {z:.9f} {w:.9f}")
    return ("\n".join(lines) + "\n").encode()


def attitude_sigma(m: Motion) -> F64:
    """Return 1-sigma of roll, pitch, yaw, (3,) rad: square roots of the covariance's diagonal in body axes."""
    R = m.world_from_body.rotation
    return np.sqrt(np.diag(R.T @ m.covariance[3:, 3:] @ R))


def _fields(values: F64 | None, decimals: int) -> list[str]:
    if values is None:
        return [""] * 3
    return [f"{v:.{decimals}f}" if np.isfinite(v) else "" for v in values]


def _row(m: Motion) -> str:
    return ",".join(
        [
            str(m.t_ns),
            *_fields(m.world_from_body.translation, 6),
            *(f"{q:.9f}" for q in m.world_from_body.quaternion),
            *_fields(m.velocity_world, 5),
            *_fields(np.sqrt(np.diag(m.covariance)[:3]), 5),
            *_fields(attitude_sigma(m), 7),
            m.state.name.lower(),
            str(m.tracks),
        ]
    )


def csv(motions: Sequence[Motion]) -> bytes:
    """Return motions as CSV, one row per pose, in SI units and radians; an empty field is unknown."""
    return ("\n".join([COLUMNS, *map(_row, motions)]) + "\n").encode()
