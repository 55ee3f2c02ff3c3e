"""Judgement of a steered flight's contacts by the oracle."""

from __future__ import annotations

from dataclasses import replace

from alight.records.campaign import STRIKE
from alight_sim.flight import START_NS
from alight_sim.oracle import OracleLander, Touchdown, judge_touchdown
from alight_sim.steered.flight import SteeredFlight
from alight_sim.steered.ground import TrueContact


def contact_seconds(contact: TrueContact) -> float:
    """Return the time of a contact, seconds of the flight."""
    return (contact.t_ns - START_NS) * 1e-9


def judge_contact(flight: SteeredFlight, contact: TrueContact, lander: OracleLander) -> Touchdown:
    """Judge a contact; cars and persons are placed where they were at that time. A collision in flight is unsafe."""
    found = judge_touchdown(
        flight.world, lander, contact.pose, contact.velocity_world, contact_seconds(contact), flight.bodies
    )
    return found if contact.struck is None else replace(found, safe=False, reasons=(STRIKE,))


def severity(safe: bool, reasons: tuple[str, ...]) -> tuple[bool, bool, int]:
    """Return a sort key that grows with severity: unsafe or not, a collision or not, number of `reasons`."""
    return not safe, STRIKE in reasons, len(reasons)


def judge_flight(flight: SteeredFlight, lander: OracleLander) -> Touchdown | None:
    """Judge the worst contact of a flight, the last one among equals; None: there was no contact."""
    found = [judge_contact(flight, contact, lander) for contact in flight.contacts]
    return max(found, key=lambda d: (severity(d.safe, d.reasons), d is found[-1]), default=None)
