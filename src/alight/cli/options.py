"""Options that commands share, and the settings that they stand for."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from alight.settings import Settings


def _log_details(verbose: bool) -> None:
    if verbose:
        logging.getLogger("alight").setLevel(logging.INFO)


Assignments = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as lander.radius=2.")
]
SettingsFile = Annotated[Path | None, typer.Option("--settings", metavar="FILE", help="Settings as YAML.")]
Force = Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")]
Out = Annotated[Path, typer.Option("--out", metavar="OUT", help="Folder for the results.")]
Rig = Annotated[
    Path | None, typer.Option("--rig", metavar="FOLDER", help="Calibration of cameras: cam0/sensor.yaml and so on.")
]
Separation = Annotated[
    float | None,
    typer.Option(
        "--separation", min=-200.0, max=200.0,
        help="Ellipsoid minus sea level, m, where the receiver does not report it.",
    ),
]  # fmt: skip
ArmedAt = Annotated[
    str | None,
    typer.Option(
        "--home", metavar="LAT,LON,ALT_MSL", help="Where the vehicle is armed: route.plan counts its heights from it."
    ),
]
Geoid = Annotated[
    Path | None, typer.Option("--geoid", metavar="GRID", help="Geoid heights (EGM2008, GeoTIFF) for --home.")
]
Record = Annotated[
    bool, typer.Option("--record/--no-record", help="Record everything that comes in, and what is done, as MCAP.")
]
Firmware = Annotated[Literal["ardupilot", "px4"], typer.Option(help="Dialect of the simulated autopilot.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Another seed, another place.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", callback=_log_details, help="Log details on stderr.")]


def yaml_text(file: Path) -> str:
    """Read a file that a person wrote.

    Raises:
        SettingsError: it cannot be read.
    """
    from alight.documents import DocumentError, read_text
    from alight.records import SettingsError

    try:
        return read_text(file)
    except OSError as e:
        raise SettingsError(f"{file}: cannot be read ({e.strerror}); name a YAML file") from e
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e


def read_settings(file: Path | None, assignments: list[str] | None) -> Settings:
    """Read settings from a file and `--set` options.

    Raises:
        SettingsError: the file cannot be read, a key is unknown, a value is out of range.
    """
    from alight.records import SettingsError
    from alight.settings import load_settings

    text = yaml_text(file) if file else ""
    try:
        return load_settings(text, assignments or ())
    except ValueError as e:
        error = e
    try:
        load_settings(text)
    except ValueError:  # the file alone is at fault
        raise SettingsError(f"{file}: {error}") from error
    raise SettingsError(str(error)) from error


def refuse_unused(source: str, follow: bool, rig: Path | None, speed: float = 1.0) -> None:
    """Refuse options that have no effect on this source.

    Args:
        source: a recording, a folder, or cameras.
        follow: the folder is being filled.
        rig: folder with the calibration of cameras.
        speed: of a recording.

    Raises:
        InputError: the message names the option.
    """
    from alight.records import InputError
    from alight.sources.live import is_cameras

    cameras = is_cameras(source)
    if cameras and follow:
        raise InputError("--follow: is for a folder that is being filled, and cameras are none; leave it out")
    if speed != 1.0 and (cameras or follow):
        raise InputError("--speed: is of a flight log or a recording; cameras and folders that fill have their own")
    if rig is not None and not cameras:
        raise InputError(f"--rig: is for cameras; {source} brings its own calibration; leave it out")
