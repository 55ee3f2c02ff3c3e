"""A rehearsal in real time: a simulated autopilot on a UDP port, and cameras that write to a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from alight.records import Event, Frame, OutputError, Rig
from alight_sim.autopilot import DIALECTS, EstimateError, SimulatedAutopilot, SimulatedHome, UdpServer
from alight_sim.autopilot.dialects import Doing
from alight_sim.autopilot.memory import EXTERNAL_NAVIGATION
from alight_sim.log import encode_image, write_calibration
from alight_sim.steered import SteeredFlight


class CameraFolder:
    """Writer of exposures in the layout of a flight log, one by one.

    Raises:
        OutputError: the folder cannot be created, or holds pictures already.
    """

    def __init__(self, root: Path, rig: Rig, rate_hz: float) -> None:
        self._root = root / "mav0"
        if any((self._root / c.name / "data.csv").exists() for c in rig.cameras):
            raise OutputError(f"{root}: holds pictures already; choose another folder")
        try:
            write_calibration(rig, rate_hz, self._root)
        except OSError as e:
            raise OutputError(f"{root}: cannot be written ({e.strerror or e}); choose another folder") from e
        self._tables = [(self._root / c.name / "data.csv").open("w", encoding="utf-8") for c in rig.cameras]
        for table in self._tables:
            table.write("#timestamp [ns],filename\n")
        self._names = [c.name for c in rig.cameras]

    def write(self, frame: Frame, t_ns: int) -> None:
        """Write the images of an exposure under the stamp `t_ns`, each before its row in the table."""
        for name, image, table in zip(self._names, frame.images, self._tables, strict=True):
            if image is not None:
                (self._root / name / "data" / f"{t_ns}.png").write_bytes(encode_image(image, "png"))
                table.write(f"{t_ns},{t_ns}.png\n")
                table.flush()

    def close(self) -> None:
        """Close the tables of the exposures."""
        for table in self._tables:
            table.close()


class Rehearsal:
    """A vehicle over a scene, flown by a simulated autopilot in real time; a context manager with its own thread.

    Args:
        flight: vehicle on the ground or in flight.
        folder: output folder for its pictures, which are stamped by this machine's steady clock.
        port: port on this machine to which the autopilot sends; it also answers senders to `server.port`.
        px4: whether the autopilot uses PX4's dialect.
        wrong: (3,) metres, error of the autopilot's estimate.
    """

    def __init__(
        self, flight: SteeredFlight, folder: Path, port: int, px4: bool = False,
        wrong: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        self.flight = flight
        local = flight.local
        home = SimulatedHome.at(local)
        dialect = DIALECTS["px4" if px4 else "ardupilot"]
        self.autopilot = SimulatedAutopilot(dialect, flight, home, EstimateError(wrong, walk=0.05))
        self.autopilot.memory.parameters |= EXTERNAL_NAVIGATION[dialect.firmware]
        if flight.height_above_ground > 1.0:
            self.autopilot.hover(Doing.PILOT)
        self._cameras, self._shift_ns = CameraFolder(folder, flight.rig, flight.rate_hz), 0
        self.server = UdpServer(self.autopilot, ("127.0.0.1", port), step=0.01, after_step=self._expose)

    def _expose(self, events: Sequence[Event]) -> None:
        """Write the exposures among `events`, stamped by this machine's steady clock."""
        self._shift_ns = self._shift_ns or time.monotonic_ns() - self.flight.time_ns
        for frame in events:
            if isinstance(frame, Frame):
                self._cameras.write(frame, frame.t_ns + self._shift_ns)

    def __enter__(self) -> Rehearsal:
        self.server.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.server.__exit__(None, None, None)
        self._cameras.close()

    def wait(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Let the rehearsal run for `seconds` of the steady clock, or until `until` returns true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            time.sleep(0.05)
