"""The page on the report explains every reason, flag and key that a run can give."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from alight.records import Flag, Hazard
from alight.report import words

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reading-the-report.md").read_text(encoding="utf-8")
SOURCES = [p for part in ("pipeline", "landing", "motion") for p in (ROOT / "src" / "alight" / part).rglob("*.py")]
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)
NO = re.compile(r"^(no [a-z]+[^.]{12,}|the aircraft hardly .*|the photos .*|there is no GPS.*)$", re.S)


def sentences() -> list[str]:
    """Reasons for having no site, from the sources: the text of a string before the first number."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES]
    docs = {ast.get_docstring(n, clean=False) for t in trees for n in ast.walk(t) if isinstance(n, _DOCUMENTED)}
    found = {n.value for t in trees for n in ast.walk(t) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return sorted(s.strip() for s in found - docs if NO.match(s.strip()))


def shares() -> list[str]:
    """Texts about ground that a hazard refuses: the values of the table whose keys are hazards."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES if "landing" in path.parts]
    tables = [n for t in trees for n in ast.walk(t) if isinstance(n, ast.Dict) and n.keys]
    said = [v for d in tables if all(ast.unparse(k).startswith("Hazard.") for k in d.keys if k) for v in d.values]
    return [v.value for v in said if isinstance(v, ast.Constant) and isinstance(v.value, str)]


def test_the_sources_have_reasons() -> None:
    assert len(sentences()) >= 8
    assert len(shares()) == len(Hazard)


@pytest.mark.parametrize("sentence", sentences())
def test_a_reason_is_on_the_page(sentence: str) -> None:
    assert sentence.rstrip(":") in PAGE


@pytest.mark.parametrize("share", shares())
def test_a_share_of_the_ground_is_on_the_page(share: str) -> None:
    assert f"| {share} |" in PAGE


@pytest.mark.parametrize("hazard", list(Hazard))
def test_a_key_of_the_map_of_reasons_is_on_the_page(hazard: Hazard) -> None:
    assert f"| {words.HAZARDS[hazard]} | {hazard.name} |" in PAGE


@pytest.mark.parametrize("flag", list(Flag))
def test_a_key_of_the_map_of_flags_is_on_the_page(flag: Flag) -> None:
    assert f"| {words.FLAGS[flag]} | {flag.name} |" in PAGE


def errors() -> list[list[str]]:
    """The errors in the last table of the page, each split at the parts that a run fills in."""
    table = PAGE.split("### `alight run` stops with an error")[1].split("| --- | --- |")[1]
    said = [row.split("|")[1].strip() for row in table.strip().split("\n") if row.startswith("|")]
    return [[piece.strip() for piece in error.split("...") if piece.strip()] for error in said]


@pytest.mark.parametrize("pieces", errors(), ids=" ... ".join)
def test_an_error_of_the_page_is_one_of_the_code(pieces: list[str]) -> None:
    files = [
        p
        for part in ("sources", "outputs", "pipeline/mapping", "photos/reading", "runner")
        for p in (ROOT / "src" / "alight" / part).glob("*.py")
    ]
    said = re.compile(r"[^\n]*(?:\n[^\n]*)?".join(map(re.escape, pieces)))  # a message takes two lines at most
    assert any(said.search(path.read_text(encoding="utf-8")) for path in files)
