"""The command `export`: the results of a finished run for other tools."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line


@dataclass(kw_only=True)
class ExportOptions:
    """Options of `alight export`."""

    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")]
    ros2: Annotated[Path | None, typer.Option(metavar="F.mcap", help="Motion, map, sites, route for ROS 2.")] = None
    gridmap: Annotated[Path | None, typer.Option(metavar="F.mcap", help="The map alone, as a GridMap.")] = None
    kml: Annotated[Path | None, typer.Option(metavar="F.kml", help="Sites and route, for Google Earth.")] = None
    las: Annotated[Path | None, typer.Option(metavar="F.las", help="The map as a cloud of points.")] = None
    waypoints: Annotated[Path | None, typer.Option(metavar="FILE", help="The route as a MAVLink mission.")] = None
    styles: Annotated[bool, typer.Option("--styles", help="Styles of QGIS beside the rasters of OUT.")] = False
    verbose: options.Verbose = False


@app.command()
@options.command_of(ExportOptions)
def export(o: ExportOptions) -> None:
    """Write the results of a finished run in formats of other tools."""
    from alight.outputs import export as formats
    from alight.outputs.atomic_write import write_whole

    found = formats.FinishedRun(o.out)
    wanted = [
        (o.ros2, formats.ros2), (o.gridmap, formats.gridmap), (o.kml, formats.kml), (o.las, formats.las),
        (o.waypoints, formats.waypoints),
    ]  # fmt: skip
    files = {path: make(found) for path, make in wanted if path is not None}
    files |= {o.out / name: content for name, content in (formats.styles(found) if o.styles else {}).items()}
    if not files:
        raise typer.BadParameter("name a file to write, such as --ros2 FILE.mcap")
    for path, content in files.items():
        write_whole(path, content)
        print_line(str(path))
