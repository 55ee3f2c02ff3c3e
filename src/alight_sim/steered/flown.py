"""A steered flight as the vehicle of a simulated autopilot: it follows set-points, measures, and takes pictures."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose
from alight.records import Frame, ImuSample
from alight_sim.point_mass import PointMass, Wanted
from alight_sim.steered.flight import SteeredFlight

OLD_NS = 30_000_000  # age from which the last sample of the IMU counts as lost


class FlownVehicle:
    """A vehicle for `SimulatedAutopilot` (`TrueVehicle`), with the flight's own IMU, wind and battery."""

    def __init__(self, flight: SteeredFlight) -> None:
        self.flight = flight
        self._body: PointMass = flight.body
        self._exposures: list[Frame] = []  # since they were taken last
        self._imu: ImuSample | None = None  # the newest sample

    def step(self, dt: float, wanted: Wanted | None) -> None:
        """Move for `dt` seconds; None: the motors stand still."""
        for event in self.flight.step(dt, wanted):
            if isinstance(event, Frame):
                self._exposures.append(event)
            elif isinstance(event, ImuSample):
                self._imu = event

    def take(self) -> list[Frame]:
        """Return the exposures since the last call."""
        found, self._exposures = self._exposures, []
        return found

    @property
    def position(self) -> F64:
        """(3,) metres in the world."""
        return self._body.position

    @property
    def velocity(self) -> F64:
        """(3,) m/s in the world."""
        return self._body.velocity

    @property
    def wind_world(self) -> F64:
        """(3,) m/s: velocity of the air, as the autopilot has learned it."""
        return self.flight.learned_wind

    @property
    def stands(self) -> bool:
        """True if it touches the ground."""
        return self._body.stands

    @property
    def world_from_body(self) -> Pose:
        """The true pose."""
        return self._body.world_from_body

    @property
    def imu(self) -> tuple[F64, F64] | None:
        """(3,) rad/s and (3,) m/s^2 in the body, as measured; None: the IMU is silent."""
        sample = self._imu
        if sample is None or self.flight.time_ns - sample.t_ns > OLD_NS:
            return None
        return sample.angular_velocity_body, sample.specific_force_body

    @property
    def battery(self) -> float:
        """Share of a full charge that is left."""
        return self.flight.battery


class FlownEstimate:
    """The estimate of a flight's autopilot (`Estimate`): the errors of the flight's navigation solution."""

    def __init__(self, flight: SteeredFlight) -> None:
        self._flight = flight
        self._now = flight.navigation

    def step(self, dt: float) -> None:
        """Read the errors of the flight, which its own sensors have advanced."""
        self._now = self._flight.navigation

    @property
    def error(self) -> F64:
        """(3,) metres, of the position."""
        return self._now.position

    @property
    def velocity_error(self) -> F64:
        """(3,) m/s."""
        return self._now.velocity

    @property
    def accuracy(self) -> tuple[float, float]:
        """1-sigma that the receiver claims, over the ground and in height, metres."""
        east, north, up = self._now.sigma
        return float(max(east, north)), float(up)

    @property
    def blind(self) -> float:
        """Seconds since the last position of the receiver."""
        return self._now.blind

    def attitude(self, world_from_body: F64) -> F64:
        """The estimated attitude (3, 3) at a true one."""
        return np.asarray(self._now.heading @ world_from_body @ self._now.attitude)
