"""Fly one landing of a campaign and judge it. An exception in flight is an outcome like any other."""

from __future__ import annotations

import gc
import logging
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from alight.cluster import open_jobs
from alight.jobs import InProcesses, Task
from alight.records import InputError
from alight.records.campaign import (
    Conditions,
    LandingRecord,
    LightRecord,
    Outcome,
    TransitionLine,
)
from alight.records.executive import FlightState
from alight.report.maps import film_strip
from alight.runs import appearance_of
from alight.settings import Settings
from alight.trials.campaign.faults import Happenings
from alight.trials.campaign.outcome import Contacts, ground_picture, judge_landing, met
from alight.trials.campaign.worlds import campaign_world, error_line, is_factory, made_world
from alight.trials.landing import Landing, fly_landing
from alight_sim.autopilot import PX4_CONTROLLER
from alight_sim.oracle import OracleLander
from alight_sim.scene import Scene
from alight_sim.scene_world import SceneWorld
from alight_sim.steered import SteeredFlight
from alight_sim.world import START, World

log = logging.getLogger(__name__)

FlyLanding = Callable[..., Landing]


class Flown(NamedTuple):
    """The record of a landing, and as WebP a picture of an unsafe touchdown and the film of its looks."""

    record: LandingRecord
    picture: bytes | None = None
    film: bytes | None = None


def fly_conditions(conditions: Conditions, settings: Settings, fly: FlyLanding = fly_landing) -> Flown:
    """Fly a landing and return its record; an exception becomes the outcome `failed`.

    Args:
        conditions: the drawn conditions.
        settings: settings of the aircraft.
        fly: replaces `fly_landing` in tests.

    Raises:
        InputError: the landing cannot begin: the scene, the lander or the model of appearance cannot be used.
    """
    begun = time.process_time()
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            flown = _fly(conditions, settings, fly)
    except InputError:
        raise
    except Exception as e:
        log.info("landing %d: %s", conditions.landing, traceback.format_exc())
        flown = failed(conditions, e)
    gc.collect()  # the world and the map lie in cycles: 4.4 GB after five landings, else 0.7 GB after each
    cpu = round(time.process_time() - begun, 2)
    return flown._replace(record=flown.record.model_copy(update={"cpu_s": cpu}))


def failed(conditions: Conditions, error: BaseException, contacts: Contacts = (None, None)) -> Flown:
    """Return the record of a landing that raised or whose process died: failed or, by its contacts, unsafe."""
    outcome: Outcome = "failed"
    why, (touchdown, strike) = "it raised", contacts
    if strike is not None or (touchdown is not None and not touchdown.safe):
        outcome, why = "landed unsafely", "it raised, and had touched what is not safe"
    return Flown(LandingRecord(
        conditions=conditions, outcome=outcome, why=why, touchdown=touchdown, strike=strike, error=error_line(error)
    ))  # fmt: skip


def checked_vehicle(c: Conditions, settings: Settings) -> SteeredFlight:
    """Return the simulated vehicle of a landing, at its start in its world.

    Raises:
        InputError: the scene cannot be flown over, or the lander is too small for the cells of its ground.
    """
    if is_factory(c.scene):
        world: World = made_world(c.scene, c.world_seed)
    else:
        world = lit_world(campaign_world(c.scene).build(c.world_seed), c.light)
    nav = world.sensors.nav.model_copy(update={"position": c.gps_sigma, "position_tau": c.gps_tau})
    east, north, up = world.start
    higher = max(0.0, settings.executive.search_height - START[2])
    vehicle = SteeredFlight(
        world, c.flight_seed, start=(east, north, up + higher), heading=c.heading, wind=(*c.wind, 0.0), gusts=c.gusts,
        nav=nav,
        radius=OracleLander.of(settings.lander.model_dump()).reach,
        limits=PX4_CONTROLLER if c.firmware == "px4" else None,
    )  # fmt: skip
    least = 1.5 * world.cell  # the plane of a footprint needs three cells
    if settings.lander.radius < least:
        raise InputError(
            f"lander.radius {settings.lander.radius:g} m: the ground of {c.scene} has cells of "
            f"{world.cell:g} m, and only footprints of {least:g} m and more can be judged on it"
        )
    return vehicle


def lit_world(world: SceneWorld, drawn: LightRecord | None) -> SceneWorld:
    """Return the world with the drawn sun, sky and clouds, and automatic exposure of the cameras; None: unchanged."""
    if drawn is None:
        return world
    clouds = world.light.clouds.model_copy(update={"share": drawn.clouds})
    light = world.light.model_copy(update={**drawn.model_dump(exclude={"clouds"}), "clouds": clouds})
    scene = world.scene or Scene()
    adapting = scene.model_copy(update={"imaging": scene.imaging.model_copy(update={"auto": True})})
    return replace(world, light=light, scene=adapting)


def _fly(conditions: Conditions, settings: Settings, fly: FlyLanding) -> Flown:
    vehicle, appearance = checked_vehicle(conditions, settings), appearance_of(settings)
    happenings = Happenings(vehicle, conditions.faults)
    try:
        aided = {"odometry": True} if conditions.odometry else {}
        landing = fly(vehicle, settings, appearance, happenings, conditions.firmware, **aided)
    except Exception as e:
        log.info("landing %d: %s", conditions.landing, traceback.format_exc())
        return failed(conditions.model_copy(update={"faults": happenings.faults}), e, met(vehicle, settings))
    judged = judge_landing(vehicle, landing, settings)
    picture = None
    if judged.outcome == "landed unsafely" and (at := judged.touchdown or judged.strike):
        picture = ground_picture(vehicle.world, at, settings.lander.radius, vehicle.bodies)
    found = [x for x in landing.diary.transitions if x.after is FlightState.APPROACH]
    film = film_strip(landing.diary.pictures, settings.lander.radius)
    record = LandingRecord(
        conditions=conditions.model_copy(update={"faults": happenings.faults}),
        **judged._asdict(), state=landing.state.value, p_at_commit=landing.p_at_commit,
        p_found=found[-1].p_safe if found else None, found_after=found[0].t if found else None,
        looks=tuple(landing.diary.looks),
        transitions=tuple(TransitionLine.model_validate(x, from_attributes=True) for x in landing.diary.transitions),
        touched=happenings.touched(settings.lander.reach),
        seconds=landing.seconds, distance=happenings.distance, nearest=happenings.nearest, verdicts=landing.verdicts,
        cpu_of={name: round(s, 2) for name, s in landing.cpu_of.items()},
        picture=None if picture is None else f"landing-{conditions.landing:05d}.webp",
        film=None if film is None else f"looks-{conditions.landing:05d}.webp",
    )  # fmt: skip
    return Flown(record, picture, film)


class WorkerLostError(Exception):
    """The process that flew a landing died; `records.campaign.LOST` is the name of this error."""


def fly_all(
    conditions: Sequence[Conditions], job: Callable[[Conditions], Flown], jobs: int, scheduler: str | None
) -> Iterator[Flown]:
    """Yield the record of each landing when the landing ends, in any order.

    Args:
        conditions: conditions of the landings.
        job: function that flies one landing; it can be pickled.
        jobs: number of processes of this machine; 1: this process.
        scheduler: address of a Dask cluster to use instead, such as tcp://host:8786; None: no cluster.

    Raises:
        MissingExtraError: Dask is not installed.
        InputError: no scheduler answers, its workers have another version of Alight or are lost again and again, no
            process starts on this machine, or a landing cannot begin.
    """
    with open_jobs(scheduler, jobs) as workers:
        tasks = (
            Task(
                f"landing {c.landing}", job, (c,), tries=2,
                if_lost=partial(_lost, c) if scheduler is None else None,
            )
            for c in conditions
        )  # fmt: skip
        yield from workers.run(tasks, any_order=True)


def _lost(conditions: Conditions) -> Flown:
    """Return the record of a landing whose process died, after a check that processes can run at all.

    Raises:
        InputError: a process without a landing dies, too.
    """
    try:
        list(InProcesses(1).run([Task("start", int, tries=1)]))
    except InputError as e:
        raise InputError(
            "the processes that fly landings die at their start; a Python script that starts several jobs needs its "
            'call below `if __name__ == "__main__":`'
        ) from e
    return failed(conditions, WorkerLostError("the process that flew it died"))
