"""Command that judges heights from another source: hazards."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_answer, print_line, print_stderr, progress_bar


def _lander(file: Path) -> list[str]:
    """The keys of a lander's file as assignments; they may stand alone or under `lander:`.

    Raises:
        SettingsError: the file cannot be read or holds no keys.
    """
    from alight.documents import DocumentError, parse_yaml
    from alight.records import SettingsError

    try:
        tree: Any = parse_yaml(options.yaml_text(file))
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e
    tree = tree.get("lander", tree) if isinstance(tree, dict) else tree
    if not isinstance(tree, dict) or not tree:
        raise SettingsError(f"{file}: needs keys of the lander such as 'radius: 1.5'; 'alight settings' lists them")
    return [f"lander.{key}={json.dumps(value, default=str)}" for key, value in tree.items()]


@app.command("hazards")
def judge_raster(
    dem: Annotated[Path, typer.Argument(metavar="DEM.tif", help="Heights in metres, square cells, north up.")],
    out: options.Out,
    sigma: Annotated[
        str | None, typer.Option(metavar="S.tif|METRES", help="1-sigma of the heights; default: their second band.")
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(metavar="I.tif", help="The same ground seen from above, 1, 2, 4, ... pixels a cell, 8 bit."),
    ] = None,
    lander: Annotated[
        Path | None, typer.Option(metavar="lander.yaml", help="Keys of the lander, as under 'lander' in the settings.")
    ] = None,
    settings: options.SettingsFile = None,
    assign: options.Assignments = None,
    force: options.Force = False,
    verbose: options.Verbose = False,
) -> None:
    """Judge any height raster: P(safe) and reasons of each cell, and the landing sites of this lander."""
    from alight.outputs.folder import prepare_folder
    from alight.runner import judge
    from alight.sources.raster import read_ground

    chosen = judge.for_surveyed_heights(
        options.read_settings(settings, [*(_lander(lander) if lander else ()), *(assign or ())])
    )
    ground = read_ground(dem, sigma, image, chosen.hazards.usual_sigma)
    prepare_folder(out, force, ground.files)
    with progress_bar() as report:
        report("judging", 0.0)
        judged = judge.judge_ground(ground, chosen, dem.name)
        report("judging", 1.0)
    result = judged.record
    assert result.hazards is not None
    share = 100 * float((result.hazards.reasons == 0).mean())
    for w in result.warnings:
        print_stderr(f"warning: {w}")
    print_answer(result.sites, lambda at: f"east {at[0]:.2f} north {at[1]:.2f}", f", {share:.1f} % is safe")
    judged.save(out, force)
    print_line(f"report: {out / 'report.html'}")
