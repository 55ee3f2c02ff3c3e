"""Events of a steered flight: measurements of the true motion, in the order of arrival."""

from __future__ import annotations

import heapq

from alight.arrays import F64
from alight.geometry import so3_exp
from alight.records import Event
from alight_sim.course import LEAD
from alight_sim.flight import NAV_OFFSET_NS, START_NS
from alight_sim.sensors import BiasWalk, ImuStream, NavStream, TrueMotion
from alight_sim.steered.cameras import SteeredCameras
from alight_sim.steered.track import TrueTrack
from alight_sim.vehicle import UPWARDS


class SteeredSensors:
    """IMU, GPS/INS and cameras of a vehicle that is stepped. Times: seconds of the flight.

    Args:
        imu, biases: give one sample a step.
        nav: GPS/INS, at its own rate.
        cameras: expose at theirs.
        track: the true motion; it holds a step before `measure` is called for it.
    """

    def __init__(
        self, imu: ImuStream, biases: BiasWalk, nav: NavStream, cameras: SteeredCameras, track: TrueTrack
    ) -> None:
        self._imu, self._biases, self._nav, self._cameras, self._track = imu, biases, nav, cameras, track
        self._nav_rows = 0
        self._queue, self._count = list[tuple[int, int, Event]](), 0  # arrival in ns, number, event
        self.imu_lost: list[tuple[float, float]] = []  # from, to: without samples

    def measure(self, start: float, h: float, motion: TrueMotion, velocity_world: F64) -> None:
        """Measure a step of `h` seconds that begins with a motion and ends with a velocity, (3,) m/s."""
        biases, middle = self._biases.next(), start + 0.5 * h
        turn = motion.world_from_body @ so3_exp(0.5 * h * motion.angular_velocity_body)
        force = turn.T @ ((velocity_world - motion.velocity_world) / h + UPWARDS)
        t_ns = START_NS + round(middle * 1e9)
        sample = self._imu.sample(t_ns, motion.angular_velocity_body, force, biases)
        if not any(a <= middle < b for a, b in self.imu_lost):
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
            row = self._nav.sample(START_NS + round(then * 1e9), then, self._track.at(then - self._nav.errors.latency))
            if row is not None:
                self._arrive(row.t_ns, row)

    def _expose(self, until: float) -> None:
        while self._cameras.done_at() <= until:
            arrived = self._cameras.expose(self._track.poses)
            if arrived is not None:
                self._arrive(*arrived)

    def _nav_time(self) -> float:
        return self._nav_rows / self._nav.errors.rate_hz - LEAD + NAV_OFFSET_NS * 1e-9

    def _arrive(self, t_ns: int, event: Event) -> None:
        heapq.heappush(self._queue, (t_ns, self._count, event))
        self._count += 1
