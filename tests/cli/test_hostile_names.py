"""Names and texts from input: escaped in the report, spelt out on a terminal, whole in JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from damage import write_flight
from some_run import some_run

from alight.cli import call
from alight.outputs import write_run
from alight.report import render

HOSTILE = "\"><script>alert(1)</script><img src=x onerror=alert(1)>'&amp;{{7*7}}]]>\x1b[2J\x00\u202e"


class Elements(HTMLParser):
    """Elements of a page: their names, and the attributes that run code."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.acting: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.acting += [k for k, v in attrs if k.startswith("on") or "javascript:" in (v or "")]


def test_the_report_escapes_whatever_comes_in() -> None:
    healthy = Elements(render(some_run()))
    run = some_run(source_name=HOSTILE, warnings=[HOSTILE], notes={HOSTILE: HOSTILE, "camera": [HOSTILE]})
    run = replace(run, not_written={HOSTILE: HOSTILE}, sites=replace(run.sites, reason=HOSTILE))
    page = render(run)
    assert Elements(page).names <= healthy.names
    assert Elements(page).acting == []
    assert "&lt;script&gt;alert(1)" in page
    assert "{{7*7}}" in page  # no template is expanded either
    assert not {"\x1b", "\x00", "\u202e"} & set(page)


def test_json_holds_it_whole(tmp_path: Path) -> None:
    run = some_run(source_name=HOSTILE, warnings=[HOSTILE])
    write_run(run, tmp_path)
    tree = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert tree["input"]["name"] == HOSTILE
    assert tree["warnings"][0] == HOSTILE
    json.loads((tmp_path / "sites.geojson").read_text(encoding="utf-8"))


def test_a_hostile_folder_through_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = HOSTILE.replace("/", "").replace("\x00", "")
    flight = write_flight(tmp_path / name)
    (flight / "mav0" / "cam0" / "data" / "2.png").write_bytes(b"")
    assert call(["run", str(flight), "--out", str(tmp_path / f"{name}-out")]) == 0
    said = capsys.readouterr()
    assert not {"\x1b", "\u202e"} & set(said.out + said.err)
    page = (tmp_path / f"{name}-out" / "report.html").read_text(encoding="utf-8")
    assert "script" not in Elements(page).names
    assert Elements(page).acting == []
    assert call(["run", str(tmp_path / f"{name}-none"), "--out", str(tmp_path / "out2")]) == 2
    assert "\x1b" not in capsys.readouterr().err
