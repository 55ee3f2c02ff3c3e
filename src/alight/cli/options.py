"""Options that commands share, as records, and the settings that they give."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer

if TYPE_CHECKING:
    from alight.settings import Settings


def command_of(options: type) -> Callable[[Callable[[Any], None]], Callable[..., None]]:
    """Return a decorator that turns a function of one record into a command with the record's fields as options."""
    hints = get_type_hints(options, include_extras=True)
    parameters = [
        Parameter(
            f.name, Parameter.KEYWORD_ONLY, annotation=hints[f.name],
            default=Parameter.empty if f.default is MISSING else f.default,
        )
        for f in fields(options)
    ]  # fmt: skip

    def wrap(function: Callable[[Any], None]) -> Callable[..., None]:
        def command(**given: Any) -> None:
            function(options(**given))

        command.__doc__, command.__name__ = function.__doc__, function.__name__
        command.__annotations__, command.__signature__ = hints, Signature(parameters)  # type: ignore[attr-defined]
        return command

    return wrap


def _log_details(verbose: bool) -> None:
    if verbose:
        logging.getLogger("alight").setLevel(logging.INFO)


Verbose = Annotated[bool, typer.Option("--verbose", "-v", callback=_log_details, help="Log details on stderr.")]
Firmware = Annotated[Literal["ardupilot", "px4"], typer.Option(help="Dialect of the simulated autopilot.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random ground and flight.")]
Out = Annotated[Path, typer.Option("--out", metavar="OUT", help="Folder for the results.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask cluster that does the work: tcp://host:8786.")
]
Places = Annotated[
    Path | None,
    typer.Option("--places", metavar="FILE", help="Places of photos instead of their tags: geo.txt or CSV."),
]


Zones = Annotated[
    Path | None,
    typer.Option("--zones", metavar="FILE", help="GeoJSON of zones: where not to land, where only, where preferably."),
]
Topic = Annotated[
    list[str] | None,
    typer.Option("--topic", metavar="ROLE=TOPIC", help="Topic of a ROS bag for left, right, position, attitude, ..."),
]
TopicFile = Annotated[Path | None, typer.Option("--topics", metavar="FILE", help="The same as YAML: role: topic.")]


def named_topics(topics: Sequence[str] | None, file: Path | None) -> dict[str, str]:
    """Return the topics by role from `ROLE=TOPIC` texts and from a YAML file; the texts win.

    Raises:
        InputError: the file cannot be read.
        BadParameter: a text lacks its role.
    """
    from alight.sources.calibration import load_yaml

    out = {str(role): str(topic or "") for role, topic in (load_yaml(file) if file else {}).items()}
    for role, equals, topic in (text.partition("=") for text in topics or ()):
        if not equals:
            raise typer.BadParameter(f"--topic {role}: needs ROLE=TOPIC, such as left=/cam0/image_raw")
        out[role] = topic
    return out


@dataclass(kw_only=True)
class SettingsOptions:
    """Options of a command with settings."""

    settings: Annotated[Path | None, typer.Option("--settings", metavar="FILE", help="Settings as YAML.")] = None
    assign: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as lander.radius=2.")
    ] = None
    verbose: Verbose = False

    def read_settings(self, before: Sequence[str] = (), after: Sequence[str] = ()) -> Settings:
        """Return the settings from the file and the assignments; a later assignment overrides an earlier one.

        Args:
            before, after: `key=value` assignments by other options, applied before and after those of `--set`.

        Raises:
            SettingsError: the file cannot be read, a key is unknown, or a value is out of range.
        """
        from alight.records import SettingsError
        from alight.settings import load_settings

        text = yaml_text(self.settings) if self.settings else ""
        try:
            return load_settings(text, [*before, *(self.assign or ()), *after])
        except ValueError as e:
            error = e
        try:
            load_settings(text)
        except ValueError:  # the file alone is at fault
            raise SettingsError(f"{self.settings}: {error}") from error
        raise SettingsError(str(error)) from error


@dataclass(kw_only=True)
class ResultOptions(SettingsOptions):
    """Options of a command that writes the folder of a run."""

    out: Out
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that holds other files.")] = False


@dataclass(kw_only=True)
class RouteOptions(ResultOptions):
    """Options of a command whose route begins where the vehicle is armed."""

    home: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON,ALT_MSL", help="Where the vehicle is armed; heights of route.plan count from it."
        ),
    ] = None
    geoid: Annotated[
        Path | None,
        typer.Option(
            metavar="GRID",
            help="Geoid heights (EGM2008, GeoTIFF), for --home and for photos with heights above the sea.",
        ),
    ] = None


@dataclass(kw_only=True)
class ShownOptions:
    """Options of a command whose flight can be shown at its end."""

    film: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the flight as a film at the end: .mp4, .webp or .gif.")
    ] = None
    view: Annotated[bool, typer.Option("--view", help="Show the flight in three dimensions at the end (Rerun).")] = (
        False
    )

    def refuse_unshown(self) -> None:
        """Refuse what cannot be shown, before the flight.

        Raises:
            AlightError: the film has an unknown ending, or Rerun is not installed.
        """
        if self.film is not None:
            from alight.viewing.film import refuse_ending

            refuse_ending(self.film)
        if self.view:
            from alight.viewing.spatial import rerun_here

            rerun_here()

    def show(self, out: Path, recording: Path | None = None) -> None:
        """Draw and show the flight in the folder `out` if that is wanted; a failure is a warning, as the run is whole.

        Args:
            out: folder of the run.
            recording: see `ShownFlight`.
        """
        if self.film is None and not self.view:
            return
        from alight.cli import shown
        from alight.cli.terminal import print_stderr
        from alight.records import AlightError

        try:
            if self.film is not None:
                shown.film(out, self.film, recording)
            if self.view:
                shown.view(out, recording)
        except AlightError as e:
            print_stderr(f"warning: {e}")


def yaml_text(file: Path) -> str:
    """Read the text of a settings file.

    Raises:
        SettingsError: the file cannot be read.
    """
    from alight.documents import DocumentError, read_text
    from alight.records import SettingsError

    try:
        return read_text(file)
    except OSError as e:
        raise SettingsError(f"{file}: cannot be read ({e.strerror}); name a YAML file") from e
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e
