"""The pages on formats are read back: their examples are a flight log, and all outputs of a run are named."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from some_run import candidate, site

from alight.outputs import folder, rasters, vectors
from alight.records import Flag, Frame, Hazard, ImuSample, NavSample, Terrain
from alight.records.campaign import (
    OUTCOMES,
    Conditions,
    FaultRecord,
    LandingRecord,
    TouchdownLine,
    TransitionLine,
)
from alight.records.executive import LookRecord
from alight.runner.opening import open_source
from alight.settings import Settings

PAGES = Path(__file__).parents[2] / "docs" / "formats"
LOG, OUTPUTS = ((PAGES / f"{name}.md").read_text(encoding="utf-8") for name in ("flight-log", "outputs"))
TABLES = {  # header of a table: its place in a flight
    "#timestamp [ns],filename": "mav0/cam0/data.csv",
    "#timestamp,latitude": "mav0/nav0/data.csv",
    "#timestamp [ns],w_x": "mav0/imu0/data.csv",
    "#timestamp,p_x": "mav0/state_groundtruth_estimate0/data.csv",
}


def blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, flags=re.S | re.M)


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Write a flight of the page's examples, with black images."""
    files = {text.split("\n")[0].removeprefix("# "): text for text in blocks(LOG, "yaml")}
    for text in blocks(LOG, "csv"):
        files[next(path for head, path in TABLES.items() if text.startswith(head))] = text
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    images = tmp_path / "mav0" / "cam0" / "data"
    images.mkdir()
    for row in files["mav0/cam0/data.csv"].strip().split("\n")[1:]:
        cv2.imwrite(str(images / row.split(",")[1]), np.zeros((480, 640), np.uint8))
    return tmp_path


def test_the_examples_of_the_flight_log_are_a_flight_log(flight: Path) -> None:
    source = open_source(flight, Settings())
    events = list(source.events())
    frames, rows, inertial = ([e for e in events if isinstance(e, kind)] for kind in (Frame, NavSample, ImuSample))
    assert (len(frames), len(rows), len(inertial)) == (2, 2, 2)
    assert source.warnings == []
    assert source.georeferenced
    assert rows[0].angular_velocity_body is not None
    assert rows[1].angular_velocity_body is None  # an empty field is 'not measured'
    assert source.truth_trajectory is not None
    assert len(source.truth_trajectory[1]) == 1


def test_the_camera_of_the_example_looks_down_with_the_top_of_its_image_ahead(flight: Path) -> None:
    body_from_cam = open_source(flight, Settings()).rig.cameras[0].body_from_cam
    assert body_from_cam.rotation @ [0, 0, 1] == pytest.approx([0, 0, -1])
    assert body_from_cam.rotation @ [0, -1, 0] == pytest.approx([1, 0, 0])
    assert body_from_cam.translation == pytest.approx([0.12, 0, -0.06])


def test_the_class_codes_of_the_page_are_those_of_the_code() -> None:
    table = LOG.split("| code | class |")[1]
    codes = [int(c) for c in re.findall(r"^\| (\d) \|", table, re.M)]
    assert codes == [int(t) for t in Terrain]


def test_the_examples_of_the_outputs_can_be_read() -> None:
    assert all(isinstance(json.loads(text), dict) for text in blocks(OUTPUTS, "json"))
    assert len(blocks(OUTPUTS, "json")) >= 4
    assert all(isinstance(yaml.safe_load(text), dict) for text in blocks(LOG, "yaml"))


@pytest.mark.parametrize("record", [LandingRecord, Conditions, FaultRecord, LookRecord, TransitionLine, TouchdownLine])
def test_every_key_of_a_landing_and_every_outcome_is_on_the_page(record: type[Any]) -> None:
    page = (PAGES / "campaign.md").read_text(encoding="utf-8")
    assert not [key for key in (*inspect.signature(record).parameters, *OUTCOMES) if f"`{key}`" not in page]


def test_every_file_that_a_run_writes_is_on_the_page() -> None:
    assert not [name for name in (*folder.FILES, folder.RUN_JSON) if name not in OUTPUTS]


def test_every_property_of_a_site_is_on_the_page() -> None:
    assert not [key for key in vectors.site_properties(candidate()) if f"`{key}`" not in OUTPUTS]


def test_the_places_of_the_example_have_every_property() -> None:
    features = [f for text in blocks(OUTPUTS, "json") for f in json.loads(text).get("features", [])]
    told = {f["properties"]["kind"]: f["properties"] for f in features}
    assert set(told) == {"site", "candidate"}
    for kind, made in (("site", site()), ("candidate", candidate())):
        assert list(told[kind]) == list(vectors.site_properties(made))


def test_every_band_of_the_probability_is_on_the_page() -> None:
    assert not [band for band in rasters.SAFE_BANDS if f"`{band}`" not in OUTPUTS]


def test_the_columns_of_the_trajectory_are_those_of_the_page() -> None:
    assert [text for text in blocks(OUTPUTS, "csv") if text.startswith(f"{vectors.COLUMNS}\n")]


def test_every_flag_is_explained_on_the_page_of_uncertainty() -> None:
    table = (PAGES.parent / "method" / "uncertainty.md").read_text(encoding="utf-8").split("## Flags")[1]
    assert re.findall(r"^\| ([A-Z]+) \|", table, re.M) == [flag.name for flag in sorted(Flag, key=lambda f: f.value)]


def test_the_glossary_names_every_reason_and_class() -> None:
    text = (PAGES.parent / "glossary.md").read_text(encoding="utf-8")
    assert not [h.name for h in Hazard if (h.name or "") not in text]
    assert not [t.name for t in Terrain if t and t.name.lower().replace("_", " ") not in text]
