"""How a steered flight met the ground, by the oracle."""

from __future__ import annotations

from alight_sim.flight import START_NS
from alight_sim.oracle import OracleLander, Touchdown, judge_touchdown
from alight_sim.steered.flight import SteeredFlight, TrueContact


def contact_seconds(contact: TrueContact) -> float:
    """Seconds of the flight."""
    return (contact.t_ns - START_NS) * 1e-9


def judge_contact(flight: SteeredFlight, contact: TrueContact, lander: OracleLander) -> Touchdown:
    """The verdict on a contact, with the bodies where they were just then."""
    return judge_touchdown(flight.world, lander, contact.pose, contact.velocity_world, contact_seconds(contact))
