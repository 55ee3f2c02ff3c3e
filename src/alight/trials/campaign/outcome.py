"""Outcome of a landing, by the oracle: the true lander on the true ground.

A contact is judged wherever it happened, and is unsafe where no landing was intended. Without a contact, a landing that
was given up is rightly refused if

- the wind or the battery was truly beyond its limit when the executive gave up for that reason, or
- the oracle finds no safe location, with the margin of the settings, in the searched square,

and otherwise wrongly refused, also if the time or the search ended. `handed over` is by the executive's decision alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from alight.records import Terrain
from alight.records.campaign import Outcome, StrikeLine, TouchdownLine
from alight.records.executive import FlightEvent, FlightState
from alight.report.canvas import webp
from alight.report.paint import TERRAIN_COLOURS, hillshade, rgb
from alight.settings import Settings
from alight.trials.landing import Landing
from alight_sim.movers import Moving
from alight_sim.oracle import OracleLander, TrueSurface, judge_touchdown, safe_places
from alight_sim.steered import SteeredFlight, TrueContact
from alight_sim.steered.touchdown import contact_seconds, severity
from alight_sim.world import World

Contacts = tuple[TouchdownLine | None, StrikeLine | None]  # the worst touchdown, and the highest strike


class JudgedLanding(NamedTuple):
    """The outcome of a landing, with its reason in words."""

    outcome: Outcome
    why: str
    touchdown: TouchdownLine | None = None
    strike: StrikeLine | None = None
    safe_share: float | None = None  # of the searched square, by the oracle; None: not needed


def judge_landing(vehicle: SteeredFlight, landing: Landing, settings: Settings) -> JudgedLanding:
    """Judge a landing that has ended, and return its outcome.

    Args:
        vehicle: the vehicle after the landing.
        landing: end and diary of the landing.
        settings: settings of the landing.
    """
    if vehicle.contacts:
        return _touched(vehicle, landing, settings)
    last = landing.diary.transitions[-1] if landing.diary.transitions else None
    if landing.state is FlightState.HANDED_OVER:
        return JudgedLanding("handed over", last.reason if last else "")
    keys, event = settings.executive, None if last is None else last.event
    if event is FlightEvent.WIND and vehicle.wind_speed > keys.most_wind:
        return JudgedLanding("rightly refused", f"the wind is {vehicle.wind_speed:.1f} m/s")
    if event is FlightEvent.BATTERY and vehicle.battery < keys.least_battery:
        return JudgedLanding("rightly refused", f"the battery is at {100 * vehicle.battery:.0f} %")
    share = safe_share(vehicle.world, settings)
    why = last.event.value if last else "the time is over"
    if share == 0.0:
        return JudgedLanding("rightly refused", f"{why}; there is no safe place", safe_share=share)
    return JudgedLanding(
        "wrongly refused", f"{why}; {100 * share:.2g} % of the searched area is safe", safe_share=share
    )


def met(vehicle: SteeredFlight, settings: Settings, begun: float = -math.inf) -> Contacts:
    """Judge all contacts of a flight; return the worst touchdown, and the highest strike.

    Args:
        vehicle: the vehicle after its flight.
        settings: settings of the flight.
        begun: start of the landing, s; strikes after it take precedence over earlier strikes.
    """
    down = [_line(vehicle, c, settings) for c in vehicle.contacts if c.struck is None]
    struck = [
        StrikeLine(t=contact_seconds(c), east=c.pose.translation[0], north=c.pose.translation[1], above=c.struck)
        for c in vehicle.contacts
        if c.struck is not None
    ]
    return (
        max(down, key=lambda d: severity(d.safe, d.reasons), default=None),
        max(struck, key=lambda s: (s.t >= begun, s.above), default=None),
    )


def _touched(vehicle: SteeredFlight, landing: Landing, settings: Settings) -> JudgedLanding:
    """Judge a landing with contacts: a contact that was not intended, or a strike, makes it unsafe."""
    begun = max((x.t for x in landing.diary.transitions if x.after is FlightState.COMMIT), default=-math.inf)
    worst, strike = met(vehicle, settings, begun)
    early = min((contact_seconds(c) for c in vehicle.contacts if c.struck is None), default=math.inf)
    if strike is not None:
        why = f"it struck what stands beside it, {strike.above:.1f} m above its feet"
    elif landing.state is not FlightState.LANDED:
        why = f"it touched the ground and was then in {landing.state.value}"
    elif early < begun:
        why = f"it touched the ground at {early:.1f} s, and its landing was begun at {begun:.1f} s"
    elif worst is None or worst.safe:
        return JudgedLanding("landed safely", "every limit is kept", worst)
    else:
        why = ", ".join(worst.reasons)
    return JudgedLanding("landed unsafely", why, worst, strike)


def _line(vehicle: SteeredFlight, contact: TrueContact, settings: Settings) -> TouchdownLine:
    lander, t = OracleLander.of(settings.lander.model_dump()), contact_seconds(contact)
    d = judge_touchdown(vehicle.world, lander, contact.pose, contact.velocity_world, t, vehicle.bodies)
    return TouchdownLine(
        t=t, east=d.east, north=d.north, safe=d.safe, reasons=d.reasons, tilt=d.tilt, roughness=d.roughness,
        sink=d.sink, drift=d.drift,
    )  # fmt: skip


def safe_share(world: World, settings: Settings) -> float:
    """Return the share of the searched square in which a touchdown is safe with the margin, by the oracle."""
    margin, (east, north, _) = settings.sites.margin, world.start
    half = 0.5 * settings.executive.search_side
    lander, share = OracleLander.of(settings.lander.model_dump()), 0.0
    for step in (0.5, 0.25):  # metres between tried locations; the finer step only if no location is safe
        rim = math.ceil(margin / step) * step  # the true ground beyond the square exists as well
        out = half + rim
        places = safe_places(world, (east - out, north - out, east + out, north + out), lander, step=step)
        k, whole = round(rim / step), places.with_margin(margin)
        share = float(np.mean(whole[k : whole.shape[0] - k, k : whole.shape[1] - k]))
        if share > 0.0 or not places.safe.any():  # a margin of half a metre holds a centre of the coarse grid
            break
    return share


def ground_picture(
    world: World, contact: TouchdownLine | StrikeLine, radius: float, bodies: Sequence[Moving] = ()
) -> bytes:
    """Return a WebP picture of a contact, north up: classes by colour, shaded relief, the footprint as a ring.

    Args:
        world: the ground, and the moving objects on it.
        contact: location and time of the contact.
        radius: radius of the footprint, metres.
        bodies: moving objects that came on command.
    """
    pixels, half, e, n = 480, 4.0 * radius, contact.east, contact.north
    surface = TrueSurface.of(world, (e - half, n - half, e + half, n + half), contact.t, bodies)
    height, label = surface.height[::-1].astype(np.float32), surface.label[::-1]
    colours = np.zeros((*label.shape, 3), np.float32)
    for terrain, text in TERRAIN_COLOURS.items():
        colours[label == terrain] = rgb(text)
    colours[label == Terrain.UNKNOWN] = 128.0
    shaded = colours * hillshade(height, np.ones(height.shape, bool), surface.cell)[..., None]
    image = cv2.resize(shaded.clip(0, 255).astype(np.uint8), (pixels, pixels), interpolation=cv2.INTER_LINEAR)
    middle, ring = (pixels // 2, pixels // 2), round(pixels * radius / (2 * half))
    for colour, width in (((20, 20, 20), 5), ((255, 255, 255), 2)):  # one over the other
        cv2.circle(image, middle, ring, colour, width, cv2.LINE_AA)
        cv2.drawMarker(image, middle, colour, cv2.MARKER_CROSS, 14, width, cv2.LINE_AA)
    return webp(image)
