"""Under a wire nothing lands, and a doubtful one lowers P(safe) (docs/method/wires.md)."""

from __future__ import annotations

import numpy as np
import pytest
from ground import ground

from alight.hazards import assess
from alight.hazards.wires import SLACK
from alight.landing.sites import choose_sites
from alight.records import Hazard, Wire
from alight.records.wires import BEYOND
from alight.settings import HazardsSettings, Lander, SitesSettings

MAP, LANDER = ground(np.zeros((200, 200)), sigma=0.01), Lander()
SETTINGS = HazardsSettings(smoothed=False)


def wire(chance: float) -> Wire:
    """Return a wire from (6, 10) to (14, 10), 7 m up."""
    return Wire(np.array([6.0, 10.0, 7.0]), np.array([14.0, 10.0, 7.0]), chance)


def at(values: np.ndarray, east: float, north: float) -> float:
    row, col = MAP.grid.index(east, north)
    return float(values[int(row), int(col)])


def test_a_wire_refuses_what_lies_under_it_and_beside_it() -> None:
    found = assess(MAP, None, LANDER, SETTINGS, wires=(wire(0.9),))
    reach = LANDER.reach + SLACK
    inside, outside = [(10, 10), (10, 10 + reach - 0.2), (14 + BEYOND, 10)], [(10, 10 + reach + 0.2), (10, 4)]
    assert [at(found.reasons, *p) for p in inside] == [Hazard.WIRE] * 3
    assert [at(found.p_safe, *p) for p in inside] == [0.0] * 3
    assert [at(found.reasons, *p) for p in outside] == [0, 0]


def test_a_doubtful_wire_lowers_p_and_is_the_doubt_of_the_candidates_under_it() -> None:
    bare, found = (assess(MAP, None, LANDER, SETTINGS, wires=w) for w in ((), (wire(0.3),)))
    assert at(found.p_safe, 10, 10) == pytest.approx(0.7 * at(bare.p_safe, 10, 10), rel=1e-5)
    assert at(found.reasons, 10, 10) == Hazard.DOUBT
    assert at(found.p_safe, 10, 4) == at(bare.p_safe, 10, 4)
    chosen = choose_sites(found, None, MAP, SitesSettings(), LANDER, None)
    assert {c.doubt for c in chosen.candidates} == {"wires"}
