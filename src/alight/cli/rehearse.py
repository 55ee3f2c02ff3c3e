"""Command that simulates a vehicle for fly: rehearse."""

from __future__ import annotations

import shlex
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alight.cli import options
from alight.cli.app import app
from alight.cli.terminal import print_line, print_stderr

if TYPE_CHECKING:
    from alight_sim.oracle import Touchdown

PLACE = (-20.0, -12.0)  # m east and north in the scene, where a rehearsal begins
NOT_DOWN = "it has not touched the ground"
PORT, HEIGHT = 14550, 30.0  # of a rehearsal; m above the ground


@app.command()
def rehearse(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="A scene file (YAML), or the name of a built-in scene.")
    ],
    folder: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Filled with the pictures: the --camera of alight fly.")
    ],
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of this machine, where alight fly listens.")] = PORT,
    seed: options.Seed = 0,
    height: Annotated[
        float, typer.Option(min=0.0, max=500.0, help="Metres above the ground at the start; 0: it stands.")
    ] = HEIGHT,
    width: Annotated[int, typer.Option(min=80, max=4000, help="Of the pictures, pixels; the height follows.")] = 320,
    rate: Annotated[float, typer.Option(min=1.0, max=100.0, help="Exposures a second.")] = 5.0,
    wind: Annotated[float, typer.Option(min=0.0, max=50.0, help="From the west, m/s.")] = 0.0,
    autopilot: options.Firmware = "ardupilot",
    follow: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Draw the pictures for another autopilot (a SITL) where it reports itself, on a link of its own: "
            "tcp:127.0.0.1:5762.",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="Then it ends.")] = 900.0,
    verbose: options.Verbose = False,
) -> None:
    """Simulate an autopilot and its cameras in real time, to try alight fly; Ctrl-C ends it."""
    if follow is not None:
        others = autopilot != "ardupilot"
        given = {"--port": port != PORT, "--height": height != HEIGHT, "--wind": wind > 0.0, "--autopilot": others}
        if any(given.values()):
            which = " and ".join(name for name, is_given in given.items() if is_given)
            from alight.records import InputError

            raise InputError(f"{which}: the autopilot that is followed decides that; leave it out, or --follow")
        _follow(follow, scene, seed, folder, width, rate, seconds)
        return
    from alight_sim.oracle import OracleLander
    from alight_sim.rehearsal import Rehearsal
    from alight_sim.steered import SteeredFlight
    from alight_sim.steered.touchdown import judge_flight

    lander = OracleLander()
    flight = SteeredFlight(
        scene, seed, size=_size(width), rate_hz=rate, start=(*PLACE, height), wind=(wind, 0.0, 0.0),
        radius=lander.reach,
    )  # fmt: skip
    with Rehearsal(flight, folder, port, autopilot == "px4") as rehearsal:
        print_line(f"ready: alight fly --link udp:127.0.0.1:{port} --camera {shlex.quote(str(folder))} --out OUT")
        try:
            rehearsal.wait(seconds, lambda: flight.contact is not None and not rehearsal.autopilot.logic.armed)
            rehearsal.wait(5.0)
        except KeyboardInterrupt:
            pass
    if rehearsal.server.behind > 1.0:  # s
        print_stderr(
            f"warning: the simulation was up to {rehearsal.server.behind:.0f} s behind the clock: this machine is too "
            "slow for it; lower --rate or --width",
            "yellow",
        )
    found = judge_flight(flight, lander)
    print_line(NOT_DOWN if found is None else _touchdown_words(found))


def _size(width: int) -> tuple[int, int]:
    return width, width * 3 // 4


def _follow(link: str, scene: str, seed: int, folder: Path, width: int, rate: float, seconds: float) -> None:
    from alight.trials.rehearse import follow_vehicle
    from alight_sim.followed import FollowedCameras

    cameras, found = FollowedCameras(scene, seed, size=_size(width), rate_hz=rate, start=PLACE), None
    with suppress(KeyboardInterrupt):
        found = follow_vehicle(link, cameras, folder, seconds, print_line)
    if cameras.left_out:
        print_stderr(f"warning: {cameras.left_out} exposures were left out: this machine is too slow for them")
    print_line(NOT_DOWN if found is None else _touchdown_words(found))


def _touchdown_words(found: Touchdown) -> str:
    verdict = "safe" if found.safe else f"unsafe ({', '.join(found.reasons)})"
    return f"touchdown at east {found.east:.2f} m north {found.north:.2f} m: {verdict}"
