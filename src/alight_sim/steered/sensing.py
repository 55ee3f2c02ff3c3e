"""Events of a steered flight: the true motion, and measurements of it in order of arrival."""

from __future__ import annotations

import heapq
from bisect import bisect_right

import numpy as np

from alight.arrays import F64
from alight.geometry import so3_exp, so3_log
from alight.records import Event, ImuSample
from alight_sim.course import LEAD
from alight_sim.flight import NAV_OFFSET_NS, START_NS
from alight_sim.sensors import BiasWalk, ImuStream, NavStream, TrueMotion
from alight_sim.steered.cameras import SteeredCameras
from alight_sim.vehicle import UPWARDS


class TrueTrack:
    """True motion in pieces of constant angular rate and acceleration, one per step. Times: seconds of the flight."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._pieces: list[tuple[TrueMotion, F64, float]] = []  # motion at the start; (3,) position at the end; s

    def add(self, start: float, seconds: float, before: TrueMotion, place: F64, turned: F64) -> TrueMotion:
        """Append a step of `seconds` from time `start`; return its initial motion with the mean rates of the step.

        `before`: initial motion, rates unused. `place`, `turned`: final position (3,) and rotation (3, 3).
        """
        rate = np.asarray(so3_log(before.world_from_body.T @ turned)) / seconds
        motion = TrueMotion(before.position_world, before.velocity_world, before.world_from_body, rate)
        self._times.append(start)
        self._pieces.append((motion, place, seconds))
        if len(self._times) > 4096 and self._times[2048] < start - 3.0:
            del self._times[:2048], self._pieces[:2048]
        return motion

    def at(self, seconds: float) -> TrueMotion:
        """Return the motion at one time; before the first step and after the last one it is extrapolated."""
        k = max(bisect_right(self._times, seconds) - 1, 0)
        motion, place, whole = self._pieces[k]
        s = seconds - self._times[k]
        bend = (place - motion.position_world - motion.velocity_world * whole) / whole**2
        return TrueMotion(
            motion.position_world + motion.velocity_world * s + bend * s * s,
            motion.velocity_world + 2.0 * bend * s,
            motion.world_from_body @ so3_exp(motion.angular_velocity_body * s),
            motion.angular_velocity_body,
        )

    def poses(self, seconds: F64) -> tuple[F64, F64]:
        """Return the (N, 3, 3) rotations `world_from_body` and (N, 3) positions at times (N,)."""
        motions = [self.at(float(s)) for s in seconds]
        return np.stack([m.world_from_body for m in motions]), np.stack([m.position_world for m in motions])


class SteeredSensors:
    """IMU, GPS/INS and cameras of a vehicle that moves in steps. Times: seconds of the flight.

    Args:
        imu, biases: produce one sample per step.
        nav: GPS/INS, at its own rate.
        cameras: expose at their own rate.
    """

    def __init__(self, imu: ImuStream, biases: BiasWalk, nav: NavStream, cameras: SteeredCameras) -> None:
        self._imu, self._biases, self.nav, self._cameras = imu, biases, nav, cameras
        self.track = TrueTrack()  # contains each step before `measure` is called for it
        self.newest_imu: ImuSample | None = None
        self._nav_rows = 0
        self._queue, self._count = list[tuple[int, int, Event]](), 0  # arrival in ns, number, event
        self.imu_lost: list[tuple[float, float]] = []  # from, to: without samples

    def measure(self, start: float, h: float, motion: TrueMotion, velocity_world: F64) -> None:
        """Measure a step of `h` s from time `start`, by its initial motion and its final velocity, (3,) m/s."""
        biases, middle = self._biases.next(), start + 0.5 * h
        turn = motion.world_from_body @ so3_exp(0.5 * h * motion.angular_velocity_body)
        force = turn.T @ ((velocity_world - motion.velocity_world) / h + UPWARDS)
        t_ns = START_NS + round(middle * 1e9)
        sample = self._imu.sample(t_ns, motion.angular_velocity_body, force, biases)
        if not any(a <= middle < b for a, b in self.imu_lost):
            self.newest_imu = sample
            self._arrive(t_ns, sample)
        self._locate(start + h)
        self._expose(start + h)

    def arrived(self, until_ns: int) -> list[Event]:
        """Remove and return the events that have arrived by `until_ns`."""
        out = []
        while self._queue and self._queue[0][0] <= until_ns:
            out.append(heapq.heappop(self._queue)[2])
        return out

    def _locate(self, until: float) -> None:
        while (then := self._nav_time()) <= until:
            self._nav_rows += 1
            row = self.nav.sample(START_NS + round(then * 1e9), then, self.track.at(then - self.nav.errors.latency))
            if row is not None:
                self._arrive(row.t_ns, row)

    def _expose(self, until: float) -> None:
        while self._cameras.done_at() <= until:
            arrived = self._cameras.expose(self.track.poses)
            if arrived is not None:
                self._arrive(*arrived)

    def _nav_time(self) -> float:
        return self._nav_rows / self.nav.errors.rate_hz - LEAD + NAV_OFFSET_NS * 1e-9

    def _arrive(self, t_ns: int, event: Event) -> None:
        heapq.heappush(self._queue, (t_ns, self._count, event))
        self._count += 1
