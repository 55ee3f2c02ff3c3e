"""All Python on the pages is run: every block of a page in turn, in an empty folder, as a reader would."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import alight
from alight_sim import SimulatedFlight

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("python", "your-data")


def blocks(page: str) -> list[tuple[int, str]]:
    """Line and text of every block of Python on a page that this version can run."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return [(text.count("\n", 0, m.start(1)), m[1]) for m in re.finditer(r"^```python\n(.*?)^```", text, re.S | re.M)]


class Reader:
    """Runner of the blocks of one page, in one namespace, each once and after all before it."""

    def __init__(self, page: str) -> None:
        self._page, self._left = page, blocks(page)
        self.names: dict[str, Any] = {"__name__": page}

    def read_to(self, line: int) -> None:
        """Run the block at `line`, and the blocks before it that have not been run."""
        while self._left and self._left[0][0] <= line:
            start, text = self._left.pop(0)
            exec(compile("\n" * start + text, str(DOCS / f"{self._page}.md"), "exec"), self.names)

    def read(self) -> dict[str, Any]:
        """Run the remaining blocks; return the names that the page has defined."""
        self.read_to(blocks(self._page)[-1][0])
        return self.names


@pytest.fixture(scope="module", autouse=True)
def _drawn_once() -> Iterator[None]:
    """Draw the pictures of a flight once; the examples write them, and then feed them."""
    draw = SimulatedFlight.events
    drawn = cache(lambda flight: tuple(draw(flight)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedFlight, "events", lambda flight: iter(drawn(flight)))
        yield


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Reader]]:
    """The folder and the reader of each page."""
    return {page: (tmp_path_factory.mktemp(page), Reader(page)) for page in PAGES}


@pytest.fixture
def reader(readers: dict[str, tuple[Path, Reader]], monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Reader]:
    """Return a function that gives the reader of a page, in the page's folder."""

    def of(page: str) -> Reader:
        folder, found = readers[page]
        monkeypatch.chdir(folder)
        return found

    return of


ALL = sorted(p.relative_to(DOCS).with_suffix("").as_posix() for p in DOCS.rglob("*.md") if "lab" not in p.parts)


@pytest.mark.parametrize("page", [p for p in ALL if blocks(p)])
def test_what_an_example_imports_is_there(page: str) -> None:
    """Examples that are not run are checked as well."""
    for _, code in blocks(page):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(node.module or "")
                assert all(hasattr(module, name.name) for name in node.names), ast.unparse(node)
            elif isinstance(node, ast.Import):
                assert all(importlib.import_module(name.name) for name in node.names)


EXAMPLES = [pytest.param(page, line + 1, id=f"{page}-{line + 1}") for page in PAGES for line, _ in blocks(page)]


@pytest.mark.parametrize(("page", "line"), EXAMPLES)
def test_an_example_runs(page: str, line: int, reader: Callable[[str], Reader]) -> None:
    reader(page).read_to(line)


def test_the_examples_find_a_site_and_its_place(reader: Callable[[str], Reader]) -> None:
    """The examples are only useful if their flight has a site."""
    names = reader("python").read()
    assert names["site"] is not None
    assert 47.62 < names["latitude"] < 47.63
    assert names["safe"].any()
    assert names["elevation"].grid.cell == 0.2
    assert "parallax.cel" in str(names["refused"])
    assert np.isfinite(names["height"]).any()


def test_the_heights_of_the_example_are_judged(reader: Callable[[str], Reader]) -> None:
    assert reader("python").read()["judged"].best is not None


def test_the_pipeline_of_the_example_decides(reader: Callable[[str], Reader]) -> None:
    names = reader("python").read()
    assert len(names["decision"].motions) == names["flight"].length


def test_the_flight_log_of_the_page_is_read_without_a_warning(reader: Callable[[str], Reader]) -> None:
    names = reader("your-data").read()
    assert names["source"].length == len(names["frames"]) == 9
    assert names["source"].warnings == []


def test_the_example_of_the_readme_reads_a_result(
    reader: Callable[[str], Reader], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = reader("python").read()["result"]
    monkeypatch.setattr(alight, "run", lambda source, lander: result)
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    exec(compile(readme.split("```python\n")[1].split("```")[0], "README.md", "exec"), {})
    assert "P(safe)" in capsys.readouterr().out


@pytest.mark.parametrize("imported", ["SteeredFlight", "SceneTruth"])
def test_an_example_of_the_simulator_runs(imported: str) -> None:
    """A landing in closed loop, and ground of one's own; the longer examples only have their imports checked."""
    (code,) = (code for _, code in blocks("simulator") if re.search(rf"^from .*\b{imported}\b", code, re.M))
    exec(compile(code, "docs/simulator.md", "exec"), {"__name__": "simulator"})
