"""Features of OpenStreetMap as zones: roads, railways, buildings, power lines and some land use, by their tags."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from alight.documents import parse_yaml, read_text
from alight.records.zones import Use, ZoneKind

GONE = ("tunnel", "covered", "indoor", "abandoned", "disused", "razed", "demolished", "proposed")
HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"\s*=>\s*"((?:[^"\\]|\\.)*)"')


class MapFeature(NamedTuple):
    """The zone that a feature becomes."""

    name: str
    use: Use
    reach: float = 0.0  # metres about a line
    floor: float = 0.0  # metres
    is_area: bool = False  # whether a closed line is the border of an area
    kind: ZoneKind = "zone"


def map_feature(properties: Mapping[str, Any]) -> MapFeature | None:
    """Return the zone of a feature by its tags; None: it is no zone.

    Tags are properties, the property `tags` (older exports), or the text `other_tags` (GDAL and QGIS).
    """
    tags = {k: str(v) for k, v in properties.items() if isinstance(v, str | int | float)}
    if isinstance(nested := properties.get("tags"), Mapping):
        tags |= {str(k): str(v) for k, v in nested.items()}
    tags |= HSTORE.findall(tags.get("other_tags", ""))
    if any(tags.get(gone, "no") != "no" for gone in GONE) or tags.get("location") == "underground":
        return None
    table, name = _table(), tags.get("name") or tags.get("ref") or ""
    for key, found in (("railway", _railway), ("building", _building), ("power", _power), ("highway", _highway)):
        if key in tags and (feature := found(tags, table)) is not None:
            kind = key if tags[key] == "yes" else f"{key} {tags[key]}"
            return feature._replace(name=f"{kind} {name}".strip())
    use = table["landuse"].get(tags.get("landuse"))
    return None if use is None else MapFeature(f"{tags['landuse']} {name}".strip(), use, is_area=True)


@cache
def _table() -> Any:
    return parse_yaml(read_text(Path(__file__).with_name("map_features.yaml")))


def _railway(tags: Mapping[str, str], table: Any) -> MapFeature | None:
    width = table["railway"].get(tags["railway"])
    return None if width is None else MapFeature("", "keep-out", 0.5 * width)


def _building(tags: Mapping[str, str], table: Any) -> MapFeature | None:
    return None if tags["building"] == "no" else MapFeature("", "keep-out", is_area=True, kind="building")


def _power(tags: Mapping[str, str], table: Any) -> MapFeature | None:
    if tags["power"] not in table["unknown_volts"]:
        return None
    volts = max((_number(v) or 0.0 for v in tags.get("voltage", "").split(";")), default=0.0)
    volts = volts or table["unknown_volts"][tags["power"]]
    row = next(row for row in table["power"] if volts <= row["volts"])
    return MapFeature("", "keep-out", row["half_width"], row["floor"])


def _highway(tags: Mapping[str, str], table: Any) -> MapFeature | None:
    width = table["highway"].get(tags["highway"])
    if width is None:
        return None
    lanes = table["lane"] * (_number(tags.get("lanes", "")) or 0.0)
    return MapFeature(
        "", "avoid", 0.5 * (_number(tags.get("width", "")) or max(width, lanes)), 0.0, tags.get("area") == "yes", "road"
    )


def _number(text: str) -> float | None:
    """Return the metres, volts or lanes at the begin of a tag, such as 7, 7.5 m or 7,5; None: there are none."""
    found = re.match(r"\s*(\d{1,7}(?:[.,]\d{1,3})?)\s*(m\b|$)", text)
    return float(found[1].replace(",", ".")) if found and float(found[1].replace(",", ".")) > 0.0 else None
