"""Landings flown by a real ArduPilot, where `ALIGHT_SITL` names its binary: take-off, looks, touchdown."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from autopilot_rig import HOME
from made_up_ground import Ground, clearer_from_below
from over_a_link import drive, ready_vehicle
from pilot_rig import PLACE

from alight.flight.autopilot import TelemetryEvents
from alight.flight.session.pilot import LandingPilot
from alight.flight.session.take_off import TakeOff
from alight.geometry import LocalFrame, Pose
from alight.pipeline import FlightPolicy
from alight.pipeline.navigation import Navigation
from alight.records import Frame, Motion, NavSample, NoticeKind
from alight.records.executive import FlightState, LookRecord, Transition
from alight.settings import load_settings

LOCAL = LocalFrame(HOME.latitude, HOME.longitude, HOME.altitude_msl)  # its GPS takes the sea level for the ellipsoid


class Silent:
    """A log that keeps nothing."""

    def order(self, t_ns: int, state: str, words: str) -> None: ...
    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None: ...
    def note(self, lane: str, words: str) -> None: ...


def test_a_real_ardupilot_flies_a_landing(sitl: str) -> None:
    """Pictures and verdicts are made up; motions are the autopilot's own rows; orders and protocol are real."""
    link, ours, vehicle = ready_vehicle(sitl, TelemetryEvents(LOCAL, separation=0.0))
    climb = TakeOff(vehicle, 20.0, time.monotonic_ns())

    def climbed() -> bool:
        climb.tick(time.monotonic_ns())
        for notice in ours.notices():
            climb.on_notice(notice)
        return climb.done

    assert drive(link, ours, 120, climbed), climb.failed
    ground, settings = Ground({PLACE: clearer_from_below}), load_settings("", ["executive.search_height=20"])
    number = 0

    policy, begin = FlightPolicy(every=0), time.monotonic_ns()
    pilot = LandingPilot(settings, LOCAL, vehicle, vehicle, policy, Silent())
    pilot.begin(begin)
    image, notices, searched = np.zeros((8, 8), np.uint8), [], list[float]()

    def landed() -> bool:
        nonlocal image, number
        now, image = time.monotonic_ns(), image + np.uint8(1)
        for row in ours.samples():
            if isinstance(row, NavSample) and row.position_world is not None:
                frame = Frame(now, (image,))
                pilot.inputs.add_frame(frame, now)
                motion = Motion(row.t_ns, Pose(np.eye(3), row.position_world), (), np.eye(6))
                pilot.inputs.add_motion(motion)
                if policy.due_verdict(Navigation(frame, motion), 0):
                    number += 1
                    pilot.inputs.add_map_verdict(ground.seen(number, (now - begin) * 1e-9, row.position_world), now)
        for notice in ours.notices():
            notices.append(notice)
            pilot.on_notice(notice)
        pilot.tick(now)
        if pilot.state is FlightState.SEARCH:
            assert ours.telemetry is not None
            assert ours.telemetry.place is not None
            searched.append(ours.telemetry.place.above_home)
        return pilot.over

    assert drive(link, ours, 300, landed), notices
    assert pilot.state is FlightState.LANDED, pilot.diary.transitions
    assert 15.0 < min(searched) < max(searched) < 25.0
    assert ours.telemetry is not None
    assert ours.telemetry.place is not None
    place = ours.telemetry.place
    at = LOCAL.to_enu(place.latitude, place.longitude, 0.0)
    assert np.hypot(*(at[:2] - PLACE)) < 2.0  # its estimate is the truth of this test
    assert not [n for n in notices if n.kind is NoticeKind.TAKEOVER]
    link.close()


def test_a_real_ardupilot_lands_on_ground_that_is_drawn_for_it(sitl: str, tmp_path: Path) -> None:
    """Only the ground is made up: pictures, motion, map, verdicts and orders are those of `alight fly`."""
    alight, folder = [sys.executable, "-c", "from alight.cli import main; main()"], tmp_path / "pictures"
    draw = [*alight, "rehearse", "concrete", "--folder", str(folder), "--follow", "tcp:127.0.0.1:5762"]
    with subprocess.Popen(draw, stdout=subprocess.PIPE, text=True) as cameras:
        assert cameras.stdout is not None
        assert "ready" in cameras.stdout.readline()
        fly = ["fly", "--link", sitl, "--camera", str(folder), "--out", str(tmp_path / "out"), "--take-off", "30"]
        fly += ["--separation", "0"]  # its receiver takes the sea level for the ellipsoid
        flown = subprocess.run([*alight, *fly], capture_output=True, text=True, check=False, timeout=600)
        said, _ = cameras.communicate(timeout=60)
    assert flown.returncode == 0, flown.stdout + flown.stderr
    assert "LANDED" in flown.stdout
    assert "touchdown at" in said
