"""Agreement of the pages with the code: constants, names of files, links; and the length of pages for readers."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parsed import ROOT, name_of, nodes_of, text_of

from alight.settings import Settings

DOCS = ROOT / "docs"
METHOD = sorted((DOCS / "method").glob("*.md"))
GENERATED = {DOCS / "settings.md", DOCS / "scene-keys.md", DOCS / "commands.md"}  # by `make pages`, where that was run
PAGES = sorted({*ROOT.glob("*.md"), *DOCS.rglob("*.md")} - GENERATED)
PRESENT = [p for p in PAGES if p.parent != DOCS / "lab"]  # a dated page names the files of its day
TREE = [p.relative_to(ROOT).as_posix() for part in ("src", "tests", "bench") for p in (ROOT / part).rglob("*.py")]
MOST_WORDS, MOST_IN_SENTENCE = 1000, 30  # the latter of nine in ten sentences
MOST_FOR_USERS = 25  # words of nine in ten sentences
HEADING = "## Constants quoted here"
Number = int | float


def prose(text: str) -> str:
    """Return a page without its code, equations, tables and headings."""
    text = re.sub(r"```.*?```|\$\$.*?\$\$", " ", text, flags=re.S)
    return "\n".join(row for row in text.split("\n") if not row.lstrip().startswith(("|", "#")))


def sentences(text: str) -> list[int]:
    """Number of words of each sentence."""
    return [len(part.split()) for part in re.split(r"[.!?:]\s+", prose(text)) if part.split()]


def quoted(page: Path) -> Iterator[tuple[str, str, str]]:
    """Yield (module or group of settings, path in it, value) of every constant of the page's list."""
    text = text_of(page)
    assert text.count(HEADING) == 1, f"{page.name}: one list of constants"
    listed = re.search(r"\n```\n(.*?)\n```", text.split(HEADING)[1], re.S)
    assert listed, f"{page.name}: the list of constants is a code block"
    for line in re.sub(r"\n +", " ", listed[1]).split("\n"):
        group, _, constants = line.partition(": ")
        for constant in constants.split("; "):
            path, _, value = constant.strip().partition(" ")
            yield group, path, value


DESCRIBED = [page for page in METHOD if page.name != "README.md"]
QUOTED = [pytest.param(*row, id=f"{p.stem}-{row[1]}-{i}") for p in DESCRIBED for i, row in enumerate(quoted(p))]


def literals(module: str, function: str) -> set[Number]:
    """Numbers in the body of a function; it is not imported, so that no kernel is compiled for it."""
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    body = next(n for n in nodes_of(Path(spec.origin)) if isinstance(n, ast.FunctionDef) and n.name == function)
    constants = (n.value for n in ast.walk(body) if isinstance(n, ast.Constant))
    return {c for c in constants if isinstance(c, int | float) and not isinstance(c, bool)}


def looked_up(root: Any, path: str) -> Any:
    """Look up `a.b.c` in a module, a model or a table."""
    for part in path.split("."):
        root = root[part] if isinstance(root, dict) else getattr(root, part)
    return root


def number(text: str) -> float:
    """Read a number of a page; a number with ` deg` is converted to radians."""
    return math.radians(float(text.removesuffix(" deg"))) if text.endswith(" deg") else float(text)


def agrees(value: str, found: Any) -> bool:
    """Return whether a page's value agrees with the code: a word, true or false, one number or several."""
    if isinstance(found, str | bool):
        return value == str(found)
    said = [number(v) for v in value.split(", ")]
    has = np.atleast_1d(np.asarray(found, dtype=float))
    return has.shape == (len(said),) and bool(np.isclose(has, said, rtol=1e-6, atol=0).all())


@pytest.mark.parametrize(("group", "path", "value"), QUOTED)
def test_a_quoted_constant_is_that_of_the_code(group: str, path: str, value: str) -> None:
    if not group.startswith("alight."):
        found = looked_up(Settings(), f"{group}.{path}")
        assert agrees(value, found), found
        return
    found = getattr(importlib.import_module(group), path.split(".")[0])
    if callable(found) and not isinstance(found, type):
        stand = literals(group, path)
        said = [abs(number(v)) for v in value.split(", ")]
        assert all(any(math.isclose(v, s) for s in stand) for v in said), stand
    else:
        found = looked_up(importlib.import_module(group), path)
        assert agrees(value, found), found


@pytest.mark.parametrize("page", METHOD, ids=name_of)
def test_a_method_page_is_short_and_in_short_sentences(page: Path) -> None:
    lengths = sorted(sentences(text_of(page)))
    assert sum(lengths) <= MOST_WORDS
    assert lengths[int(0.9 * (len(lengths) - 1))] <= MOST_IN_SENTENCE


@pytest.mark.parametrize("page", ["start", "your-data", "python", "reading-the-report", "usage"])
def test_a_page_for_users_is_in_short_sentences(page: str) -> None:
    lengths = sorted(sentences(text_of(ROOT / "docs" / f"{page}.md")))
    assert lengths[int(0.9 * (len(lengths) - 1))] <= MOST_FOR_USERS


@pytest.mark.parametrize("page", METHOD, ids=name_of)
def test_a_method_page_has_one_drawn_figure(page: Path) -> None:
    figures = re.findall(r"!\[[^\]]+\]\((figures/[^)]+\.svg)\)", text_of(page))
    assert len(figures) == 1
    assert text_of(page.parent / figures[0]).startswith("<svg ")


def spoken(path: Path) -> str:
    """Return the comments and docstrings of a file."""
    documented = [node for node in nodes_of(path) if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
    comments = re.findall(r"#.*", text_of(path))
    return "\n".join([*(ast.get_docstring(node) or "" for node in documented), *comments])


def test_every_equation_that_the_code_cites_is_on_a_method_page() -> None:
    pages = "\n".join(text_of(page) for page in METHOD)
    code = "\n".join(spoken(ROOT / path) for path in TREE if path.startswith("src/"))
    labels = set(re.findall(r"\b[MGTS]\d{1,2}[a-z]?\b", code))
    numbers = set(re.findall(r"\beqs?\. (\d+[a-z]?)", code))
    assert len(labels) > 30
    assert len(numbers) > 10
    assert not [label for label in sorted(labels) if not re.search(rf"\({label}\b", pages)]
    assert not [n for n in sorted(numbers) if f"\\tag{{{n}}}" not in pages and f"({n})" not in pages]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files_and_headings_that_exist(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", " ", text_of(page), flags=re.S)
    for target, heading in re.findall(r"\]\(([^)#:\s]*)(?:#([^)]*))?\)", text):
        linked = page.parent / target if target else page
        assert linked.exists(), f"{page.name}: {target}"
        if heading:
            assert heading in anchors(linked), f"{page.name}: {target}#{heading}"


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as links write them."""
    titles = re.findall(r"^#+ +(.+)$", text_of(page), re.M)
    return {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}


@pytest.mark.parametrize("page", PRESENT, ids=name_of)
def test_a_python_file_that_a_page_names_is_there(page: Path) -> None:
    for code in re.findall(r"`([^`\n]+)`", text_of(page)):
        for named in re.findall(r"[\w./-]+\.py\b", code):
            assert any(f"/{path}".endswith(f"/{named.removeprefix('./')}") for path in TREE), f"{page.name}: {named}"


def test_every_page_can_be_reached_from_the_first_one() -> None:
    reached, ahead = set[Path](), [ROOT / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in reached or not page.exists():
            continue
        reached.add(page)
        links = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text_of(page))
        ahead += [target for t in links if (target := (page.parent / t).resolve()).suffix == ".md"]
        ahead += [page.parent / t / "README.md" for t in links if (page.parent / t).is_dir()]
    left = {p for p in PAGES if p.resolve() not in {r.resolve() for r in reached}}
    assert not left


@pytest.mark.parametrize(
    ("value", "found", "same"),
    [
        ("0.5", 0.5, True),
        ("0.5", np.float32(0.5), True),
        ("0.5", 0.6, False),
        ("10 deg", math.radians(10.0), True),
        ("1, 2", (1, 2), True),
        ("1, 2", (1, 2, 3), False),
        ("held", "held", True),
        ("held", "free", False),
        ("True", False, False),
    ],
)
def test_a_value_that_differs_is_found(value: str, found: object, same: bool) -> None:
    assert agrees(value, found) is same
