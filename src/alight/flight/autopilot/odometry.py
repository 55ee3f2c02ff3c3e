"""The motion of an exposure as ODOMETRY: external navigation that an autopilot's estimator fuses (MAVLink message 331).

Positions are NED metres from the origin of the autopilot's local coordinates, axes of the pose are north, east, down,
and velocities are along the axes of the body (FRD).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from alight.arrays import F64
from alight.flight.autopilot import border
from alight.flight.autopilot.clock import VehicleClock
from alight.flight.autopilot.commands import CommandQueue
from alight.flight.autopilot.dialect import mavlink
from alight.flight.autopilot.firmware import Firmware
from alight.flight.autopilot.vehicle_state import VehicleState
from alight.geometry import quaternion_from_matrix
from alight.geometry.rotations import ENU_FROM_NED, FRD_FROM_FLU


@dataclass(frozen=True, eq=False)
class ExternalPose:
    """Motion of the vehicle at one instant, in world axes."""

    t_ns: int  # our clock
    position: F64  # (3,) metres from the origin of the autopilot's local coordinates
    world_from_body: F64  # (3, 3)
    velocity_world: F64  # (3,) m/s
    angular_velocity_body: F64  # (3,) rad/s
    covariance: F64  # (9, 9), of position [m], rotation vector in world axes [rad], velocity [m/s]
    quality: float  # 0 to 1
    resets: int  # number of jumps so far

    def message(self, time_usec: int, frame: int) -> Any:
        """Return the ODOMETRY message.

        Args:
            time_usec: the instant on the clock that the autopilot expects, microseconds.
            frame: MAV_FRAME of the pose; its axes are north, east, down for every frame.
        """
        turn = FRD_FROM_FLU @ self.world_from_body.T
        pose = block_diag(ENU_FROM_NED, ENU_FROM_NED)  # its own inverse
        velocity = np.full((6, 6), math.nan)
        velocity[:3, :3] = turn @ self.covariance[6:, 6:] @ turn.T
        return mavlink.MAVLink_odometry_message(
            time_usec, frame, mavlink.MAV_FRAME_BODY_FRD, *border.ned(self.position),
            list(quaternion_from_matrix(border.world_from_body_of(self.world_from_body))),  # its own inverse
            *(turn @ self.velocity_world), *border.frd(self.angular_velocity_body),
            _upper_triangle(pose @ self.covariance[:6, :6] @ pose.T), _upper_triangle(velocity),
            self.resets % 256, mavlink.MAV_ESTIMATOR_TYPE_VISION, _percent(self.quality),
        )  # fmt: skip


def _upper_triangle(covariance: F64) -> list[float]:
    return [float(v) for v in covariance[np.triu_indices(6)]]


def _percent(quality: float) -> int:
    """Return a quality of 0 to 1 as MAVLink has it: 1 to 100, and -1 for none, as 0 is an unknown quality."""
    return max(1, round(100 * quality)) if quality > 0 else -1


class OdometryLink:
    """Sends external poses to an autopilot, and orders the set of sources that its estimator uses.

    Args:
        firmware, state, clock: of the vehicle.
        send, commands: called with each message to send; the queue of commands to the vehicle.
    """

    def __init__(
        self, firmware: Firmware, state: VehicleState, clock: VehicleClock, send: Callable[[Any], None],
        commands: CommandQueue,
    ) -> None:  # fmt: skip
        self._firmware, self._state, self._clock, self._send, self._commands = firmware, state, clock, send, commands
        self.drift = np.zeros(3)  # m/s: velocity that the autopilot reports by sight, less ours, of the same instant

    @property
    def in_use(self) -> bool:
        """Whether the autopilot was ordered to fly by the poses: its position is then no measurement of its own."""
        return self._state.newest.by_sight

    @property
    def fuses_gps(self) -> bool:
        """Whether the autopilot flies by the poses, and fuses GPS all the same."""
        return self.in_use and not self._firmware.position_sources

    def place_at(self, t_ns: int) -> F64 | None:
        """Return the autopilot's local position at an instant of our clock, (3,) metres east, north, up; None: unknown.

        It is extrapolated from the newest LOCAL_POSITION_NED.
        """
        newest = self._state.local
        if newest is None or not self._clock.known:
            return None
        boot_ns, position, velocity = newest
        ahead = (self._clock.theirs_ns(t_ns) - boot_ns) * 1e-9
        return position + velocity * ahead if abs(ahead) < 1.0 else None

    def send(self, pose: ExternalPose) -> bool:
        """Send a pose; return False if it is not sent, as the autopilot's clock is not known."""
        by_ours = self._firmware.odometry_by_our_clock
        if not (by_ours or self._clock.known):
            return False
        t_ns = pose.t_ns if by_ours else self._clock.theirs_ns(pose.t_ns)
        if t_ns > 0:  # else it was taken before the boot
            self._compare(pose)
            self._send(pose.message(t_ns // 1000, self._firmware.odometry_frame))
        return t_ns > 0

    def _compare(self, pose: ExternalPose) -> None:
        """Compare the velocity of an estimator that fuses GPS too; one that has changed its source has ours."""
        if not (self.fuses_gps and pose.quality and self._clock.known):
            return
        velocity = self._state.positions.velocity_at(self._clock.theirs_ns(pose.t_ns))
        if velocity is not None:
            self.drift = (velocity - pose.velocity_world) * (1.0, 1.0, 0.0)

    def use(self, wanted: bool, t_ns: int) -> int | None:
        """Order the autopilot to fly by the poses, or by GPS; return the ticket, None if it needs no order.

        `t_ns`: present time of the `TimeoutClock`.
        """
        self._state.newest = replace(self._state.newest, by_sight=wanted)
        self._state.positions.expects_resets = True
        self.drift = np.zeros(3)
        number = self._firmware.position_sources.get(wanted)
        if number is None:
            return None
        command = mavlink.MAV_CMD_SET_EKF_SOURCE_SET
        self._commands.give_up(command)
        return self._commands.submit(f"source set {number}", command, (float(number),), t_ns, flies=False)
