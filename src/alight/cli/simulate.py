"""Command that makes simulated flights: simulate."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line, progress_bar

if TYPE_CHECKING:  # the simulator is slow to import, and most commands do not need it
    from alight_sim.scene import Scene

SHORTCUTS = {"height": "flight.height", "duration": "flight.duration", "speed": "flight.speed"}


@app.command()
def simulate(
    scene: Annotated[
        str | None, typer.Argument(metavar="SCENE", help="A scene file (YAML), or the name of a built-in scene.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FLIGHT", help="Folder for the flight log.")] = None,
    seed: options.Seed = 0,
    show: Annotated[bool, typer.Option("--list", help="Show the built-in scenes.")] = False,
    keys: Annotated[bool, typer.Option("--keys", help="Print every key of a scene file, as Markdown.")] = False,
    height: Annotated[float | None, typer.Option(help="Metres above the ground, instead of the scene's.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds of a transect or a hover.")] = None,
    speed: Annotated[float | None, typer.Option(help="Metres a second.")] = None,
    assign: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One key of the scene: light.clouds.share=0.4."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a simulated flight of that name.")] = False,
    verbose: options.Verbose = False,
) -> None:
    """Make a flight over simulated ground, with exact truth."""
    if show or keys:
        _print_scenes() if show else _print_keys()
        return
    if scene is None or out is None:
        raise typer.BadParameter("needs SCENE and --out FLIGHT; --list shows the built-in scenes")
    given = {"height": height, "duration": duration, "speed": speed}
    chosen = read(scene, [*(f"{SHORTCUTS[k]}={v}" for k, v in given.items() if v is not None), *(assign or ())], seed)
    _make(chosen, seed, out, force)


def _make(scene: Scene, seed: int, out: Path, force: bool) -> None:
    import alight_sim as simulator

    with progress_bar() as report:
        report("world", 0.0)
        flight = simulator.fly(scene, seed)
        report("world", 1.0)
        simulator.write(flight, out, lambda done, total: report("flying", done / total), overwrite=force)
    cameras = len(flight.rig.cameras)
    print_line(
        f"flight: {out}  ({scene.name}, seed {seed}: {flight.seconds:.1f} s, {flight.length} exposures of "
        f"{cameras} camera{'s' if cameras > 1 else ''}, truth beside them)"
    )
    results = out.with_name(f"{out.name}-run") if out.name not in ("", "..") else Path("run")
    made, found = shlex.quote(str(out)), shlex.quote(str(results))
    print_line(f"go on:  alight run {made} --out {found} && alight evaluate {found} --truth {made}")


def read(scene: str, assignments: list[str], seed: int = 0) -> Scene:
    """Read a built-in scene by its name or a scene file, with `key=value` assignments that win over it.

    `seed`: of the values that the scene file leaves to chance.

    Raises:
        InputError: there is no such scene, or it cannot be read.
        SettingsError: an assignment names no key, or its value is out of range.
    """
    from alight.documents import parse_yaml, read_text
    from alight.records import InputError, SettingsError
    from alight_sim.scene import built_in, parse_scene, read_scene

    path = built_in().get(scene, Path(scene))
    if not path.exists():
        raise InputError(f"{scene}: no such file and no built-in scene; 'alight simulate --list' shows those")
    found = read_scene(path, seed)
    if not assignments:
        return found
    tree = {"name": path.stem} | (parse_yaml(read_text(path)) or {})
    for a in assignments:
        _assign(tree, a)
    try:
        return parse_scene(tree, f"{scene} with {' '.join(assignments)}", path.parent, seed)
    except InputError as e:
        raise SettingsError(str(e)) from e


def _item(part: str) -> int:
    number = int(part)
    if number < 1:
        raise IndexError(part)
    return number - 1


def _assign(tree: dict[str, Any], assignment: str) -> None:
    """Put one value into the tree of a scene; items of a list are counted from 1."""
    from alight.documents import DocumentError, parse_yaml
    from alight.records import SettingsError

    key, sep, value = assignment.partition("=")
    if not sep or not all(part.strip() for part in key.split(".")):
        raise SettingsError(f"--set takes key=value, got {assignment!r}")
    try:
        wanted = parse_yaml(value)
    except DocumentError as e:
        raise SettingsError(f"--set {assignment}: {e}") from e
    *path, last = key.strip().split(".")
    at: Any = tree
    try:
        for part in path:
            at = at[_item(part)] if isinstance(at, list) else at.setdefault(part, {})
        at[_item(last) if isinstance(at, list) else last] = wanted
    except (ValueError, IndexError, TypeError, AttributeError) as e:
        raise SettingsError(f"--set {assignment}: does not fit the scene; its keys stand in the scene's file") from e


def _print_keys() -> None:
    from alight_sim.keys import reference

    print_line(reference().rstrip("\n"))


def _print_scenes() -> None:
    from rich.console import Console

    from alight.cli.display import scene_card
    from alight_sim.scene import FOLDER, built_in, read_scene

    console = Console()
    colour = console.is_terminal and console.color_system is not None
    for name, path in built_in().items():
        scene, picture = read_scene(path), FOLDER / "pictures" / f"{name}.jpg"
        if colour and picture.exists():
            console.print(scene_card(name, scene.description, picture))
        else:
            print_line(f"{name:<12} {scene.description}")
            print_line(f"{'':<12} {picture if picture.exists() else path}")
