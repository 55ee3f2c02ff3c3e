"""Which outcome a landing has, by the oracle: the true lander on the true ground.

A touchdown is judged wherever it happened. Without one, a landing that was given up is rightly refused if

- the wind or the battery was truly beyond its limit when the executive gave up for that reason, or
- the oracle finds no safe place, with the margin that the settings ask for, in the square that is searched,

and wrongly refused otherwise, also where the time or the search ended. Handed over is what the executive calls so.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from alight.records.campaign import STRIKE, Outcome, TouchdownLine
from alight.records.executive import FlightEvent, FlightState
from alight.runner.landing import Landing
from alight.settings import Settings
from alight_sim.oracle import OracleLander, safe_places
from alight_sim.steered import SteeredFlight, TrueContact
from alight_sim.steered.touchdown import contact_seconds, judge_contact, severity

STEP = 0.5  # m between the places that the oracle tries


class JudgedLanding(NamedTuple):
    """An outcome with its reason in words."""

    outcome: Outcome
    why: str
    touchdown: TouchdownLine | None = None
    safe_share: float | None = None


def judge_landing(
    vehicle: SteeredFlight, landing: Landing, settings: Settings, start: tuple[float, float]
) -> JudgedLanding:
    """Judge a landing that has ended.

    Args:
        vehicle: as the landing left it.
        landing: how it went.
        settings: those it was flown with.
        start: east, north, metres: the middle of the square that is searched.
    """
    if vehicle.contacts:
        return _touched(vehicle, landing.state, settings)
    last = landing.diary.transitions[-1] if landing.diary.transitions else None
    if landing.state is FlightState.HANDED_OVER:
        return JudgedLanding("handed over", last.reason if last else "")
    keys, event = settings.executive, None if last is None else last.event
    if event is FlightEvent.WIND and vehicle.wind_speed > keys.most_wind:
        return JudgedLanding("rightly refused", f"the wind is {vehicle.wind_speed:.1f} m/s")
    if event is FlightEvent.BATTERY and vehicle.battery < keys.least_battery:
        return JudgedLanding("rightly refused", f"the battery is at {100 * vehicle.battery:.0f} %")
    share = safe_share(vehicle, settings, start)
    said = last.event.value if last else "the time is over"
    if share == 0.0:
        return JudgedLanding("rightly refused", f"{said}; there is no safe place", safe_share=share)
    return JudgedLanding(
        "wrongly refused", f"{said}; {100 * share:.2g} % of the searched area is safe", safe_share=share
    )


def _touched(vehicle: SteeredFlight, state: FlightState, settings: Settings) -> JudgedLanding:
    """The worst of the contacts counts; one outside a landing is none that was meant."""
    found = [_line(vehicle, contact, settings) for contact in vehicle.contacts]
    worst = max(found, key=lambda d: severity(d.safe, d.reasons))
    if state is not FlightState.LANDED:
        return JudgedLanding("landed unsafely", f"it touched the ground and was then in {state.value}", worst)
    if STRIKE in worst.reasons:
        above = max(c.struck or 0.0 for c in vehicle.contacts)
        return JudgedLanding("landed unsafely", f"it struck what stands beside it, {above:.1f} m above its feet", worst)
    if worst.safe:
        return JudgedLanding("landed safely", "every limit is kept", worst)
    return JudgedLanding("landed unsafely", ", ".join(worst.reasons), worst)


def _line(vehicle: SteeredFlight, contact: TrueContact, settings: Settings) -> TouchdownLine:
    d = judge_contact(vehicle, contact, OracleLander.of(settings.lander.model_dump()))
    return TouchdownLine(
        t=contact_seconds(contact), east=d.east, north=d.north, safe=d.safe, reasons=d.reasons, tilt=d.tilt,
        roughness=d.roughness, sink=d.sink, drift=d.drift,
    )  # fmt: skip


def safe_share(vehicle: SteeredFlight, settings: Settings, start: tuple[float, float]) -> float:
    """Share of the searched square whose centres are safe with the margin, by the oracle."""
    half, (east, north) = 0.5 * settings.executive.search_side, start
    places = safe_places(
        vehicle.world, (east - half, north - half, east + half, north + half),
        OracleLander.of(settings.lander.model_dump()), step=STEP,
    )  # fmt: skip
    return float(np.mean(places.with_margin(settings.sites.margin)))
