"""Command that judges heights from another source: hazards."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from alight.cli.app import (
    ForceOption,
    OutOption,
    SetOption,
    SettingsOption,
    VerboseOption,
    app,
    complain,
    progress_bar,
    read_settings,
    say,
    tell_answer,
)
from alight.documents import DocumentError, parse_yaml, read_text
from alight.records import RunResult, SettingsError


def _lander(file: Path | None) -> list[str]:
    """The keys of a lander's file as assignments; they may stand alone or under `lander:`.

    Raises:
        SettingsError: the file cannot be read or holds no keys.
    """
    if file is None:
        return []
    try:
        tree: Any = parse_yaml(read_text(file))
    except OSError as e:
        raise SettingsError(f"{file}: cannot be read ({e.strerror}); name a YAML file") from e
    except DocumentError as e:
        raise SettingsError(f"{file}: {e}") from e
    tree = tree.get("lander", tree) if isinstance(tree, dict) else tree
    if not isinstance(tree, dict) or not tree:
        raise SettingsError(f"{file}: needs keys of the lander such as 'radius: 1.5'; 'alight settings' lists them")
    return [f"lander.{key}={json.dumps(value, default=str)}" for key, value in tree.items()]


def _answer(result: RunResult) -> None:
    for w in result.warnings:
        complain(f"warning: {w}", "yellow")
    assert result.hazards is not None
    share = 100 * float((result.hazards.reasons == 0).mean())
    tell_answer(result.sites, lambda at: f"east {at[0]:.2f} north {at[1]:.2f}", f", {share:.1f} % is safe")


@app.command("hazards")
def judge_raster(
    dem: Annotated[Path, typer.Argument(metavar="DEM.tif", help="Heights in metres, square cells, north up.")],
    out: OutOption,
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
    settings: SettingsOption = None,
    assign: SetOption = None,
    force: ForceOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Judge any height raster: P(safe) and reasons of each cell, and the landing sites of this lander."""
    from alight.outputs.folder import prepare_folder
    from alight.runner import judge
    from alight.sources.raster import read_ground

    chosen = judge.for_surveyed_heights(read_settings(settings, [*_lander(lander), *(assign or ())]))
    ground = read_ground(dem, sigma, image, chosen.hazards.usual_sigma)
    prepare_folder(out, force, ground.files)
    with progress_bar() as tell:
        tell("judging", 0.0)
        judgement = judge.judge_ground(ground, chosen, dem.name)
        tell("judging", 1.0)
    _answer(judgement.result)
    judgement.save(out, force)
    say(f"report: {out / 'report.html'}")
