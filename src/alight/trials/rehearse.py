"""Pictures for an autopilot without cameras: a scene rendered at the poses that the vehicle reports."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from alight.flight.autopilot import Autopilot, Link, border, open_link
from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.dialect import mavlink
from alight.records import ImuSample, InputError, NavSample
from alight_sim.followed import FollowedCameras, ReportedPlace
from alight_sim.oracle import Touchdown
from alight_sim.rehearsal import CameraFolder

RATES = {"LOCAL_POSITION_NED": 50.0, "ATTITUDE_QUATERNION": 50.0}  # Hz
STEP = 0.02  # s
NO_VEHICLE = 120.0  # s without a vehicle, after which this is an error; a SITL first waits for another link


class _TrackReader:
    """Makes the track of the cameras from the vehicle's telemetry."""

    def __init__(self, cameras: FollowedCameras) -> None:
        self._cameras, self.starts, self.by_sight = cameras, 1, False

    def restart(self, starts: int) -> None:
        """Begin anew after a reboot of the autopilot, as its local frame has changed."""
        self.starts = starts
        self._cameras.restart()

    def feed(self, name: str, message: Any, clock: VehicleClock) -> Sequence[NavSample | ImuSample]:
        """Add the attitude or position in a message to the track; return no samples. See `TelemetryReader.feed`."""
        if clock.known and name == "ATTITUDE_QUATERNION":
            R = border.world_from_body_of_quaternion([message.q1, message.q2, message.q3, message.q4])
            if R is not None:
                self._cameras.track.add_attitude(clock.ours_ns(message.time_boot_ms * 1_000_000), R)
        elif clock.known and name == "LOCAL_POSITION_NED":
            t_ns = clock.ours_ns(message.time_boot_ms * 1_000_000)
            position = border.enu(message.x, message.y, message.z)
            self._cameras.track.add_place(ReportedPlace(t_ns, position, border.enu(message.vx, message.vy, message.vz)))
        return ()


class VehicleFollower:
    """Renders the pictures of a vehicle's cameras from telemetry; opens no link and sends no orders.

    Exchange the bytes of the link with `autopilot`, and call `tick` often.

    Args:
        cameras: cameras of a scene.
        folder: folder to which the exposures are written.
    """

    def __init__(self, cameras: FollowedCameras, folder: CameraFolder) -> None:
        self._cameras, self._folder = cameras, folder
        second = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER2  # the first is `alight fly`
        self.autopilot = Autopilot(RATES, _TrackReader(cameras), component=second)
        self.exposures = 0
        self._flown = False

    @property
    def touchdown(self) -> Touchdown | None:
        """The oracle's verdict on the touchdown; None until the vehicle has flown and is disarmed on the ground."""
        telemetry = self.autopilot.telemetry
        down = self._flown and telemetry is not None and telemetry.is_down
        return self._cameras.touchdown() if down else None

    def tick(self, now_ns: int) -> None:
        """Process the telemetry, and render and write the exposures that are due."""
        self.autopilot.tick(now_ns)
        self.autopilot.notices()
        telemetry, places = self.autopilot.telemetry, self._cameras.track.places
        if telemetry is None:
            return
        self._flown |= telemetry.armed
        if telemetry.has_position and telemetry.place is not None and places:
            self._cameras.place(places[-1].position, telemetry.place.above_home)
        for t_ns, frame in self._cameras.take():
            self._folder.write(frame, t_ns)
            self.exposures += 1


def follow_vehicle(
    link: str, cameras: FollowedCameras, folder: Path, seconds: float, print_line: Callable[[str], None]
) -> Touchdown | None:
    """Fill a folder with pictures of a scene at the poses that an autopilot reports, until the vehicle has landed.

    Args:
        link: link to the autopilot; `alight fly` needs another link.
        cameras: cameras of the scene.
        folder: folder for the pictures, in the layout of a flight log.
        seconds: time after which this ends in any case.
        print_line: called with a line when `alight fly` may be started, and when the first picture is written.

    Returns:
        The oracle's verdict on the touchdown; None: no touchdown.

    Raises:
        InputError: the name of the link is wrong, or no supported vehicle answers.
        OutputError: the folder cannot be made, or holds pictures already.
    """
    opened = open_link(link, patient=True)
    try:
        pictures = CameraFolder(folder, cameras.rig, cameras.rate_hz)
        try:
            print_line(f"ready: alight fly --link LINK --camera {shlex.quote(str(folder))} --out OUT --take-off 30")
            return _follow(opened, VehicleFollower(cameras, pictures), seconds, print_line)
        finally:
            pictures.close()
    finally:
        opened.close()


def _follow(
    link: Link, follower: VehicleFollower, seconds: float, print_line: Callable[[str], None]
) -> Touchdown | None:
    begin = time.monotonic()
    end, found = begin + seconds, None
    while time.monotonic() < end:
        for data in link.read(STEP):
            follower.autopilot.receive(data, time.monotonic_ns())
        before = follower.exposures
        follower.tick(time.monotonic_ns())
        for data in follower.autopilot.pending():
            link.write(data)
        if not before and follower.exposures:
            print_line("the first picture is written")
        if follower.autopilot.vehicle is None and time.monotonic() - begin > NO_VEHICLE:
            reason = f" ({link.broken})" if link.broken else ""
            raise InputError(
                f"{link.name}: no message of a vehicle for {NO_VEHICLE:.0f} s{reason}; is the autopilot running?"
            )
        if found is None and (found := follower.touchdown) is not None:
            end = min(end, time.monotonic() + 5.0)  # time for the reader of the pictures
    return found
