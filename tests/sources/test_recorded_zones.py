"""The zones of a recording: a replay has them without a file, and a file replaces them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from alight.geometry import LocalFrame
from alight.records import GroundZone, InputError, Rig, ZonesOnPlane
from alight.records.codec import FlightHead
from alight.runs import zones_of
from alight.settings import ImuNoise, Settings
from alight.sources import Source

ZONES = ZonesOnPlane(
    (
        GroundZone("school", "keep-out", shapely.box(0.1, 2.0, 30.0, 40.0), margin=2.0, floor=25.0, reason="children"),
        GroundZone("highway track", "avoid", shapely.LineString([(0, 0), (5, 7)]), reach=2.0, kind="road"),
    ),
    "farm.geojson: 1 keep-out, 1 avoid",
)


def head(zones: ZonesOnPlane) -> FlightHead:
    return FlightHead("flight", Rig(()), LocalFrame(47.0, 8.0, 400.0), True, ImuNoise(), Settings(), zones)


def test_zones_come_back_bit_for_bit() -> None:
    back = FlightHead.from_json(head(ZONES).to_json()).zones
    assert back.note == ZONES.note
    for a, b in zip(ZONES.zones, back.zones, strict=True):
        assert {**vars(a), "shape": None} == {**vars(b), "shape": None}
        np.testing.assert_array_equal(shapely.get_coordinates(a.shape), shapely.get_coordinates(b.shape))


def test_damaged_zones_are_a_damaged_head() -> None:
    text = head(ZONES).to_json().replace('"shape": "01', '"shape": "zz')
    with pytest.raises(InputError, match="head is damaged"):
        FlightHead.from_json(text)


def test_a_replay_has_the_zones_of_its_flight_unless_a_file_is_given(tmp_path: Path) -> None:
    class Recorded(Source):
        name, local, georeferenced, rig, zones = "flight", LocalFrame(47.0, 8.0, 400.0), True, Rig(()), ZONES

        def events(self):  # type: ignore[no-untyped-def]
            return iter(())

    kept = zones_of(Recorded(), Settings(), None)
    assert kept is not None
    assert [z.name for z in kept.plane.zones] == ["school", "highway track"]
    other = tmp_path / "other.geojson"
    other.write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"alight": "avoid", "name": "B"},'
        ' "geometry": {"type": "Polygon", "coordinates": [[[8, 47], [8.001, 47], [8, 47.001], [8, 47]]]}}]}'
    )
    given = zones_of(Recorded(), Settings(), other)
    assert given is not None
    assert [z.name for z in given.plane.zones] == ["B"]
