"""Wind by the lean, for a Copter that reports `WIND` of exactly 0 in any wind."""

from __future__ import annotations

import numpy as np
import pytest
from pilot_rig import PilotRig, flying

from alight.records.executive import FlightEvent, FlightState
from alight_sim.point_mass import FlightLimits, PointMass

S, E = FlightState, FlightEvent


def in_wind(east: float, north: float) -> PilotRig:
    body = PointMass(FlightLimits(lag=0.1), wind_world=np.array([east, north, 0.0]))
    r = flying(vehicle=body, height=30.0)
    r.sim.reports.measures_wind = False
    return r


@pytest.mark.parametrize("wind", [(0.0, 0.0), (5.0, -3.0)])
def test_wind_is_estimated_by_the_lean(wind: tuple[float, float]) -> None:
    """Its sigma is honest: the error is within three of it once legs in two directions were flown."""
    r = in_wind(*wind)
    r.run(25.0)
    found = r.pilot.inputs.wind_watch.estimate
    assert found.sigma < 1.5
    assert np.abs(found.wind - wind).max() < 3 * found.sigma
    assert r.view is not None
    assert r.view.situation.wind is not None
    assert any(line.startswith("autopilot: wind by the lean") for line in r.orders)


def test_wind_beyond_the_limit_ends_the_search() -> None:
    r = in_wind(10.0, 0.0)
    assert r.fly(S.RETURN, 60.0)
    assert r.events[-1] is E.WIND
