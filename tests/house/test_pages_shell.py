"""Commands on the pages exist in this version: shell lines are parsed, and options and settings are known."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
from parsed import ROOT, name_of, text_of

from alight.cli import app as application
from alight.cli.simulated import read_scene_with
from alight.settings import load_settings

LEFT_OUT = {"lab", "settings.md", "scene-keys.md", "commands.md"}  # of another day, or generated
PAGES = [p for p in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")) if not LEFT_OUT & {*p.parts}]
LINES = [
    pytest.param(line.strip(), id=f"{page.stem}: {line.partition(' #')[0].strip()}")
    for page in sorted(PAGES)
    for block in re.findall(r"^```sh\n(.*?)^```", text_of(page), re.S | re.M)
    for line in block.replace("\\\n", " ").splitlines()
]
INLINE = sorted({code for page in PAGES for code in re.findall(r"`(alight [a-z][^`\n]*)`", text_of(page))})
ASSIGNED = sorted(
    {
        found[0] or found[1]
        for page in PAGES
        for found in re.findall(r"--set (?:'([\w.]+=[^']+)'|([\w.]+=[^\s`']+))", text_of(page))
    }
    - {"KEY=VALUE"}
)
TARGETS = set(re.findall(r"^([a-z-]+):", text_of(ROOT / "Makefile"), re.M))
EXTRAS = set(tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]["optional-dependencies"])


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """Return the command that the words behind `alight` call, and its arguments."""
    command: Any = typer.main.get_command(application.app)
    while inner := getattr(command, "commands", None):
        assert words, f"{command.name} needs one of {', '.join(inner)}"
        assert words[0] in inner, f"no command '{words[0]}'"
        command, words = inner[words[0]], words[1:]
    return command, words


def parse(line: str) -> None:
    """Parse a line of a shell block as the shell and then the program that it calls would, without a file."""
    for part in re.split(r" && | > ", line):
        words = [word for word in shlex.split(part, comments=True) if not re.match(r"[A-Z_]+=", word)]
        if words[:1] == ["alight"]:
            command, arguments = command_of(words[1:])
            command.make_context(command.name, arguments)
        elif words[:1] == ["make"]:
            assert set(words[1:]) <= TARGETS
        elif words[:2] == ["pip", "install"]:
            assert set(re.findall(r"\[([\w,]+)\]", part)) <= EXTRAS


@pytest.mark.parametrize("line", LINES)
def test_a_line_of_a_shell_block_is_understood(line: str) -> None:
    parse(line)


@pytest.mark.parametrize("code", INLINE)
def test_a_command_in_a_sentence_has_the_options_that_it_names(code: str) -> None:
    words = code.split()[1:]
    if words != ["terrain"]:  # a group
        command, arguments = command_of(words)
        known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        assert {word for word in arguments if word.startswith("--")} <= known | {"--help"}


@pytest.mark.parametrize("assigned", ASSIGNED)
def test_a_setting_on_a_page_is_taken(assigned: str) -> None:
    """It is a setting, or a key of a scene."""
    try:
        load_settings("", [assigned])
    except ValueError:
        read_scene_with("demo", [assigned])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_an_extra_that_a_page_names_exists(page: Path) -> None:
    assert set(re.findall(r"alight\[(\w+)\]", text_of(page))) <= EXTRAS


@pytest.mark.parametrize(
    "line",
    [
        "alight run photos --out out --no-such-option",
        "alight no-such-command",
        "alight run photos",
        "alight run photos more --out out",
        "alight simulate demo --out out --height high",
        "make no-such-target",
        "pip install 'alight[no_such_extra]'",
    ],
)
def test_a_line_that_no_longer_fits_is_refused(line: str) -> None:
    with pytest.raises((AssertionError, application.UsageError)):
        parse(line)
