"""`alight check` of photos: a good set passes, and each fault is named."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import damage as d
import numpy as np
import pytest
from drawn_photos import draw_photos

from alight.checks.picture_quality import Brightness
from alight.checks.result import CheckResult, Judged, bad, good, warning
from alight.cli import call
from alight.photos.check import checking
from alight.photos.check.evidence import PhotoEvidence, coverage, gather_photos
from alight.photos.reading.photos import Photos
from alight.runner.opening import open_source
from alight.settings import load_settings

SHARP = np.full((8, 2), 2.0)


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return draw_photos(tmp_path_factory.mktemp("drawn"))


@pytest.fixture(scope="module")
def evidence(survey: Path) -> PhotoEvidence:
    source = open_source(survey)
    assert isinstance(source, Photos)
    return gather_photos(source, lambda share: None)


def test_the_pictures_and_the_tags_agree(evidence: PhotoEvidence) -> None:
    """Eight photos from 40 m, 10 m apart, of 37 x 30 m."""
    assert evidence.measured == pytest.approx(40.0, abs=1.5)
    assert evidence.height == pytest.approx(40.0, abs=1.0)
    cover = coverage(evidence, 40.0)
    assert np.median(cover.along) == pytest.approx(0.67, abs=0.05)
    assert 4 <= np.median(cover.views) <= 6
    assert all(p.matches > 100 for p in evidence.pairs)
    assert np.median([p.overlap for p in evidence.pairs]) == pytest.approx(0.65, abs=0.06)


def resolution(allowed: float, e: PhotoEvidence) -> CheckResult:
    return checking.judge_resolution(e, load_settings("", [f"lander.max_roughness={allowed}"]))


def with_focal(factor: float, e: PhotoEvidence) -> PhotoEvidence:
    return replace(e, pairs=[p._replace(height=factor * p.height) for p in e.pairs])


def light(**changes: float) -> list[Brightness]:
    return [Brightness(0.0, 0.0, 120.0, 110.0)._replace(**changes)] * 8


@pytest.mark.parametrize(
    ("check", "change", "verdict", "words"),
    [
        (checking.judge_set, lambda e: e, "good", "8 of 8 are used"),
        (checking.judge_set, lambda e: replace(e, unread=["a.jpg: it is truncated"]), "bad", "a.jpg: it is truncated"),
        (checking.judge_focal, lambda e: e, "good", "430 px, CalibratedFocalLength"),
        (checking.judge_positions, lambda e: e, "good", "8 RTK fixed; 1-sigma 0.02 m east"),
        (checking.judge_positions, lambda e: replace(e, centres=np.full((8, 3), np.nan)), "warning", "8 photos"),
        (checking.judge_heights, lambda e: e, "good", "ellipsoid (RTK fixed)"),
        (checking.judge_heights, partial(with_focal, 2.0), "bad", "give the true focal length"),
        (checking.judge_heights, partial(with_focal, 0.5), "bad", "give the true focal length"),
        (checking.judge_heights, partial(with_focal, 1.2), "good", "48 m above ground"),
        (checking.judge_heights, lambda e: replace(e, pairs=[]), "cannot tell", "do not give the height"),
        (checking.judge_attitude, lambda e: e, "good", "0 degrees from straight down"),
        (checking.judge_attitude, lambda e: replace(e, poses=e.poses @ turned(40)), "warning", "40 degrees"),
        (checking.judge_attitude, lambda e: replace(e, poses=e.poses @ turned(75)), "warning", "unless the tags"),
        (checking.judge_exposure, lambda e: replace(e, brightness=light()), "good", "mean grey 110"),
        (checking.judge_exposure, lambda e: replace(e, brightness=light(saturated=0.3)), "bad", "over-exposed"),
        (checking.judge_exposure, lambda e: replace(e, brightness=light(black=0.5)), "bad", "under-exposed"),
        (checking.judge_exposure, lambda e: replace(e, brightness=light(contrast=9)), "bad", "fog"),
        (checking.judge_exposure, lambda e: replace(e, brightness=[]), "cannot tell", "no picture"),
        (checking.judge_sharpness, lambda e: replace(e, edges=SHARP), "good", "2.0 px"),
        (checking.judge_sharpness, lambda e: replace(e, edges=SHARP + 4), "bad", "lock it"),
        (checking.judge_sharpness, lambda e: replace(e, edges=np.append(SHARP, [[7.0, 7.0]], axis=0)),
         "warning", "take blurred pictures away"),
        (checking.judge_sharpness, lambda e: replace(e, edges=SHARP * np.nan), "cannot tell", "too few edges"),
        (checking.judge_overlap, lambda e: e, "good", "8 of 8 pairs of neighbours match"),
        (checking.judge_overlap, lambda e: replace(e, centres=e.centres * [4, 4, 1]), "bad", "closer to each other"),
        (checking.judge_overlap, lambda e: replace(e, pairs=[p._replace(matches=0) for p in e.pairs]), "bad", "0 of 8"),
        (partial(resolution, 0.15), lambda e: e, "warning", "a pixel is 9.3 cm on the ground"),
        (partial(resolution, 0.6), lambda e: e, "good", "obstacles of 60 cm need"),
    ],
)  # fmt: skip
def test_each_fault_is_named(evidence: PhotoEvidence, check: Any, change: Any, verdict: str, words: str) -> None:
    found = check(change(evidence))
    assert found.verdict == verdict
    assert words in found.line


def turned(degrees: float) -> np.ndarray:
    """Rotation of a camera about its x axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize(
    ("results", "verdict"),
    [
        ([good("a", "")], Judged.GOOD),
        ([good("a", ""), warning("b", "", "")], Judged.WARNING),
        ([warning("b", "", ""), bad("c", "", "")], Judged.BAD),
    ],
)
def test_the_verdict_is_that_of_the_worst(results: list[CheckResult], verdict: Judged) -> None:
    found = checking.verdict(results)
    assert found.verdict is verdict
    assert all(r.name in found.evidence for r in results if r.verdict is verdict and verdict is not Judged.GOOD)


def test_the_command(survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line a check; those of the photos with -v; the exit code is 3 where tags contradict each other."""
    few = tmp_path / "few"
    few.mkdir()
    for name in ("DJI_0000.JPG", "DJI_0001.JPG", "DJI_0002.JPG"):
        shutil.copy(survey / name, few)
    assert call(["check", str(few), "--json", "-v"]) == 3  # blurred, as it is drawn
    *results, last = json.loads(capsys.readouterr().out)
    assert last["name"] == "verdict"
    assert [p["name"] for p in last["photos"]] == ["DJI_0000.JPG", "DJI_0001.JPG", "DJI_0002.JPG"]
    assert {"pictures", "focal length", "positions", "heights", "overlap", "estimate"} <= {r["name"] for r in results}
    for k in range(4):
        tags = d.dji_tags(AbsoluteAltitude=f"{300 + 40 * k}", RelativeAltitude="45")
        d.write_photo(tmp_path / "wrong" / f"{k}.jpg", place=(45 + 3e-5 * k, 7.6, 350 - 9 * k), xmp=d.xmp_packet(tags))
    assert call(["check", str(tmp_path / "wrong"), "-v"]) == 3
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert "0.jpg  64 x 48" in printed.err
    assert any(line.startswith("BAD          reading: altitudes in EXIF and XMP differ") for line in lines)
    assert lines[-1].startswith("BAD          verdict: something is wrong or contradicts: ")
