"""Metadata and outcome of each photo of a set."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class PhotoFacts:
    """Metadata of one photo, from its tags."""

    name: str
    size: tuple[int, int]  # width and height, pixels
    camera: str  # maker and model
    focal_px: float | None = None  # None: no focal length is known
    focal_from: str = ""  # tags that give the focal length
    place: tuple[float, float] | None = None  # latitude, longitude, degrees
    position_from: str = ""  # type of GPS fix
    altitude: float | None = None  # metres, in the maker's reference (`altitude_kind`)
    altitude_kind: str = ""  # vertical datum of the altitude, in words
    above_takeoff: float | None = None  # metres
    attitude_from: str = ""  # tags that hold the camera's attitude
    taken: str = ""  # time of capture
    group: str = ""  # name of the flight and camera
    t_ns: int | None = None  # time of the exposure; None: the photo is not used
    left_out: str = ""  # reason why the photo is not used; empty: used


@dataclass(frozen=True)
class PhotoOutcome:
    """Agreement of the pictures with the tags of one photo, and whether the photo was registered."""

    t_ns: int
    attitude: str = ""  # use of the attitude in the tags, in words, such as "believed"; empty: the tags give none
    position: str = ""  # use of the position in the tags, in words, such as "believed"; empty: the tags give none
    left_out: str = ""  # reason why the photo could not be registered; empty: registered


@dataclass(frozen=True)
class PhotoRow:
    """One row of the table of photos."""

    facts: PhotoFacts
    outcome: PhotoOutcome | None  # None: the photo was not used to estimate poses

    @property
    def left_out(self) -> str:
        """Reason why the photo was not used; empty if it was used."""
        return self.facts.left_out or ("" if self.outcome is None else self.outcome.left_out)

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text, one cell per entry of `PHOTO_COLUMNS`."""
        f, o = self.facts, self.outcome
        focal = "" if f.focal_px is None else f"{f.focal_px:.0f} px, {f.focal_from}"
        place = "none" if f.place is None else f"{f.place[0]:.6f} {f.place[1]:.6f}, {f.position_from}"
        altitude = "" if f.altitude is None else f"{f.altitude:.1f} m, {f.altitude_kind}"
        place += f" ({o.position})" if o is not None and o.position not in ("", "believed") else ""
        attitude = f"{f.attitude_from or 'none'}" + (f" ({o.attitude})" if o is not None and o.attitude else "")
        return (
            f.name, f"{f.size[0]} x {f.size[1]}", f.camera, focal, place, altitude,
            attitude, f.taken, f.group, f"left out: {self.left_out}" if self.left_out else "used",
        )  # fmt: skip

    @property
    def line(self) -> str:
        """The row as one line."""
        return "  ".join(cell for cell in self.cells if cell)

    def as_json(self) -> dict[str, Any]:
        """Return the row as in run.json, numbers and text."""
        f, o = self.facts, self.outcome
        tree = {k: v for k, v in asdict(f).items() if k not in ("t_ns", "left_out")}
        tree |= {"attitude": "" if o is None else o.attitude, "position": "" if o is None else o.position}
        return tree | {"used": not self.left_out, "left_out": self.left_out}


PHOTO_COLUMNS = ("Photo", "Pixels", "Camera", "Focal length", "GPS", "Altitude", "Attitude", "Time", "Group", "Use")
