"""The page on the report explains every reason, flag and key that a run can give."""

from __future__ import annotations

import ast
import re

import pytest
from parsed import PACKAGE, ROOT, nodes_of, text_of

from alight.records import Flag, Hazard
from alight.report import paint

PAGE = text_of(ROOT / "docs" / "reading-the-report.md")
STAGES = [p for part in ("pipeline", "landing", "motion") for p in (PACKAGE / part).rglob("*.py")]
NO = re.compile(r"^(no [a-z]+[^.]{12,}|the aircraft hardly .*|the photos .*|there is no GPS.*)$", re.S)


def sentences() -> list[str]:
    """Reasons for having no site, from the sources: the text of a string before the first number."""
    nodes = [node for path in STAGES for node in nodes_of(path)]
    documented = ast.Module | ast.ClassDef | ast.FunctionDef
    docs = {ast.get_docstring(n, clean=False) for n in nodes if isinstance(n, documented)}
    found = {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return sorted(s.strip() for s in found - docs if NO.match(s.strip()))


def shares() -> list[str]:
    """Texts about ground that a hazard refuses: the values of the table whose keys are hazards."""
    landing = [path for path in STAGES if "landing" in path.parts]
    tables = [n for path in landing for n in nodes_of(path) if isinstance(n, ast.Dict) and n.keys]
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
    assert f"| {paint.HAZARDS[hazard].text} | {hazard.name} |" in PAGE


@pytest.mark.parametrize("flag", list(Flag))
def test_a_key_of_the_map_of_flags_is_on_the_page(flag: Flag) -> None:
    assert f"| {paint.FLAGS[flag].text} | {flag.name} |" in PAGE
