"""Command that flies many landings in closed loop: campaign."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alight.cli.app import (
    WRONG,
    OutOption,
    SetOption,
    SettingsOption,
    VerboseOption,
    app,
    complain,
    read_settings,
    say,
)
from alight.records import InputError, p_safe_text
from alight.records.campaign import LARGEST_SEED, MOST_LANDINGS
from alight.records.telemetry import FirmwareName

if TYPE_CHECKING:
    from alight.trials.campaign import Campaign, Ended


@app.command()
def campaign(
    out: OutOption,
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="SCENES", help="Names, scene files, or 'all'; none: go on with OUT.")
    ] = None,
    worlds: Annotated[
        list[str] | None,
        typer.Option("--world", metavar="PACKAGE.MODULE:FACTORY", help="A world of another package; may be repeated."),
    ] = None,
    landings: Annotated[int | None, typer.Option(min=1, max=MOST_LANDINGS, help="How many landings; 20.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=LARGEST_SEED, help="Of everything that chance decides; 0.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes that fly landings on this machine.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask cluster instead: tcp://host:8786.")
    ] = None,
    only: Annotated[int | None, typer.Option(metavar="K", min=0, help="Fly landing K again and write nothing.")] = None,
    look_again: Annotated[
        bool | None, typer.Option("--look-again/--no-look-again", help="Look again from lower heights before landing.")
    ] = None,
    link_faults: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the landings with a takeover, a lost link, refused modes.")
    ] = 0.0,
    autopilot: Annotated[
        FirmwareName, typer.Option(help="Whose dialect the simulated autopilot speaks.")
    ] = "ardupilot",
    compare: Annotated[
        Path | None, typer.Option(metavar="OTHER", help="Another campaign, for a table of both.")
    ] = None,
    settings: SettingsOption = None,
    assign: SetOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Fly many simulated landings in closed loop and report their outcomes; an interrupted campaign is continued."""
    assign = [*(assign or []), *([] if look_again is None else [f"executive.look_again={str(look_again).lower()}"])]
    chosen = read_settings(settings, assign)
    from alight.trials import campaign as runner

    if wrong := [w for w in worlds or [] if not runner.is_factory(w)]:
        raise InputError(f"--world {wrong[0]}: {runner.FORM}")
    if named := [*(scenes or []), *(worlds or [])]:
        wanted = runner.wanted_landings(out, landings)
        planned = runner.Campaign.of(named, wanted, seed or 0, chosen, link_faults, autopilot)
    elif settings or assign or seed is not None or link_faults or autopilot != "ardupilot":
        raise InputError("name SCENES or --world beside the options of a new campaign; without, OUT's own are used")
    else:
        planned = runner.continued(out, landings)
    if only is not None:
        _again(planned, out, only)
        return
    numbers = runner.fly_campaign(planned, out, jobs, scheduler, compare, print_ended)
    for line in runner.outcome_lines(numbers):
        say(line)
    if compare is not None:
        for name, one, two in runner.comparison(numbers, runner.numbers_in(compare)):
            say(f"{name:<34} {one:>10} {two:>10}")
    say(f"report: {out / 'campaign.html'}")
    if failed := numbers.outcomes["failed"]:
        complain(f"{failed} landings failed: the report says why, and counts nothing of them as safe", "bold red")
        raise typer.Exit(WRONG)


def _again(planned: Campaign, out: Path, only: int) -> None:
    from alight.trials import campaign as runner

    found = runner.again(planned, out, only)
    say(found.record.model_dump_json())
    if found.differing:
        complain(f"landing {only} is not as in {out}: {', '.join(found.differing)}", "bold red")
        raise typer.Exit(WRONG)
    if found.not_compared is not None:
        complain(f"landing {only} was not compared: {found.not_compared}", "bold red")
        raise typer.Exit(WRONG)


def print_ended(ended: Ended) -> None:
    """Print a line on stderr for a landing that has ended."""
    r = ended.record
    parts = [
        f"#{r.number} {r.conditions.scene}: {r.outcome}",
        r.error or r.why if r.outcome != "landed safely" else "",
        "" if r.p_at_commit is None else f"P(safe) {p_safe_text(r.p_at_commit)}",
        *(f"with {f.what}" for f in r.conditions.faults if f.happened is not None),
        f"{r.seconds:.0f} s",
        f"{r.cpu_s:.0f} s of CPU",
        f"{_clock(ended.left_s)} left" if ended.done < ended.of else "",
    ]
    style = "none" if r.is_right else "yellow"
    complain(", ".join([f"{ended.done}/{ended.of}", *filter(None, parts)]), style)


def _clock(seconds: float) -> str:
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
