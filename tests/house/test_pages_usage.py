"""The page on the command line has every command, and no option that does not exist."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import typer

from alight.cli import app as application

PAGE = (Path(__file__).parents[2] / "docs" / "usage.md").read_text(encoding="utf-8")
EVERYWHERE = {"--help", "--verbose", "-v", "--version"}


def commands() -> dict[str, Any]:
    """Commands by the words that call them."""
    top = typer.main.get_command(application.app)
    found: dict[str, Any] = {}
    for name, command in top.commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        found |= {f"{name} {sub}": c for sub, c in inner.items()} if inner else {name: command}
    return found


def section(name: str) -> str:
    """Return the section on a command: the text from the heading with its name to the next heading."""
    parts = re.split(r"^## ", PAGE, flags=re.M)
    return "\n".join(p for p in parts if re.search(rf"`alight {name}\b", p.split("\n")[0]))


def options(command: Any) -> set[str]:
    """Return the options of a command, as they are typed."""
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("--")}


@pytest.mark.parametrize("name", sorted(commands()))
def test_every_command_has_a_section_and_explains_its_options(name: str) -> None:
    assert section(name), f"usage.md has no section on 'alight {name}'"
    assert not [p.name for p in commands()[name].params if not p.help]


@pytest.mark.parametrize("name", sorted(commands()))
def test_a_section_names_no_option_that_no_command_has(name: str) -> None:
    known = set.union(*(options(c) for c in commands().values())) | EVERYWHERE
    assert not set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]+", section(name))) - known


def test_the_readme_names_every_command_and_no_other() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    table = readme.split("## Commands")[1].split("\n\nWhat a run writes")[0]
    assert {name.split()[0] for name in commands()} - set(re.findall(r"`alight ([a-z]+)", table)) == set()
    assert set(re.findall(r"`alight ([a-z]+)", readme)) <= {name.split()[0] for name in commands()}
