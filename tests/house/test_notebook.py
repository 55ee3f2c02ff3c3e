"""The notebook runs, cell by cell, and is kept without its outputs; a result shows itself in it."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from some_run import GRID, candidate, site, some_run

import alight
from alight.records import Sites
from alight.result import Result

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first-look.ipynb"


def cells(kind: str) -> list[dict[str, Any]]:
    return [c for c in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if c["cell_type"] == kind]


def test_the_notebook_has_no_outputs() -> None:
    assert all(c["outputs"] == [] and c["execution_count"] is None for c in cells("code"))
    assert len({c["id"] for c in cells("code") + cells("markdown")}) == len(cells("code")) + len(cells("markdown"))


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each cell as a notebook does: its last expression is shown."""
    monkeypatch.chdir(tmp_path)
    names, shown = dict[str, Any](), list[Any]()
    for cell in cells("code"):
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, str(NOTEBOOK), "exec"), names)
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names))
    assert [type(v) for v in shown] == [Result, Result]
    assert all("<svg" in v._repr_html_() for v in shown)
    assert shown[0].best is not None
    assert shown[0].settings.lander.radius != shown[1].settings.lander.radius


def test_a_result_shows_a_map_and_a_table() -> None:
    html = Result(some_run(sites=Sites((site(), site(2, 12.0, 6.0)), candidates=(candidate(3),))))._repr_html_()
    tree = ElementTree.fromstring(f"<div>{html}</div>")
    assert tree.findtext("p") == "meadow <north> & pond, two sites, one candidate"
    assert len(tree.findall("svg/circle")) == 3
    rows = [[cell.text or "" for cell in row] for row in tree.findall("table/tr")]
    assert [row[0] for row in rows] == ["", "site 1", "site 2", "candidate 3"]
    assert rows[1][2] == "2.1°"


def test_a_result_without_a_map_shows_its_reason() -> None:
    run = some_run(sites=Sites((), "fog"), elevation=None, terrain=None, hazards=None, route=None)
    assert Result(run)._repr_html_() == "<p>meadow &lt;north&gt; &amp; pond, fog</p>"


def test_rasters_have_their_coordinates() -> None:
    pytest.importorskip("xarray", reason="xarray is not installed")
    result = Result(some_run())
    rasters = result.to_xarray()
    east, north = GRID.xy()
    np.testing.assert_array_equal(rasters.p_safe.east, east)
    np.testing.assert_array_equal(rasters.p_safe.north, north)
    assert rasters.height.attrs["units"] == "m"
    assert "+proj=tmerc" in rasters.attrs["crs"]
    assert result.hazards is not None
    at = {"east": east[40], "north": north[70]}
    assert rasters.p_safe.sel(at).item() == result.hazards.p_safe[70, 40]
    assert np.isnan(rasters.height[0, 0])
    assert not Result(some_run(elevation=None, terrain=None, hazards=None)).to_xarray().variables


def test_without_xarray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(alight.AlightError, match=r"alight\[notebooks\]"):
        Result(some_run()).to_xarray()
