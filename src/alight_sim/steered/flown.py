"""A steered flight as the vehicle of a simulated autopilot: it follows set-points, and keeps its exposures."""

from __future__ import annotations

from alight.arrays import F64
from alight.geometry import Pose
from alight.records import Frame
from alight_sim.point_mass import PointMass, Wanted
from alight_sim.steered.flight import SteeredFlight


class FlownVehicle:
    """A vehicle for `SimulatedAutopilot` (`TrueVehicle`).

    Args:
        flight: steered by truth: the autopilot has an estimate of its own.
    """

    def __init__(self, flight: SteeredFlight) -> None:
        self.flight = flight
        self._body: PointMass = flight.body
        self.exposures: list[Frame] = []  # since they were taken last

    def step(self, dt: float, wanted: Wanted | None) -> None:
        """Move for `dt` seconds; None: the motors stand still."""
        self.exposures += [e for e in self.flight.step(dt, wanted) if isinstance(e, Frame)]

    def take(self) -> list[Frame]:
        """Return the exposures since the last call."""
        found, self.exposures = self.exposures, []
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
        """(3,) m/s: velocity of the air."""
        return self._body.wind_world

    @property
    def heading(self) -> float:
        """Rad clockwise from north."""
        return self._body.heading

    @property
    def stands(self) -> bool:
        """True if it touches the ground."""
        return self._body.stands

    @property
    def world_from_body(self) -> Pose:
        """The true pose."""
        return self._body.world_from_body

    @property
    def angular_velocity_body(self) -> F64:
        """(3,) rad/s in the body."""
        return self._body.angular_velocity_body

    @property
    def specific_force_body(self) -> F64:
        """(3,) m/s^2 in the body."""
        return self._body.specific_force_body
