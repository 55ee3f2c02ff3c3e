"""Tables of the pages that name the function which decides something: it is there, and each decision has one."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from parsed import PACKAGE, ROOT, text_of, tree_of

ARCHITECTURE = ROOT / "docs" / "architecture.md"
METHOD = [p for p in sorted((ROOT / "docs" / "method").glob("*.md")) if p.name != "README.md"]
TEN = {
    "keyframe", "cell size", "height", "sigma", "outlier", "P(safe)", "site", "abort", "set-point", "takeover",
}  # fmt: skip
PLACE = re.compile(r"`([\w/]+\.py):([\w.]+)`")


def rows(page: Path, heading: str) -> Iterator[tuple[str, str, str]]:
    """Yield (decision, cell with its place, the rest of the row) of the table under a heading."""
    text = text_of(page)
    assert text.count(f"\n{heading}\n") == 1, f"{page.name}: one table '{heading}'"
    for line in text.split(f"\n{heading}\n")[1].strip().split("\n")[2:]:
        if not line.startswith("|"):
            return
        decision, place, *rest = (cell.strip() for cell in line.strip("|").split("|"))
        yield decision, place, " ".join(rest)


def defined(body: list[ast.stmt], name: str) -> ast.stmt | None:
    """The statement that defines a name in a module or a class; None: none does."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return node
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        if any(isinstance(t, ast.Name) and t.id == name for t in targets):
            return node
    return None


IN_ARCHITECTURE = list(rows(ARCHITECTURE, "## Which line decides"))
IN_METHOD = {page.stem: list(rows(page, "## Where it is decided")) for page in METHOD}
NAMED = sorted(
    {
        place
        for found in (IN_ARCHITECTURE, *IN_METHOD.values())
        for row in found
        for place in PLACE.findall(" ".join(row))
    }
)


@pytest.mark.parametrize(("file", "path"), NAMED)
def test_what_a_page_names_is_there(file: str, path: str) -> None:
    body = tree_of(PACKAGE / file).body
    for name in path.split("."):
        found = defined(body, name)
        assert found is not None, f"{file} defines no {path}"
        body = getattr(found, "body", [])


def test_each_question_has_one_place() -> None:
    questions = [question for question, _, _ in IN_ARCHITECTURE]
    assert (len(questions), set(questions)) == (len(TEN), TEN)
    for question, place, _ in IN_ARCHITECTURE:
        assert PLACE.fullmatch(place), question


@pytest.mark.parametrize("page", IN_METHOD)
def test_a_method_page_names_the_same_places(page: str) -> None:
    places = {question: place for question, place, _ in IN_ARCHITECTURE}
    assert IN_METHOD[page]
    for decision, place, _ in IN_METHOD[page]:
        assert PLACE.fullmatch(place), decision
        assert places.get(decision, place) == place, decision
