"""Flight by sight: the motion of each exposure goes to the autopilot as odometry, and replaces GPS where it fails."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

from alight.arrays import F64
from alight.flight.autopilot import ExternalPose, RemoteVehicle
from alight.records import GpsState, Motion, MotionState, Notice, NoticeKind

LASTING_NS = 3_000_000_000  # for which the filter must use GPS again, or the pictures show no motion: no taking turns


class OdometryReceiver(Protocol):
    """Interface of what takes odometry and the choice of a source: the vehicle, or its replacement in a dry run."""

    def send_odometry(self, pose: ExternalPose) -> bool: ...
    def fly_by_sight(self, wanted: bool) -> int | None: ...


class SightNavigation:
    """Sends the motion of each exposure as odometry, and decides whether the autopilot flies by it or by GPS.

    It flies by sight as soon as the receiver has no fix, or the filter does not use its positions, if the pictures show
    the motion. It flies by GPS again when the filter has used it for `LASTING_NS`, but not in the last metres, or when
    the receiver has a fix and the pictures have not shown the motion for as long.

    A constant shift leads from the map frame to the autopilot's local coordinates. It is made anew, and a reset is
    counted, if the pose may have jumped, and where flight by sight begins: from there the autopilot goes on without a
    jump. While the pictures do not show the motion, as on the ground, ArduPilot gets poses of no quality, which it
    ignores, as it does not arm without any; PX4 would fuse them, and gets none.

    Args:
        vehicle: the vehicle that reports.
        commands: receiver of the odometry.
        note: called with the name of a lane and each change in words.
    """

    def __init__(self, vehicle: RemoteVehicle, commands: OdometryReceiver, note: Callable[[str, str], None]) -> None:
        self._vehicle, self._commands, self._note = vehicle, commands, note
        self.in_use = False  # whether the autopilot flies by sight
        self.chooses = True  # whether a source may be ordered now; False: somebody else flies
        self.stays = False  # whether GPS must not be used again now
        self.delays, self._sent_ns = deque[float](maxlen=20_000), deque[int](maxlen=20_000)  # s; our clock
        self._series: tuple[int, int] | None = None  # map frame and resets, within which the pose does not jump
        self._resets = 0
        self._shift: F64 | None = None  # (3,) metres, from the map frame to the autopilot's local coordinates
        self._last_shift: F64 | None = None  # the same by the newest position that GPS has given
        self._tied_ns = self._compared_ns = 0  # exposures of the two
        self._used_since_ns: int | None = None  # since when the filter uses GPS
        self._seen_ns = 0  # when the pictures last showed the motion
        self._ticket: int | None = None
        self._refused = False

    @property
    def rate(self) -> float:
        """Number of messages per second, over all so far; 0 before the second."""
        sent = self._sent_ns
        return (len(sent) - 1) / max((sent[-1] - sent[0]) * 1e-9, 1e-3) if len(sent) > 1 else 0.0

    @property
    def deviation(self) -> str:
        """How far GPS has moved away from the odometry since it was tied to it, in words."""
        if self._shift is None or self._last_shift is None:
            return "not compared with GPS"
        apart, seconds = math.dist(self._shift[:2], self._last_shift[:2]), (self._compared_ns - self._tied_ns) * 1e-9
        return f"{apart:.1f} m from GPS after {seconds:.0f} s"

    def on_motion(self, motion: Motion, now_ns: int) -> None:
        """Process the motion of an exposure at `now_ns` of our clock: send it, and choose the source."""
        odometry, place = motion.odometry, self._vehicle.odometry.place_at(motion.t_ns)
        if odometry is None or motion.velocity_world is None:
            return
        here = motion.world_from_body.translation
        shift = None if place is None else place - here
        series = motion.frame_id, odometry.resets
        if series != self._series or self._shift is None:
            self._tie(shift)
            self._series, self._last_shift = series, shift
            self._tied_ns = self._compared_ns = motion.t_ns
        sees = motion.state in (MotionState.GOOD, MotionState.DEGRADED) and odometry.quality > 0
        trusted = odometry.gps in (GpsState.USED, GpsState.VAGUE) and self._vehicle.telemetry.has_fix
        self._seen_ns = now_ns if sees else self._seen_ns
        if not trusted:
            self._used_since_ns = None
        elif self._used_since_ns is None:
            self._used_since_ns = now_ns
        if trusted and not self.in_use:
            self._last_shift, self._compared_ns = shift, motion.t_ns
        if self.chooses:
            self._choose(motion, sees, now_ns)
        if self._shift is not None and (sees or self._vehicle.firmware.position_sources):
            pose = ExternalPose(
                motion.t_ns, here + self._shift, motion.world_from_body.rotation, motion.velocity_world,
                odometry.angular_velocity_body, odometry.covariance, odometry.quality if sees else 0.0, self._resets,
            )  # fmt: skip
            if self._commands.send_odometry(pose) and sees:
                self.delays.append((now_ns - motion.t_ns) * 1e-9)
                self._sent_ns.append(now_ns)

    def on_notice(self, notice: Notice) -> None:
        """Process a notice of the autopilot: after a refusal GPS is ordered once more, and sight no more."""
        if notice.kind is not NoticeKind.COMMAND or notice.ticket != self._ticket or notice.ok:
            return
        self._note("autopilot", f"it does not fly by sight any more: {notice.text}")
        self._ticket = None if self._refused else self._commands.fly_by_sight(False)
        self.in_use, self._refused = False, True

    def _tie(self, shift: F64 | None) -> None:
        self._shift = shift
        self._resets += 1

    def _choose(self, motion: Motion, sees: bool, now_ns: int) -> None:
        assert motion.odometry is not None
        since, gps, reports = self._used_since_ns, motion.odometry.gps, self._vehicle.telemetry
        if not self.in_use:
            if since is None and sees and reports.armed and not self._refused:
                if self._vehicle.firmware.position_sources and self._last_shift is not None:
                    self._tie(self._last_shift)
                why = motion.odometry.gps_why or "the receiver of GPS has no fix"
                self._use(True, f"it flies by sight: {why}")
            return
        lies = gps in (GpsState.JUMPED, GpsState.DRIFTS)
        if since is not None and now_ns - since >= LASTING_NS and not self.stays:
            self._use(False, "it flies by GPS again")
        elif now_ns - self._seen_ns >= LASTING_NS and reports.has_fix and not lies:
            self._use(False, "the pictures do not show the motion: it flies by GPS")

    def _use(self, sight: bool, words: str) -> None:
        self.in_use = sight
        self._ticket = self._commands.fly_by_sight(sight)
        self._note("autopilot", words)
