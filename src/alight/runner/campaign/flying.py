"""Fly one landing of a campaign and judge it. What raises is an outcome like any other."""

from __future__ import annotations

import gc
import logging
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from alight.records.campaign import Conditions, LandingRecord, LightRecord, LookLine, TransitionLine
from alight.records.executive import FlightState
from alight.runner.campaign.faults import Happenings
from alight.runner.campaign.outcome import judge_landing
from alight.runner.campaign.picture import ground_picture
from alight.runner.campaign.plan import campaign_world
from alight.runner.landing import Landing, fly_landing
from alight.runner.replay import appearance_of
from alight.settings import Settings
from alight_sim.campaign import CampaignWorld
from alight_sim.oracle import OracleLander
from alight_sim.scene import Scene
from alight_sim.steered import SteeredFlight
from alight_sim.world import World

log = logging.getLogger(__name__)

FlyLanding = Callable[..., Landing]


class Flown(NamedTuple):
    """A landing, and the picture of an unsafe touchdown (WebP)."""

    record: LandingRecord
    picture: bytes | None = None


def fly_conditions(conditions: Conditions, settings: Settings, fly: FlyLanding = fly_landing) -> Flown:
    """Fly a landing; an exception becomes the outcome `failed`.

    Args:
        conditions: all that is drawn.
        settings: of the aircraft.
        fly: in place of the true one, in tests.
    """
    begun = time.process_time()
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            flown = _fly(conditions, settings, fly)
    except Exception as e:
        log.info("landing %d: %s", conditions.landing, traceback.format_exc())
        flown = failed(conditions, e)
    gc.collect()  # the world and the map lie in cycles: 4.4 GB after five landings, else 0.7 GB after each
    cpu = round(time.process_time() - begun, 2)
    return flown._replace(record=flown.record.model_copy(update={"cpu_s": cpu}))


def failed(conditions: Conditions, error: BaseException) -> Flown:
    """Return the record of a landing that raised, or whose process died: outcome `failed`, with the error in a line."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rpartition('/')[2]}:{frames[-1].lineno})" if frames else ""
    line = " ".join(f"{type(error).__name__}: {error}".split()) + where
    return Flown(LandingRecord(conditions=conditions, outcome="failed", why="it raised", error=line))


def _vehicle(c: Conditions, kind: CampaignWorld, settings: Settings) -> SteeredFlight:
    world = lit_world(kind.build(c.world_seed), c.light)
    drift = {"position": c.gps_sigma, "position_tau": c.gps_tau}
    nav = None if world.scene is None else world.scene.sensors.nav.model_copy(update=drift)
    return SteeredFlight(
        world, c.flight_seed, start=kind.start, heading=c.heading, wind=(*c.wind, 0.0), gusts=c.gusts, nav=nav,
        radius=OracleLander.of(settings.lander.model_dump()).reach,
    )  # fmt: skip


def lit_world(world: World, drawn: LightRecord | None) -> World:
    """The world under the sun and the sky that were drawn; its haze and its wind stay, and cameras adapt."""
    if drawn is None:
        return world
    clouds = world.light.clouds.model_copy(update={"share": drawn.clouds})
    light = world.light.model_copy(update={**drawn.model_dump(exclude={"clouds"}), "clouds": clouds})
    scene = world.scene or Scene()
    adapting = scene.model_copy(update={"imaging": scene.imaging.model_copy(update={"auto": True})})
    return replace(world, light=light, scene=adapting)


def _fly(conditions: Conditions, settings: Settings, fly: FlyLanding) -> Flown:
    kind = campaign_world(conditions.scene)
    vehicle = _vehicle(conditions, kind, settings)
    happenings = Happenings(vehicle, conditions.faults)
    landing = fly(vehicle, settings, appearance_of(settings), happenings)
    judged = judge_landing(vehicle, landing, settings, kind.start[:2])
    touchdown = judged.touchdown
    picture = (
        ground_picture(vehicle.world, touchdown, settings.lander.radius) if touchdown and not touchdown.safe else None
    )
    found = [x for x in landing.diary.transitions if x.after is FlightState.APPROACH]
    record = LandingRecord(
        conditions=conditions.model_copy(update={"faults": happenings.faults}),
        outcome=judged.outcome, why=judged.why, touchdown=touchdown, safe_share=judged.safe_share,
        state=landing.state.value, p_at_commit=landing.p_at_commit, p_found=found[-1].p_safe if found else None,
        found_after=found[0].t if found else None,
        looks=tuple(LookLine(**{k: getattr(x, k) for k in LookLine.model_fields}) for x in landing.diary.looks),
        transitions=tuple(
            TransitionLine(
                t=x.t, before=x.before.value, event=x.event.value, after=x.after.value, reason=x.reason, p_safe=x.p_safe
            )
            for x in landing.diary.transitions
        ),
        seconds=landing.seconds, distance=happenings.distance, nearest=happenings.nearest, verdicts=landing.verdicts,
        cpu_of={name: round(s, 2) for name, s in landing.cpu_of.items()},
        picture=None if picture is None else f"landing-{conditions.landing:05d}.webp",
    )  # fmt: skip
    return Flown(record, picture)
