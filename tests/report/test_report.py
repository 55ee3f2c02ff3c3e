"""The HTML report of a run."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import cv2
import numpy as np
import pytest
from some_run import CELL, GRID, candidate, elevation, hazards, site, some_run, terrain

from alight.records import Datum, Flag, Hazard, NextView, RunResult, Sites, Terrain, p_safe_text
from alight.records.executive import FlightDiary, LookPicture, LookRecord
from alight.report import canvas, facts, figures, maps, paint, render, words
from alight.report.layers import layers_of
from alight.report.maps import film
from alight.settings import load_settings

VOID = {"meta", "image", "circle", "line", "path", "input"}


class Page(HTMLParser):
    """Check that every element is closed in order, and collect attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, k, v or "") for k, v in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, k, v or "") for k, v in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page() -> str:
    return render(some_run())


def without_scripts(text: str) -> str:
    return re.sub(r"<script>.*?</script>|<script type.*?</script>", "", text, flags=re.S)


def map_data(text: str) -> dict[str, Any]:
    """Return the data of the page's map."""
    return json.loads(re.search(r'<script type="application/json" id="map-data">(.*?)</script>', text, re.S).group(1))


def picture(uri: str) -> np.ndarray:
    data = np.frombuffer(base64.b64decode(uri.split(",", 1)[1]), np.uint8)
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), cv2.COLOR_BGRA2RGBA)


def test_the_answer_comes_first(page: str) -> None:
    headline = re.search(r"<h1>(.*?)</h1>", page, re.S).group(1)
    assert "Land here: 48.102282°\N{NO-BREAK SPACE}N, 15.441267°\N{NO-BREAK SPACE}E" in headline
    assert "Flat to 4 cm, 2.1° slope, 6.3 m clear. One more site in reserve." in page
    assert re.search(r"geo:48\.10228\d+,15\.44126\d+", headline)


def test_no_site_says_why() -> None:
    text = render(some_run(sites=Sites((), "everything is water"), route=None))
    assert "<h1>No safe site</h1>" in text
    assert "Everything is water." in text
    assert "Land here" not in text
    assert "Site 1" not in text
    assert render(some_run(sites=Sites((), "no safe site: fog"), route=None)).count("No safe site") == 2  # title too


def with_candidates(**changes: object) -> RunResult:
    """Return a run without a site, with a candidate that a view settles and one that none does."""
    blind = replace(candidate(2, 12.0, 6.0), look=None, doubt="ground")
    reason = "no safe site: of the seen ground 20 % is too steep"
    return some_run(**{"sites": Sites((), reason, candidates=(candidate(), blind)), "route": None, **changes})


def test_candidates_are_to_be_looked_at_and_not_landed_on() -> None:
    text = render(with_candidates())
    headline = re.search(r"<h1>(.*?)</h1>", text, re.S).group(1)
    assert "Look closer: two candidates" in headline
    assert "Land here" not in text
    assert "Do not land yet: no place reaches 95 %." in text
    assert ": look at it from 12 m above the ground." in text
    assert "Why no site: of the seen ground 20 % is too steep." in text
    assert "relief 0.990, unseen obstacles 0.63 (smallest that would be found: 22 cm), ground 0.995" in text
    assert "Candidate 1, the photo" in text
    told = facts.place_tables(with_candidates())
    assert [t.kind for t in told] == ["candidate"]
    assert [row.cells[-2:] for row in told[0].rows] == [
        ("unseen obstacles", "12 m above it"),
        ("kind of ground", "no nearer view settles it"),
    ]
    assert "View: 48.10229" in told[0].rows[0].note


def test_a_candidate_has_another_mark_than_a_site_and_its_height_beside_it() -> None:
    run = some_run(sites=Sites((site(),), candidates=(candidate(2, 12.0, 6.0),)))
    text = render(run)
    big = text.split('<figure class="big">')[1].split("</figure>")[0]
    assert big.count('<g class="pin site best"') == 2  # disc and number
    assert big.count('<g class="pin candidate"') == 2
    assert big.count("<rect") == 1
    assert ">look from 12 m</text>" in big
    assert "One candidate to look at again." in text
    assert [t.kind for t in facts.place_tables(run)] == ["site", "candidate"]


def test_a_view_that_is_too_high_still_and_one_from_straight_above_say_so() -> None:
    first = candidate()
    assert first.look is not None
    over = NextView(first.east, first.north, 10.0, 8.0, settles=False)
    note = (
        facts.place_tables(with_candidates(sites=Sites((), "", candidates=(replace(first, look=over),))))[0]
        .rows[0]
        .note
    )
    assert note.endswith("View: straight above; its pixels are still too coarse to settle the doubt")


def test_both_accuracies_stand_in_the_answer_and_a_place_that_is_too_vague_is_no_place_to_fly_to() -> None:
    """The clearance is 6.3 m: twice a sigma of 3 m is below it, twice a sigma of 4 m is above it."""
    for sigma, heed in ((3.0, False), (4.0, True)):
        placed = replace(elevation(), position_covariance=np.diag([sigma**2, 1.0, 6.25]))
        run = some_run(elevation=placed)
        told = dict(facts.answer(run).chips)
        assert told["Height within the map, 1-sigma"] == "± 3 cm"
        assert told["Place on Earth, 1-sigma"] == f"± {sigma:.1f} m across, ± 2.5 m up"
        cautions = facts.answer(run).cautions
        assert cautions[0].startswith("A program concluded this")
        assert any("Do not fly to the coordinates alone" in c for c in cautions) == heed
    assert dict(facts.answer(some_run()).chips)["Place on Earth, 1-sigma"] == "unknown"
    assert dict(facts.answer(some_run(georeferenced=False)).chips)["Place on Earth"] == "unknown"


def test_what_to_heed_stands_above_the_first_picture(page: str) -> None:
    assert page.index("not a clearance to land") < page.index("<figure")
    assert "<footer" not in page


def test_it_needs_nothing_but_itself(page: str) -> None:
    parsed = Page(page)
    assert parsed.open == []
    links = [v for _, k, v in parsed.attributes if k in {"href", "src", "xlink:href", "action"}]
    assert links
    assert all(v.startswith(("data:image/", "geo:", "#")) for v in links)
    policy = next(v for tag, k, v in parsed.attributes if tag == "meta" and v.startswith("default-src"))
    assert policy.startswith("default-src 'none'; img-src data:;")
    for word in ("<script", "http:", "https:", "@import", "url("):
        assert word not in without_scripts(page)


def test_names_from_outside_are_escaped(page: str) -> None:
    assert "meadow &lt;north&gt; &amp; pond" in page
    assert "<north>" not in page


def test_pictures_can_be_read_aloud(page: str) -> None:
    parsed = Page(page)
    count = sum(1 for tag, k, _ in parsed.attributes if tag == "svg" and k == "role")
    labels = [v for tag, k, v in parsed.attributes if tag == "svg" and k == "aria-label"]
    assert len(labels) == count == 1 + 3 + 1  # from above, two sites and a relief, the profile
    assert all(labels)
    assert len(set(labels)) == count


def test_warnings_settings_counts_and_notes_are_there(page: str) -> None:
    assert "nav0: 3 rows without attitude" in page
    assert "held at the calibration&#39;s 620.0 px" in page
    assert "frames dropped, file missing" in page
    settings = html.unescape(re.search(r"<pre.*?>(.*?)</pre>", page, re.S).group(1))
    assert load_settings(settings) == some_run().settings


def test_the_routes_warnings_are_told_once() -> None:
    run = some_run(warnings=["a", "b"])
    run = replace(run, route=replace(run.route, warnings=("b", "c")))
    assert facts.warnings(run) == ["a", "b", "c"]


@pytest.mark.parametrize("missing", ["elevation", "terrain", "hazards", "route", "height_above_ground"])
def test_a_run_that_lacks_something_still_has_a_page(missing: str) -> None:
    text = render(some_run(**{missing: None}))
    assert Page(text).open == []
    assert "Land here" in text


def test_a_map_that_nobody_saw_is_no_picture() -> None:
    e = elevation()
    unseen = replace(e, views=np.zeros_like(e.views), flags=np.full_like(e.flags, Flag.UNSEEN))
    text = render(some_run(elevation=unseen, sites=Sites((), "nothing was seen"), route=None))
    assert "<svg" not in text


def test_without_a_place_on_earth_metres_are_told() -> None:
    text = render(some_run(georeferenced=False))
    assert "Land here: 5.0 m east, 2.0 m south of the origin" in text
    assert "geo:" not in text
    assert "WGS84" not in text


def test_the_order_of_sites_and_their_quality_are_explained() -> None:
    """The first site is less sure than the second, but has more room."""
    near = replace(site(2, 12.0, 6.0), p_safe=0.971, clearance=0.6)
    (table,) = facts.place_tables(some_run(sites=Sites((site(), near))))
    assert [row.cells[1] for row in table.rows] == ["97.0 %", "97.1 %"]
    assert [row.note.split("; ")[1] for row in table.rows] == [
        "score 0.20: quality -0.20, room +1.00, doubt -0.60",
        "score -0.66: quality -0.20, room +0.12, doubt -0.58",
    ]
    assert "Sites are in order of score" in table.hint
    assert "Quality is 0 for level" in table.hint


def test_the_place_on_earth_is_one_number_everywhere() -> None:
    """The poses are known to 1 cm up, the heights to 8 cm: the ground's altitude is no better than its heights."""
    datum = Datum(0.0, 0.0, np.diag([0.08**2, 1e-6, 1e-6]))
    placed = replace(elevation(), position_covariance=np.diag([0.02**2, 0.01**2, 0.01**2]), datum=datum)
    run = some_run(elevation=placed)
    stated = {**dict(facts.answer(run).chips), **dict(facts.run_facts(run))}
    assert stated["Place on Earth, 1-sigma"] == "± 2 cm across, ± 8 cm up"
    assert stated["place of the whole map on Earth, 1-sigma"] == "± 2 cm across, ± 8 cm up"
    assert stated["Altitude, WGS84"] == "303.1 m"


def test_the_files_of_the_run_are_linked_and_missing_ones_explained() -> None:
    text = render(some_run(), {"dem.tif": "", "route.plan": "no route was planned"})
    assert '<a href="dem.tif">dem.tif</a></th><td>heights and their 1-sigma' in text
    assert "route.plan</th><td>not written: no route was planned" in text


def test_doubtful_land_cover_is_called_so() -> None:
    """Half of the pond is water with 30 %: a class that is less than two thirds sure."""
    cover = replace(terrain(), water=np.where(terrain().label == Terrain.WATER, 0.9, 0.0).astype(np.float32))
    cover.water[80:95] = 0.3
    layers = {layer.name: layer for layer in layers_of(some_run(terrain=cover), elevation())}
    field, colours = layers["cover"].field, layers["cover"].colours
    assert [field.values[field.codes[row, 120] - 1] for row in (85, 105)] == ["water, doubtful", "water"]
    assert [colours.codes[field.codes[row, 120] - 1] for row in (85, 105)] == ["#2f78be80", "#2f78be"]
    assert [(k.text, k.share) for k in colours.keys] == [
        ("short grass", "92.1 %"), ("water (3.9 % doubtful)", "7.9 %")
    ]  # fmt: skip


def test_unknown_numbers_are_called_unknown() -> None:
    odd = replace(site(), clearance=math.nan, heading=math.nan, radius=math.nan)
    text = render(some_run(sites=Sites((odd,))))
    assert "unknown clear" in text
    assert not re.search(r"[^a-z]nan[^a-z]", re.sub(r"data:image[^\"]*", "", without_scripts(text)))
    json.dumps(map_data(text), allow_nan=False)


def test_a_mark_lies_on_its_place() -> None:
    """The cell under the site is painted red: the mark must lie on the red of the picture."""
    e = elevation()
    row, col = 92, 68  # north -2, east 5
    assert (GRID.north - row * CELL, GRID.east + col * CELL) == (-2.0, 5.0)
    rgb = np.full_like(e.rgb, 120)
    rgb[row - 2 : row + 3, col - 2 : col + 3] = (255, 0, 0)
    run = some_run(elevation=replace(e, rgb=rgb))
    window = canvas.whole(run.elevation)
    for figure in (figures.overview(run, run.elevation, window), figures.closeups(run, run.elevation)[0]):
        image, mark = picture(figure.uri), figure.marks[-1]
        assert mark.rank == 1
        x, y = mark.x * image.shape[1] / canvas.WIDTH, mark.y * image.shape[0] / figure.height
        red = np.clip(image[..., 0].astype(float) - image[..., 1] - 40, 0, None)
        rows, cols = np.indices(red.shape) + 0.5  # a pixel's centre, counted from the picture's corner as the page does
        np.testing.assert_allclose(
            np.average([rows, cols], axis=(1, 2), weights=np.stack([red, red])), [y, x], atol=0.15
        )


def test_numbers_do_not_hide_other_sites() -> None:
    """Three sites lie in a row from south to north: a number above its disc would cover the next one."""
    row = Sites(tuple(site(i + 1, 5.0, -2.0 + 3.2 * i) for i in range(3)))
    run = some_run(sites=row)
    found = figures.marks(run, canvas.whole(run.elevation))
    badges = [(m.x + m.aside[0] * (m.r + 21), m.y + m.aside[1] * (m.r + 21)) for m in found]
    for m, (x, y) in zip(found, badges, strict=True):
        assert all(math.hypot(x - o.x, y - o.y) > o.r for o in found if o is not m)
        assert all(math.hypot(x - a, y - b) > 40 for a, b in badges if (a, b) != (x, y))


def test_the_height_to_look_from_covers_no_number() -> None:
    """Candidates above and below the first one: its text has to find room between their numbers."""
    row = tuple(candidate(i + 1, 5.0 + 0.4 * i, -2.0 + 3.4 * ((i + 1) // 2) * (-1) ** i) for i in range(5))
    run = some_run(sites=Sites((), "none", candidates=row))
    found = figures.marks(run, canvas.whole(run.elevation))
    (first,) = (m for m in found if m.look)
    assert first.rank == 1
    y = first.y + (first.r + 14) * (1 if first.aside[1] <= 0 else -1)
    for m in found:
        badge = m.x + m.aside[0] * (m.r + 21), m.y + m.aside[1] * (m.r + 21)
        assert abs(badge[1] - y) > 30 or abs(badge[0] - first.x) > 85


def test_a_footprint_is_drawn_to_scale() -> None:
    run = some_run()
    window = canvas.whole(run.elevation)
    mark, bar = figures.marks(run, window)[-1], figures.scale_bar(window)
    metres = float(bar.text.removesuffix(" m"))
    assert mark.r / bar.length == pytest.approx(run.settings.lander.radius / metres, abs=1e-3)
    assert metres in {1, 2, 5, 10}


def test_the_close_up_at_the_maps_edge_is_empty_beyond_it() -> None:
    window = canvas.about(GRID, GRID.east, GRID.north, 3.0)
    cut = window.cut(np.ones((*GRID.shape, 4), np.uint8))
    assert cut.shape[:2] == (25, 25)
    assert cut[12:, 12:].all()
    assert not cut[:12].any()
    assert not cut[:, :12].any()


def test_narrow_maps_get_a_canvas_that_fits_a_page() -> None:
    e = elevation()
    views = np.zeros_like(e.views)
    views[:, 80:85] = 3  # a strip, north to south
    window = canvas.whole(replace(e, views=views))
    assert window.height / canvas.WIDTH <= canvas.TALLEST * 1.02
    assert window.cut(views).sum() == views.sum()


def test_large_pictures_shrink_without_bleeding_the_unseen() -> None:
    rgba = np.zeros((300, 3000, 4), np.uint8)
    rgba[:, :1501] = (200, 100, 50, 255)
    small = canvas.shrink(rgba, 1000)
    assert small.shape == (100, 1000, 4)
    np.testing.assert_array_equal(small[:, 500, :3], np.tile([200, 100, 50], (100, 1)))  # the half-covered column
    assert 0 < small[0, 500, 3] < 255


def test_the_first_reason_wins_and_shares_add_up() -> None:
    names = list(paint.HAZARDS)
    bits = np.array([[0, Hazard.UNKNOWN, Hazard.UNKNOWN | Hazard.TERRAIN, Hazard.EDGE | Hazard.SLOPE]], np.uint16)
    index = paint.first_reason(bits, names)
    assert index[0, 0] == -1
    assert [names[i] for i in index[0, 1:]] == [Hazard.UNKNOWN, Hazard.TERRAIN, Hazard.SLOPE]
    keys = maps.reasons_figure(hazards(), elevation(), canvas.whole(elevation())).keys
    assert sum(float(k.share.removesuffix(" %")) for k in keys) == pytest.approx(100, abs=0.2)


def test_every_reason_has_a_colour_and_a_word() -> None:
    assert set(paint.HAZARDS) == set(Hazard)
    assert set(paint.FLAGS) == set(Flag)
    assert len({r.colour for r in paint.HAZARDS.values()} | {paint.SAFE_COLOUR}) == len(Hazard) + 1


def test_light_comes_from_the_north_west() -> None:
    r, c = np.mgrid[:40, :40].astype(np.float32)
    known = np.ones((40, 40), bool)

    def light(height: np.ndarray) -> float:
        return float(paint.hillshade(height.astype(np.float32), known, 1.0)[20, 20])

    assert light(0 * r) == pytest.approx(1.0)
    assert light(0.3 * (r + c)) > 1.02 > 0.98 > light(-0.3 * (r + c))  # rising to the south-east faces north-west
    assert light(0.3 * (r - c)) < 1.0  # across the light: only darker


def test_a_ramp_meets_its_ends() -> None:
    colours = paint.colour_ramp(np.array([-5.0, 0.0, 1.0, 9.0]), 0.0, 1.0, ("#102030", "#ff0000"))
    np.testing.assert_array_equal(colours, [[16, 32, 48], [16, 32, 48], [255, 0, 0], [255, 0, 0]])


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.004, "0.4 cm"), (0.04, "4 cm"), (0.32, "32 cm"), (1.0, "1.0 m"), (6.34, "6.3 m"), (math.nan, "unknown")],
)
def test_metres(value: float, text: str) -> None:
    assert words.metres(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(1.0, "100 %"), (0.99999, "> 99.9 %"), (0.0001, "< 0.1 %"), (0.0, "0 %"), (0.625, "62.5 %")]
)
def test_percent_of_shares(value: float, text: str) -> None:
    assert words.percent(value) == text


def test_notes_read_well() -> None:
    text = render(some_run(notes={"focal": "held", "gps_rms": [0.0227402, 1955.65002], "gps": {"RTK fixed": 32}}))
    assert "<td>0.02274, 1955.7</td>" in text
    assert ">gps rms<" in text
    assert "<td>RTK fixed: 32</td>" in text


def test_a_stray_cell_does_not_shrink_the_map() -> None:
    e = elevation()
    views = np.zeros_like(e.views)
    views[40:80, 60:100] = 5
    views[3, 3] = 5
    e = replace(e, views=views)
    assert canvas.whole(e).grid.shape == (40, 40)
    far = canvas.whole(e, [(GRID.east, GRID.north)])  # but every site is on it
    assert min(far.xy(GRID.east, GRID.north)) >= 0.0


def test_no_chance_is_certain() -> None:
    assert words.chance(1.0) == "> 99.9 %"
    assert words.chance(0.99) == "99.0 %"


@pytest.mark.parametrize(("p", "text"), [(0.62, "0.620"), (0.9994, "0.999"), (0.9996, "> 0.999"), (1.0, "> 0.999")])
def test_p_safe_is_never_rounded_up_to_1(p: float, text: str) -> None:
    assert p_safe_text(p) == text


def test_a_look_of_the_film_is_never_certain() -> None:
    photo = np.full((8, 8, 3), 90, np.uint8)
    look = LookPicture(LookRecord(1.0, (0.0, 0.0, 0.0), 6.0, "site", 1.0), photo, np.ones((8, 8), np.float32), 2.0)
    (figure,) = film(some_run(diary=FlightDiary([], [look.look], [look])))
    assert figure.caption == "at 1 s: site, P(safe) > 0.999"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (76e-6, "76 µs"), (0.00099999, "1 ms"), (0.0042, "4.2 ms"), (0.9999, "1 s"), (1.25, "1.25 s"),
        (99.7, "1 min 40 s"), (119.7, "2 min 0 s"), (125.0, "2 min 5 s"),
    ],
)  # fmt: skip
def test_seconds(value: float, text: str) -> None:
    assert words.seconds(value) == text


def test_bearings_have_three_figures() -> None:
    assert words.bearing(math.radians(-30)) == "330°"
    assert words.bearing(math.radians(359.8)) == "000°"
