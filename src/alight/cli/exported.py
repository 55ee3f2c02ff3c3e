"""The command `export`: the results of a finished run for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line

File = Path | None


@app.command()
def export(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")],
    ros2: Annotated[File, typer.Option(metavar="F.mcap", help="Motion, map, sites and route for ROS 2.")] = None,
    gridmap: Annotated[File, typer.Option(metavar="F.mcap", help="The map alone, grid_map_msgs/GridMap.")] = None,
    kml: Annotated[File, typer.Option(metavar="F.kml", help="Sites and route, for Google Earth.")] = None,
    las: Annotated[File, typer.Option(metavar="F.las", help="The map as a cloud of points.")] = None,
    waypoints: Annotated[File, typer.Option(metavar="F.waypoints", help="The route as a MAVLink mission.")] = None,
    styles: Annotated[bool, typer.Option("--styles", help="Styles of QGIS beside the rasters of OUT.")] = False,
    verbose: options.Verbose = False,
) -> None:
    """Write the results of a finished run in formats of other tools."""
    from alight.outputs import export as formats
    from alight.outputs.atomic_write import write_whole

    found = formats.FinishedRun(out)
    files = {
        path: getattr(formats, name)
        for name, path in (("ros2", ros2), ("gridmap", gridmap), ("kml", kml), ("las", las), ("waypoints", waypoints))
        if path is not None
    }
    if not files and not styles:
        raise typer.BadParameter("name a file to write, such as --ros2 FILE.mcap")
    contents = {path: make(found) for path, make in files.items()}
    contents |= {out / name: text for name, text in (formats.styles(found) if styles else {}).items()}
    for path, content in contents.items():
        write_whole(path, content)
        print_line(str(path))
