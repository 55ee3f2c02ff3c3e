"""Judging heights that somebody else made: hazards."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

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
    tell_site,
)
from alight.records import RunResult, SettingsError
from alight.settings import Settings

if TYPE_CHECKING:
    from alight.sources.raster import GroundRaster

# heights made elsewhere show what there is, and lie level, unless --set says otherwise
SURVEYED = ("tuning.hazards.smoothed=false", "tuning.hazards.tilt_sigma=0.003", "tuning.hazards.noise_length=0.4")


def _lander(file: Path | None) -> list[str]:
    """The keys of a lander's file as assignments; they may stand alone or under `lander:`.

    Raises:
        SettingsError: the file cannot be read or holds no keys.
    """
    if file is None:
        return []
    try:
        tree: Any = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as e:
        raise SettingsError(f"{file}: cannot be read ({getattr(e, 'strerror', None) or 'not text'})") from e
    except yaml.YAMLError as e:
        raise SettingsError(f"{file}: not valid YAML: {' '.join(str(e).split())}") from e
    tree = tree.get("lander", tree) if isinstance(tree, dict) else tree
    if not isinstance(tree, dict) or not tree:
        raise SettingsError(f"{file}: needs keys of the lander such as 'radius: 1.5'; 'alight settings' lists them")
    return [f"lander.{key}={json.dumps(value, default=str)}" for key, value in tree.items()]


def _judge(ground: GroundRaster, name: str, settings: Settings) -> tuple[RunResult, bool]:
    """Sharpen, judge and choose; and whether the image made the heights finer."""
    from alight import hazards
    from alight.geometry import LocalFrame
    from alight.hazards.sharpen import sharpen
    from alight.landing import sites

    warnings, elevation, clock = list(ground.warnings), ground.elevation, [time.perf_counter()]
    if ground.image is not None and ground.image.shape[0] > elevation.grid.rows:
        finer = sharpen(elevation, ground.image, settings.tuning.hazards.sharpen)
        if finer is None:
            warnings.append(
                "the image is not used: light and shade do not explain it (paint, plants, another time of day)"
            )
        elevation = finer or elevation
    clock.append(time.perf_counter())
    stages = settings.stages()
    verdict = hazards.assess(elevation, None, stages.lander, stages.hazards)
    clock.append(time.perf_counter())
    chosen = sites.choose_sites(verdict, None, elevation, stages.sites, stages.lander)
    result = RunResult(
        source_name=name,
        source_kind="heights",
        local=LocalFrame(0.0, 0.0, 0.0),
        georeferenced=False,  # the page shows the raster's own coordinates
        settings=settings,
        sites=chosen,
        elevation=elevation,
        hazards=verdict,
        warnings=warnings,
        timings={"sharpen": [clock[1] - clock[0]], "hazards": [clock[2] - clock[1]]},
    )
    return result, elevation is not ground.elevation


def _answer(result: RunResult) -> None:
    for w in result.warnings:
        complain(f"warning: {w}", "yellow")
    assert result.hazards is not None
    share = 100 * float((result.hazards.reasons == 0).mean())
    if not result.sites.sites:
        say(f"NO SITE  {result.sites.reason}")
        return
    s = result.sites.sites[0]
    found = f"{len(result.sites.sites)} found, {share:.1f} % is safe"
    tell_site(s, f"east {s.east:.2f} north {s.north:.2f}", found)


@app.command("hazards")
def judge(
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
    """Judge any height raster: where this lander may touch down, how surely, and why not elsewhere."""
    chosen = read_settings(settings, [*SURVEYED, *_lander(lander), *(assign or ())])
    from alight.outputs.folder import prepare_folder
    from alight.outputs.verdict import write_verdict
    from alight.sources.raster import read_ground

    ground = read_ground(dem, sigma, image, chosen.hazards.usual_sigma)
    prepare_folder(out, force)
    with progress_bar() as tell:
        tell("judging", 0.0)
        result, sharpened = _judge(ground, dem.name, chosen)
        tell("judging", 1.0)
    _answer(result)
    write_verdict(result, ground.crs, sharpened, out, force)
    say(f"report: {out / 'report.html'}")
