"""Roads, cars, people and buildings as zones: sites keep out of them, name them, and P(safe) stays."""

from __future__ import annotations

import numpy as np
import shapely
from ground import ground, land_cover
from numpy.typing import NDArray

from alight.hazards import assess
from alight.landing.sites import choose_sites
from alight.landing.third_party import third_parties
from alight.landing.zones import MapZones
from alight.outputs.vectors import site_properties
from alight.records import NO_ZONES, GroundZone, Hazard, HazardMap, Sites, Terrain, TerrainMap, ZonesOnPlane
from alight.settings import HazardsSettings, Lander, SitesSettings

LANDER, MARGIN = Lander(radius=1.0), 1.0
FLAT = ground(np.zeros((101, 151)), sigma=0.01)  # 15 m to the east, 10 m to the north
NOWHERE = np.zeros(FLAT.grid.shape, np.bool_)
EAST, NORTH = np.meshgrid(*FLAT.grid.xy())


def cover(road: NDArray[np.bool_] = NOWHERE, car: NDArray[np.bool_] = NOWHERE) -> TerrainMap:
    label = np.full(FLAT.grid.shape, Terrain.PAVED, np.uint8)
    return land_cover(FLAT.grid, label, np.ones(FLAT.grid.shape, np.float32), road=road, car=car)


def judged(
    land: TerrainMap, came: NDArray[np.bool_] = NOWHERE, given: ZonesOnPlane = NO_ZONES
) -> tuple[HazardMap, HazardMap, Sites]:
    """The hazards of the shape alone, those with third parties, and the sites."""
    before = assess(FLAT, None, LANDER, HazardsSettings(tilt_sigma=0.0, smoothed=False))
    limits = MapZones(given, LANDER.reach, third_parties(land, FLAT.grid, came, MARGIN))
    found = limits.judged(before)
    return before, found, limits.named(choose_sites(found, None, FLAT, SitesSettings(), LANDER))


def test_a_road_is_left_to_the_last_and_the_chance_to_stand_stays() -> None:
    before, found, sites = judged(cover(road=EAST < 8.0))
    np.testing.assert_array_equal(before.p_safe, found.p_safe)
    assert all(s.east > 8.0 + LANDER.reach - 0.1 for s in sites.sites)
    assert {c.avoid for c in sites.candidates} <= {"road"}
    assert sites.sites[0].near[0].kind == "road"
    properties = site_properties(sites.sites[0])
    assert properties["road_m"] == round(sites.sites[0].near[0].distance, 2)
    assert 250.0 < properties["road_deg"] < 290.0
    assert "zone_m" not in properties


def test_a_road_is_a_site_where_nothing_else_is() -> None:
    _, _, sites = judged(cover(road=~NOWHERE))
    assert {s.avoid for s in sites.sites} == {"road"}


def test_the_disc_keeps_the_margin_from_cars_and_people() -> None:
    car, person = np.hypot(EAST - 3, NORTH - 5) < 1.0, np.hypot(EAST - 12, NORTH - 5) < 0.4
    _, found, sites = judged(cover(car=car), person)
    refused = (found.reasons & Hazard.ZONE) != 0
    for where in (car, person):
        away = shapely.distance(shapely.MultiPoint(np.c_[EAST[where], NORTH[where]]), shapely.points(EAST, NORTH))
        assert refused[away < LANDER.reach + MARGIN - 0.1].all()
    assert {n.kind for s in sites.listed for n in s.near} == {"car", "person"}
    assert list(found.zones_behind(Hazard.ZONE)) == ["car", "person"]


def test_a_users_road_counts_as_a_road_too() -> None:
    given = GroundZone("highway service", "avoid", shapely.LineString([(2, 0), (2, 10)]), 1.0, kind="road")
    _, _, sites = judged(cover(road=EAST > 14.0), given=ZonesOnPlane((given,)))
    site = min(sites.sites, key=lambda s: s.east)
    assert site.near[0].label == "avoid zone highway service"
    assert site.zone is not None
    assert site.zone.kind == "road"
