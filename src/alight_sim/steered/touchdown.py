"""How a steered flight met the ground, by the oracle."""

from __future__ import annotations

from dataclasses import replace

from alight.records.campaign import STRIKE
from alight_sim.flight import START_NS
from alight_sim.oracle import OracleLander, Touchdown, judge_touchdown
from alight_sim.steered.flight import SteeredFlight, TrueContact


def contact_seconds(contact: TrueContact) -> float:
    """Seconds of the flight."""
    return (contact.t_ns - START_NS) * 1e-9


def judge_contact(flight: SteeredFlight, contact: TrueContact, lander: OracleLander) -> Touchdown:
    """The verdict on a contact, with the bodies where they were just then; what was struck in flight is unsafe."""
    found = judge_touchdown(flight.world, lander, contact.pose, contact.velocity_world, contact_seconds(contact))
    return found if contact.struck is None else replace(found, safe=False, reasons=(STRIKE,))


def severity(safe: bool, reasons: tuple[str, ...]) -> tuple[bool, bool, int]:
    """Rank a contact, worse is larger: unsafe, then what was struck, then how many limits it broke."""
    return not safe, STRIKE in reasons, len(reasons)


def judge_flight(flight: SteeredFlight, lander: OracleLander) -> Touchdown | None:
    """The verdict on the worst contact of a flight, else on its last; None: it met nothing."""
    found = [judge_contact(flight, contact, lander) for contact in flight.contacts]
    return max(found, key=lambda d: (severity(d.safe, d.reasons), d is found[-1]), default=None)
