"""Labels drawn by eye: the file, its checks, the page for drawing, and the labels on a run's map."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from label_file import KINDS, Label, Labels, labels_json, problems, read_labels
from label_projection import PhotoCells, filled, hidden, labelled_map, photo_camera_of, pixels_within
from labelled import compare, table

from alight.geometry import Camera, Grid, LocalFrame, Pose
from alight.outputs.reading import Run
from alight.photos.reading.photo_pose import BODY_FROM_CAM

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "training"))
import label as tool  # noqa: E402

FILES = sorted((ROOT / "bench" / "labels").glob("*.json"))
SIZE = 200, 100  # px
CAMERA = Camera(*SIZE, 100.0, 100.0, 99.5, 49.5)
ABOVE = 20.0  # metres: a pixel is 0.2 m
GRID = Grid(-24.96, 14.97, 0.2, 151, 251)
LOOK_DOWN = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, ABOVE]))  # u east, v south
BUSH = Label("a.jpg", "bush_or_tall_plants", np.array([[20.0, 20.0], [40.0, 20.0], [40.0, 40.0], [20.0, 40.0]]))
LAWN = Label("a.jpg", "lawn", np.array([[10.0, 10.0], [190.0, 10.0], [190.0, 90.0], [10.0, 90.0]]))


def labels_of(*polygons: Label) -> Labels:
    return Labels("here", *SIZE, {"a.jpg": 5, "b.jpg": 7}, polygons)


def ring(label: Label, *vertices: tuple[float, float]) -> Label:
    return replace(label, ring=np.array(vertices, np.float64))


def some_run(folder: Path, safe: np.ndarray, height: np.ndarray | None = None) -> Run:
    """Write a run over photo `a.jpg`, which was taken straight down over flat ground."""
    local = LocalFrame(48.0, 11.0, 500.0)
    w, x, y, z = (LOOK_DOWN @ BODY_FROM_CAM.inverse).quaternion
    (folder / "trajectory.tum").write_text(f"0.000000005 0 0 {ABOVE} {x} {y} {z} {w}\n")
    site = {"rank": 1, "p_safe": 0.99, "east_m": -14.0, "north_m": 4.0}
    (folder / "sites.geojson").write_text(json.dumps({"features": [{"properties": site}]}))
    notes = {"focal_px": [100.0, 100.0], "principal_point_px": [99.5, 49.5], "distortion": [], "image_size": SIZE}
    info = {"notes": notes, "settings": {"sources": {"calibration": None}, "lander": {"radius": 1.0}}}
    height = np.full(GRID.shape, 500.0, np.float32) if height is None else height
    ortho = np.zeros((*GRID.shape, 3), np.uint8)
    flags = np.zeros(GRID.shape, np.uint16)
    return Run(folder, info, local, GRID, height, height * 0, flags, None, safe.astype(np.float32), None, ortho)


def everywhere(p: float) -> np.ndarray:
    return np.full(GRID.shape, p)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_the_files_of_labels_are_valid(path: Path) -> None:
    labels = read_labels(path)
    assert problems(labels) == []
    assert len(labels.polygons) >= 40
    assert labels_json(labels) == path.read_text(encoding="utf-8")


def test_a_file_of_labels_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "here.json"
    path.write_text(labels_json(labels_of(replace(BUSH, note="a note"), LAWN)))
    back = read_labels(path)
    assert (back.name, back.width, back.height, back.times) == ("here", *SIZE, {"a.jpg": 5, "b.jpg": 7})
    assert [(p.photo, p.kind, p.note) for p in back.polygons] == [
        ("a.jpg", "bush_or_tall_plants", "a note"),
        ("a.jpg", "lawn", ""),
    ]
    np.testing.assert_array_equal(back.polygons[0].ring, BUSH.ring)


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    path.write_text('{"set": "here"}')
    with pytest.raises(ValueError, match="no file of labels"):
        read_labels(path)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (replace(BUSH, kind="shrub"), "kind 'shrub' is unknown"),
        (replace(BUSH, photo="c.jpg"), "not in the list"),
        (ring(BUSH, (1, 1), (5, 5)), "no polygon"),
        (ring(BUSH, (1, 1), (5, 5), (1, math.nan)), "not finite"),
        (ring(BUSH, (1, 1), (200, 5), (1, 9)), "outside the photo"),
        (ring(BUSH, (1, 1), (9, 9), (9, 1), (1, 9)), "crosses itself"),
    ],
)
def test_a_wrong_polygon_is_named(wrong: Label, why: str) -> None:
    (found,) = problems(labels_of(LAWN, wrong))
    assert found.startswith("polygon 1: ")
    assert why in found


def test_a_hazard_may_stand_on_open_ground_but_not_on_its_edge() -> None:
    assert problems(labels_of(LAWN, BUSH)) == []
    across = ring(BUSH, (0, 20), (20, 20), (20, 40), (0, 40))
    (found,) = problems(labels_of(LAWN, across))
    assert "contradict" in found
    assert problems(labels_of(LAWN, replace(across, kind="unsure"))) == []
    assert problems(labels_of(LAWN, replace(across, photo="b.jpg"))) == []


def test_a_cell_takes_the_label_at_its_pixel(tmp_path: Path) -> None:
    truth = labelled_map(some_run(tmp_path, everywhere(0.0)), labels_of(LAWN, BUSH))
    east, north = GRID.xy()
    u, v = (east / ABOVE * 100 + 99.5)[None, :], (-north / ABOVE * 100 + 49.5)[:, None]
    bush = (np.abs(u - 30) <= 10.5) & (np.abs(v - 30) <= 10.5)
    assert (truth.kinds["bush_or_tall_plants"] == bush).mean() > 0.999
    lawn = (np.abs(u - 100) <= 90.5) & (np.abs(v - 50) <= 40.5) & ~bush
    assert (truth.open_ground == lawn).mean() > 0.995
    assert not (truth.open_ground & truth.hazard).any()


def test_a_photo_that_the_run_did_not_place_is_named(tmp_path: Path) -> None:
    truth = labelled_map(some_run(tmp_path, everywhere(0.0)), labels_of(LAWN, replace(BUSH, photo="b.jpg")))
    assert truth.unused == ("b.jpg",)
    assert not truth.hazard.any()


def test_a_wall_hides_the_ground_behind_it() -> None:
    up = np.zeros(GRID.shape, np.float32)
    east, _ = GRID.xy()
    up[:, np.abs(east - 10) < 0.3] = 4.0  # from x = 0, z = 20, it hides 2.5 m of ground
    points = np.array([[x, 0.0, 0.0] for x in (5.0, 9.0, 11.0, 12.0, 13.5)])
    assert hidden(GRID, up, points, LOOK_DOWN.translation).tolist() == [False, False, True, True, False]
    cells = PhotoCells(GRID, np.where(up > 0, np.nan, up), CAMERA, LOOK_DOWN)  # unknown heights hide nothing
    assert cells.under(LAWN, labels_of(LAWN))[75, 180]


def test_unknown_heights_are_those_of_the_ground_about_them() -> None:
    east, north = np.meshgrid(*GRID.xy())
    up = (100 + 0.1 * east - 0.05 * north).astype(np.float32)
    gappy = np.where(np.hypot(east, north) < 2, np.nan, up).astype(np.float32)
    gappy[:, east[0] > 15] = np.nan
    out = filled(gappy, GRID)
    known = np.isfinite(gappy)
    np.testing.assert_array_equal(out[known], gappy[known])
    np.testing.assert_allclose(out[np.hypot(east, north) < 2], 100, atol=0.4)
    beyond = out[:, east[0] > 15]
    assert gappy[known].min() <= beyond.min() <= beyond.max() <= gappy[known].max()  # no extrapolation
    with pytest.raises(ValueError, match="knows no heights"):
        filled(np.full(GRID.shape, np.nan, np.float32), GRID)


def test_a_lens_is_not_used_beyond_its_corners() -> None:
    lens = replace(CAMERA, model="radial-tangential", distortion=(-0.4, 0.0, 0.0, 0.0))
    pixels = pixels_within(lens, np.array([[0.5, 0.2, 1.0], [2.0, 0.0, 1.0], [0.1, 0.0, -1.0]]))
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False, False]


def test_labels_need_the_lens_of_the_photos() -> None:
    with pytest.raises(ValueError, match="lacks focal_px"):
        photo_camera_of({"notes": {}, "settings": {"sources": {"calibration": None}}})


def test_what_is_claimed_on_hazards_and_open_ground(tmp_path: Path) -> None:
    east, _ = GRID.xy()
    safe = np.where((east < 0)[None, :], 0.97, 0.6) * np.ones(GRID.shape)
    found = compare(some_run(tmp_path, safe), labels_of(LAWN, BUSH))
    assert found.hazards["bush_or_tall_plants"].claimed == 1.0
    assert found.hazards["all"].cells == found.hazards["bush_or_tall_plants"].cells > 300
    lawn = found.open_ground["lawn"]
    assert lawn.claimed is not None
    assert 0.4 < lawn.claimed < 0.5  # half of it, without the bush and the ground beside it
    assert (lawn.half, lawn.candidate, lawn.known) == (1.0, 1.0, 1.0)
    assert found.beside.claimed == 1.0
    (site,) = found.sites
    assert (site.on, site.reaches) == (("bush_or_tall_plants",), ("bush_or_tall_plants",))
    assert "| hazard: bush_or_tall_plants |" in table(found)


def test_open_ground_counts_where_the_whole_footprint_lies_on_it(tmp_path: Path) -> None:
    found = compare(some_run(tmp_path, everywhere(0.0)), labels_of(LAWN))
    metres = (181 * 0.2 - 2) * (81 * 0.2 - 2)  # without a radius of 1 m on each side
    assert found.open_ground["lawn"].cells * GRID.cell**2 == pytest.approx(metres, rel=0.03)
    assert found.open_ground["lawn"].candidate == 0.0


def test_the_overlay_and_the_places_on_earth(tmp_path: Path) -> None:
    run = some_run(tmp_path, everywhere(0.0))
    truth = labelled_map(run, labels_of(LAWN, BUSH))
    picture = tool.overlay(run, truth)
    row, col = (round(float(i)) for i in GRID.index(np.array(-14.0), np.array(4.0)))
    assert picture[row, col].argmax() == 0  # red: a hazard
    assert picture[75, 125].argmax() == 1  # green: open ground
    (bush,) = [f for f in tool.geojson(run, truth)["features"] if f["properties"]["kind"] == "bush_or_tall_plants"]
    (outline,) = bush["geometry"]["coordinates"]
    assert run.local is not None
    east, north, _ = run.local.to_enu([p[1] for p in outline], [p[0] for p in outline], 500.0).T
    assert (east.min(), east.max()) == pytest.approx((-16.0, -11.8), abs=0.2)
    assert (north.min(), north.max()) == pytest.approx((1.8, 6.0), abs=0.2)
    assert outline[0] == outline[-1]
    assert (east[:-1] * north[1:] - east[1:] * north[:-1]).sum() > 0  # counter-clockwise


def test_check_returns_its_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text(labels_json(labels_of(LAWN, BUSH)))
    bad.write_text(labels_json(labels_of(replace(BUSH, kind="shrub"))))
    assert tool.main(["check", str(good)]) == 0
    assert tool.main(["check", str(bad)]) == 1
    assert "1 bush_or_tall_plants, 1 lawn" in capsys.readouterr().out


DOM = """
const nodes = {};
const node = () => ({ value: "", style: {}, dataset: {}, children: [], classList: { toggle() {} },
  add(o) { this.value ||= o.name; }, append(b) { this.children.push(b); }, clientWidth: 400, clientHeight: 200,
  getBoundingClientRect: () => ({ left: 0, top: 0 }),
  getContext: () => new Proxy({}, { get: () => () => {}, set: () => true }) });
const document = { getElementById: id => nodes[id] ??= node(), createElement: node }, window = {};
class Image { set src(s) { this.onload(); } }
const Option = function (name) { this.name = name; };
"""
DRAW = """
const click = (u, v, shiftKey = false) =>
  canvas.onmousedown({ clientX: (u + 0.5) * 2, clientY: (v + 0.5) * 2, button: 0, shiftKey });
const press = key => window.onkeydown({ key });
press("3"); click(20, 20); click(40, 20); click(40, 40); click(20, 40); press("Enter");
press("a"); click(50, 50); click(60, 50); click(500, 60); press("Enter");
press("1"); click(1, 1); click(9, 1); press("Escape");
click(70, 70); click(80, 70); click(80, 80); press("Enter");
click(78, 72, true); press("Delete");
click(30, 30, true); byId("note").oninput({ target: { value: "drawn" } });
const first = text(); load(first);
if (text() !== first) throw new Error("a file that was loaded is saved otherwise");
console.log(first);
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no node to run the page's script")
def test_what_is_drawn_on_the_page_is_a_file_of_labels(tmp_path: Path) -> None:
    script = tool.TEMPLATE.read_text(encoding="utf-8").split("<script>")[1].split("</script>")[0]
    data = {"set": "here", "width": 200, "height": 100, "times": {"a.jpg": "1769435417000000001"}, "kinds": KINDS}
    data |= {"colours": dict.fromkeys(KINDS, "red"), "photos": {"a.jpg": ""}}
    program = DOM + script.replace("/*DATA*/", json.dumps(data)) + DRAW
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    path = tmp_path / "here.json"
    path.write_text(done.stdout.removesuffix("\n"))
    labels = read_labels(path)
    assert problems(labels) == []
    assert labels.times == {"a.jpg": 1769435417000000001}
    assert [(p.kind, p.note) for p in labels.polygons] == [("bush_or_tall_plants", "drawn"), ("lawn", "")]
    np.testing.assert_array_equal(labels.polygons[0].ring, BUSH.ring)
    np.testing.assert_array_equal(labels.polygons[1].ring, [[50, 50], [60, 50], [199, 60]])


def test_the_page_holds_the_photos(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    photo = tmp_path / "a.jpg"
    photo.write_bytes(b"picture")
    source = type("Opened", (), {"rig": type("R", (), {"cameras": (type("C", (), {"camera": CAMERA}),)})})
    monkeypatch.setattr(tool, "photo_times", lambda folder: {"a.jpg": 5})
    monkeypatch.setattr(tool, "open_source", lambda folder, settings: source)
    text = tool.page(tmp_path, [])
    assert '"a.jpg": "cGljdHVyZQ=="' in text
    assert "/*DATA*/" not in text
    with pytest.raises(ValueError, match=r"no photo b\.jpg"):
        tool.page(tmp_path, ["b.jpg"])
