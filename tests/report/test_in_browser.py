"""The report in a browser: its map with mouse, keys and fingers, and the page without scripts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import BROWSER, Tab, open_tab
from some_run import CELL, GRID, LOCAL, candidate, elevation, site, some_run

from alight.geometry import ellipsoid_fall
from alight.records import Sites
from alight.report import render

pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs Chromium: apt-get install chromium")

ROW, COL = 92, 68  # the cell under site 1, north -2, east 5
READY = "document.documentElement.dataset.map === 'ready'"
PICTURE = "document.querySelector('.leaflet-picture-pane img').getBoundingClientRect()"


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with open_tab(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    run = some_run(sites=Sites((site(), site(2, 12.0, 6.0)), candidates=(candidate(3, 20.0, 15.0),)))
    path.write_text(render(run, {"dem.tif": "", "route.plan": "the disk is full"}))
    return path


@pytest.fixture
def shown(tab: Tab, page: Path) -> Tab:
    tab.requests.clear()
    tab.errors.clear()
    tab.open(page)
    tab.wait(READY)
    tab.run("document.getElementById('explore').scrollIntoView()")
    return tab


def spot(tab: Tab, row: float, col: float) -> tuple[float, float]:
    """Return the point of the window that shows a cell of the map; the picture shows the whole map."""
    x, y, width = tab.run(f"(({{x, y, width}}) => [x, y, width])({PICTURE})")
    return x + (col + 0.5) * width / GRID.cols, y + (row + 0.5) * width / GRID.cols


def facts(tab: Tab) -> dict[str, str]:
    return dict(
        tab.run(
            "[...document.querySelectorAll('#facts div')].map((row) => [...row.children].map((c) => c.textContent))"
        )
    )


def focus(tab: Tab, selector: str) -> None:
    tab.run(f"document.querySelector({selector!r}).focus()")


def test_nothing_is_requested_and_nothing_fails(shown: Tab, page: Path) -> None:
    for name in shown.run("[...document.querySelectorAll('#layers input')].map((i) => i.value)"):
        shown.run(f"document.querySelector('#layers input[value={name}]').click()")
    assert {url for url in shown.requests if not url.startswith("data:image/")} == {page.as_uri()}
    assert shown.errors == []


def test_the_probe_reads_what_the_map_holds(shown: Tab) -> None:
    shown.mouse(*spot(shown, ROW, COL), click=True)
    read, e = facts(shown), elevation()
    height, sigma = read["Height"].split(" ± ")
    up = LOCAL.height + float(e.height[ROW, COL] + ellipsoid_fall(GRID)[ROW, COL])
    assert float(height.removesuffix(" m")) == pytest.approx(up, abs=0.0101)
    assert sigma == "3 cm"
    assert read["P(safe)"] == "99.8 %"
    assert read["made of"] == "relief 99.0 %, unseen obstacles 99.0 %, ground 99.0 %"
    assert read["Land cover"].startswith("short grass (")
    assert read["Verdict"] == "fit for a touchdown"
    assert float(read["Slope"].removesuffix("°")) == pytest.approx(math.degrees(0.02), abs=0.1)
    latitude, longitude = (float(v) for v in shown.run("document.getElementById('where').value").split(", "))
    assert LOCAL.to_enu(latitude, longitude, LOCAL.height)[:2] == pytest.approx([5.0, -2.0], abs=CELL)


def test_a_refused_place_has_its_reasons(shown: Tab) -> None:
    shown.mouse(*spot(shown, 95, 125), click=True)  # in the pond
    read = facts(shown)
    assert read["Verdict"] == "wrong kind of ground; not seen or not trusted"
    assert read["Height"] == "moving: water, plants, traffic"
    assert read["P(safe)"] == "0 %, refused"


def test_the_ground_is_coloured_by_a_layer_that_fades(shown: Tab) -> None:
    shown.run("document.querySelector('#layers input[value=p_safe]').click()")
    assert shown.run("document.querySelectorAll('.leaflet-layer-pane canvas').length") == 1
    assert "worst heading" in shown.run("document.getElementById('legend').textContent")
    shown.run("(f => { f.value = 20; f.dispatchEvent(new Event('input')); })(document.getElementById('fade'))")
    assert shown.run("document.querySelector('.leaflet-layer-pane canvas').style.opacity") == "0.2"
    shown.run("document.querySelector('#layers input[value=picture]').click()")
    assert shown.run("document.querySelectorAll('.leaflet-layer-pane canvas').length") == 0


def test_keys_move_zoom_and_read_the_map(shown: Tab) -> None:
    focus(shown, "#map")
    x, width = shown.run(f"(({{x, width}}) => [x, width])({PICTURE})")
    shown.key("+")
    shown.wait(f"{PICTURE}.width > {1.3 * width}")
    x = shown.run(f"{PICTURE}.x")
    shown.key("ArrowRight")
    shown.wait(f"{PICTURE}.x < {x - 50}")
    shown.key("Enter")
    assert "P(safe)" in shown.run("document.getElementById('spoken').textContent")
    assert shown.run("document.querySelectorAll('.cross').length") == 1
    shown.key("Escape")
    assert shown.run("document.querySelectorAll('.cross').length") == 0


def test_rows_and_numbers_light_each_other(shown: Tab) -> None:
    focus(shown, "tbody[data-place='2'] a")
    assert shown.run("document.querySelector('#map .number.lit').textContent") == "2"
    focus(shown, "#map .number.candidate")
    assert shown.run("[...document.querySelectorAll('tbody.lit')].map((r) => r.dataset.place)") == ["3"]
    focus(shown, "tbody[data-place='2'] a")
    shown.key("Enter")
    shown.wait("document.querySelectorAll('.cross').length === 1")
    assert shown.run("document.activeElement.id") == "map"
    assert float(facts(shown)["Height"].split(" m")[0]) == pytest.approx(LOCAL.height + 2.18, abs=0.1)


def test_the_ruler_measures_metres(shown: Tab) -> None:
    shown.run("document.getElementById('ruler').click()")
    for row, col in ((60, 80), (100, 80)):
        shown.mouse(*spot(shown, row, col), click=True)
    assert float(shown.run("document.getElementById('measured').textContent").split(" m")[0]) == pytest.approx(
        10.0, abs=0.2
    )
    focus(shown, "#map")
    shown.key("Escape")
    assert shown.run("document.getElementById('measured').textContent") == ""


def test_numbers_do_not_cover_each_other_at_any_zoom(shown: Tab) -> None:
    for _ in range(3):
        boxes = shown.run(
            "[...document.querySelectorAll('#map .number')].map((b) => (({x, y}) => [x, y])(b.getBoundingClientRect()))"
        )
        assert len(boxes) == 3
        assert all(math.dist(a, b) >= 26 for a in boxes for b in boxes if a is not b)
        width = shown.run(f"{PICTURE}.width")
        focus(shown, "#map")
        shown.key("-")
        shown.wait(f"{PICTURE}.width < {0.8 * width} && !document.querySelector('.leaflet-zoom-anim')")


def test_a_finger_reads_the_map(tab: Tab, page: Path) -> None:
    tab.open(page, width=390, height=844, phone=True)
    tab.wait(READY)
    tab.run("document.getElementById('explore').scrollIntoView()")
    x, y = spot(tab, ROW, COL)
    tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
    tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    tab.wait("document.getElementById('facts').textContent.includes('99.8 %')")
    assert tab.run("document.documentElement.scrollWidth") <= 390  # nothing is wider than the window


def test_the_route_has_a_profile(shown: Tab) -> None:
    assert shown.run("document.querySelector('#profile h3').textContent") == "The route to site 1"
    assert re.fullmatch(
        r"The route to site 1: 21.4 m long, heights from 302.\d to 333.0 m",
        shown.run("document.querySelector('#profile svg').getAttribute('aria-label')"),
    )


def test_without_scripts_the_page_answers(tab: Tab, page: Path) -> None:
    tab.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        tab.open(page)
        assert "Land here" in tab.run("document.querySelector('h1').textContent")
        assert tab.run("document.querySelector('.static .big').getBoundingClientRect().height") > 300
        assert tab.run("document.getElementById('explore').getBoundingClientRect().height") == 0
    finally:
        tab.call("Emulation.setScriptExecutionDisabled", value=False)
