"""Heights above ground against the other evidence of the same photos."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from drawn_photos import CAMERA, SMALL, draw_photos
from drawn_survey import Survey
from length import first_rows

from alight.cli import call
from alight.photos.bundle.height_check import FocalScore, HeightCheck, check_heights

NOTHING = FocalScore(0.0, np.inf, 0.0)


def checked(above: float, relief: float = 0.5, score: FocalScore = NOTHING, climb: float = 0.0, slope: float = 0.0,
            tagged_climb: float | None = None) -> HeightCheck:  # fmt: skip
    """Cameras at 50 m above the middle of the ground by the pictures, and at another height above take-off by tags."""
    rng = np.random.default_rng(1)
    ground = rng.uniform(0, 60, (500, 3))
    ground[:, 2] = rng.uniform(-0.5, 0.5, 500) * relief + slope * (ground[:, 0] - 30)
    step = np.repeat([-0.5, 0.5], 10)
    return check_heights(
        score, 50 + climb * step, above + (climb if tagged_climb is None else tagged_climb) * step, ground
    )


@pytest.mark.parametrize(
    ("case", "ratio"),
    [
        ({"above": 50.0}, None),
        ({"above": 52.0}, None),  # the barometer is good to 2 m
        ({"above": 56.0}, 1.12),
        ({"above": 44.0}, 0.88),
        ({"above": 125.0}, 2.5),
        ({"above": 25.0}, 0.5),
        ({"above": 60.0, "relief": 20.0}, None),
        ({"above": 75.0, "relief": 20.0}, 1.5),
        ({"above": 60.0, "slope": 0.3}, None),  # take-off may be as far beside the map as the map is wide
        ({"above": -20.0}, None),  # take-off on a cliff: no focal length explains it
        ({"above": np.nan}, None),
        ({"above": np.nan, "score": FocalScore(0.2, 0.04, 0.0)}, 1.22),
        ({"above": np.nan, "score": FocalScore(0.06, 0.04, 0.0)}, None),
        ({"above": 56.0, "score": FocalScore(0.0, np.inf, 0.1)}, None),  # GPS leaves the scale open
        ({"above": 62.5, "climb": 20.0, "tagged_climb": 25.0}, 1.25),
        ({"above": 70.0, "relief": 40.0, "climb": 30.0, "tagged_climb": 45.0}, 1.5),
    ],
)
def test_evidence_is_weighed(case: dict[str, Any], ratio: float | None) -> None:
    check = checked(**case)
    assert bool(check.because) == (ratio is not None)
    if ratio is not None:
        assert check.ratio == pytest.approx(ratio, rel=0.06)
        assert check.low < ratio < check.high
        reason = check.reason(1000.0)
        assert reason.startswith("heights are not to be trusted, by a factor of about ")
        assert "--set sources.calibration=" in reason


@pytest.mark.parametrize(
    ("check", "note"),
    [
        (HeightCheck(1.0, 0.95, 1.05), "agree with the photos: true over used focal length 0.95 to 1.05"),
        (HeightCheck(1.0, 0.7, 1.4), "cannot be checked: true over used focal length 0.70 to 1.40"),
        (HeightCheck(2.0, 1.9, 2.1, "of tags"), "contradicted: true over used focal length 1.90 to 2.10"),
    ],
)
def test_the_outcome_is_noted(check: HeightCheck, note: str) -> None:
    assert check.note == note


def test_a_vague_ratio_gives_no_number_to_set() -> None:
    assert HeightCheck(2.0, 1.0, 4.0, "of tags").reason(1000.0).endswith("sources.calibration=PIXELS")
    assert HeightCheck(1.0, 0.9, 1.1).reason(1000.0) == ""


@pytest.mark.parametrize(
    ("survey", "ratio"),
    first_rows(
        3,
        [
            (Survey(1), 1.0),
            (Survey(2), 1.15),
            (Survey(3, oblique=0.5, tagged=False), 1.3),
            (Survey(4, relief=30.0), 1.0),
            (Survey(5, heights=(60.0, 90.0), tagged=False, gps=1.0), 0.7),
            (Survey(6, slope=0.3), 1.0),
        ],
    ),
)
def test_a_wrong_focal_length_is_found_in_a_survey(survey: Survey, ratio: float) -> None:
    """By its heights above take-off, by its heights alone, or by oblique photos: a ratio of 1 is no alarm."""
    check = survey.checked(ratio)
    assert bool(check.because) == (ratio != 1.0)


def test_a_run_whose_heights_are_not_to_be_trusted_finds_nothing_safe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pycolmap")
    photos, out = draw_photos(tmp_path / "survey", lines=2, per_line=3), tmp_path / "out"
    focal = CAMERA.fu / 1.3
    assert call(["run", str(photos), "--out", str(out), "--set", f"sources.calibration={focal}", *SMALL]) == 0
    printed = capsys.readouterr()
    assert "NO SITE  heights are not to be trusted, by a factor of about 1.3" in printed.out
    assert re.search(r"warning: .*sources\.calibration 331 px is used, but CalibratedFocalLength 430 px", printed.err)
    told = re.search(r"--set sources\.calibration=(\d+)", printed.out)
    assert told is not None
    assert float(told.group(1)) == pytest.approx(CAMERA.fu, rel=0.05)
    with rasterio.open(out / "safe.tif") as safe:
        assert np.isnan(safe.read(1)).all() or (safe.read(1) == safe.nodata).all()
    info = json.loads((out / "run.json").read_text())
    assert info["notes"]["heights"].startswith("contradicted")
    assert "heights are not to be trusted" in (out / "report.html").read_text()
