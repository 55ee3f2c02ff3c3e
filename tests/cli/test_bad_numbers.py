"""Numbers out of range, clocks without a common time and odd names, in `alight run`: named, and the rest is done."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from damage import UNSMOOTHED, change_field, dji_tags, write_photo, write_yaml, xmp_packet
from length import first_rows
from PIL import ExifTags, Image
from refusal import Refused

from alight.cli import call
from alight.pipeline.mapping.ground_map import refuse_too_large
from alight.records import SettingsError


def ran(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, str]:
    """Run `alight run`; return exit code, stdout and stderr."""
    code = call(["run", str(source), "--out", str(tmp_path / "out"), *UNSMOOTHED, *options])
    said = capsys.readouterr()
    assert "could not be made" not in said.err
    return code, said.out, said.err


def shift(path: Path, seconds: float) -> None:
    """Stamp a stream by another clock."""
    rows = [row.split(",", 1) for row in path.read_text().splitlines()[1:]]
    path.write_text("#\n" + "".join(f"{int(t) + round(1e9 * seconds)},{rest}\n" for t, rest in rows))


@pytest.mark.parametrize(
    ("stream", "column", "value", "why"),
    [
        ("nav0", 14, "1e-300", "a sigma is not between"), ("nav0", 14, "1e200", "a sigma is not between"),
        ("nav0", 3, "1e200", "the height is none"), ("nav0", 8, "-1e300", "the velocity is none"),
        ("nav0", 11, "1e9", "the angular rate is none"), ("nav0", 4, "1e200", "quaternion"),
        ("imu0", 2, "1e200", "no turn or acceleration"), ("imu0", 6, "-1e200", "no turn or acceleration"),
        ("state_groundtruth_estimate0", 2, "1e300", "no position"),
    ],
)  # fmt: skip
def test_a_row_out_of_any_range_is_left_out_and_named(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], stream: str, column: int, value: str, why: str
) -> None:
    change_field(flight / "mav0" / stream / "data.csv", 4, column, value)
    code, _, err = ran(flight, tmp_path, capsys)
    assert code == 0
    assert f"{stream} rows: 1 of" in err
    assert why in err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"intrinsics": [1e9, 1e9, 31, 24]}, "a focal length of 1e+09 pixels for images 64 pixels wide"),
        ({"intrinsics": [1e-9, 1e-9, 31, 24]}, "a focal length of"),
        ({"intrinsics": [50, 50, 1e12, 24]}, "a principal point at 1e+12 pixels"),
        ({"distortion_coefficients": [1e200, 0, 0, 0]}, "a distortion of 1e+200"),
        ({"resolution": [1e300, 48]}, "write the width and height"),
        ({"T_BS": {"data": [1, 0, 0, 1e200, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}, "T_BS is farther than 1000 m"),
    ],
)
def test_a_calibration_out_of_range(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any], words: str
) -> None:
    path = flight / "mav0" / "cam0" / "sensor.yaml"
    write_yaml(path, yaml.safe_load(path.read_text().removeprefix("%YAML:1.0\n")) | change)
    code, _, err = ran(flight, tmp_path, capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert words in err


@pytest.mark.parametrize("name", ["gyroscope_noise_density", "accelerometer_random_walk"])
@pytest.mark.parametrize("value", [1e300, 0.0, -1.0])
def test_the_noise_of_an_imu_out_of_range(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, value: float
) -> None:
    path = flight / "mav0" / "imu0" / "sensor.yaml"
    write_yaml(path, yaml.safe_load(path.read_text()) | {name: value})
    code, _, err = ran(flight, tmp_path, capsys)
    assert code == 2
    assert f"imu0/sensor.yaml: {name} is" in err


@pytest.mark.parametrize(
    "setting",
    [
        "lander.radius=1e300", "lander.radius=1e-300", "lander.radius=nan", "parallax.height_range=[.nan,.nan]",
        "parallax.height_range=[3,1]", "sites.count=100000000000000000000000000", "lander.max_slope=3",
        "lander.feet=[[1e300,0],[0,1],[0,0]]", "sites.margin=1e30", "motion.filter.time_offset=1e300",
        "parallax.store_mb=1e26", "parallax.cell=1e-300", "sources.every=1e26", "hazards.alpha=1e300",
        "motion.filter.time_offset_sigma=1e5", "lander.foot_radius=1e5",
    ],
)  # fmt: skip
def test_settings_out_of_range(setting: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(["settings", "--set", setting]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {setting.partition('=')[0].partition('.height')[0]}")
    assert err.count("\n") == 1


STREAMS, SHIFTS = (("nav0", "nav0 (GPS/INS)"), ("imu0", "imu0"), ("cam1", "cam1")), (3600.0, -3600.0, -1_700_000_000.0)


@pytest.mark.parametrize(
    ("stream", "name", "seconds"),
    first_rows(3, [(*STREAMS[(k + turn) % 3], s) for turn in range(3) for k, s in enumerate(SHIFTS)]),
)
def test_clocks_that_do_not_meet(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], stream: str, name: str, seconds: float
) -> None:
    shift(flight / "mav0" / stream / "data.csv", seconds)
    code, out, err = ran(flight, tmp_path, capsys)
    assert code == 0
    assert out.startswith("NO SITE")
    how = "begins" if seconds > 0 else "ends"
    assert f"the clocks do not meet: {name} {how} {'3,' if abs(seconds) < 4000 else '1,699,999,'}" in err
    assert "stamp both by one clock" in err
    assert any("clocks" in w for w in json.loads((tmp_path / "out" / "run.json").read_text())["warnings"])


def test_cameras_that_expose_in_turn(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shift(flight / "mav0" / "cam1" / "data.csv", 0.05)
    code, _, err = ran(flight, tmp_path, capsys)
    assert code == 0
    assert "cam1 never exposes together with cam0" in err


@pytest.mark.parametrize(
    "name", ["x" * 5000 + ".png", "a\x00b.png", "x/" * 2000, "\u202e.png", "../" * 50 + "etc/passwd"]
)
def test_a_hostile_name_of_an_image(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    change_field(flight / "mav0" / "cam0" / "data.csv", 4, 1, name)
    code, _, err = ran(flight, tmp_path, capsys)
    assert code == 0
    assert "cam0 images: 1 of 6 left out" in err
    assert len(err) < 2000


@pytest.mark.parametrize("case", ["one place", "pole", "one photo", "too high"])
def test_photos_that_fix_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    for k in range(5):
        place = {"pole": (90.0, 0.0, 350.0), "too high": (45.0, 7.6, 1e7)}.get(case, (45.0, 7.6, 350.0))
        write_photo(
            tmp_path / "survey" / f"{k}.jpg", 0 if case == "one photo" else k, second=f"{10 + 3 * k}", place=place
        )
    code, out, err = ran(tmp_path / "survey", tmp_path, capsys)
    assert code in (0, 2)
    assert out.startswith("NO SITE") if code == 0 else err.count("\n") == 1


def test_a_map_too_large_is_refused_with_the_cell_that_mends_it() -> None:
    corners = np.zeros(2), np.full(2, 1000.0)
    refuse_too_large(*corners, 0.05, 22.0)
    with pytest.raises(
        SettingsError, match=r"1,000 x 1,000 m needs about 22,000,000 GB; parallax\.cell=0\.1 would need"
    ):
        refuse_too_large(*corners, 1e-6 * 31.6227766, 22.0)


@pytest.mark.parametrize(
    ("command", "advice"),
    [("hazards", "gdalwarp -tr"), ("run", "parallax.cell"), ("simulate", "smaller images"), ("check", "--seconds")],
)
def test_the_advice_where_memory_ends_fits_the_command(
    command: str, advice: str, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    def full(*_: object, **__: object) -> int:
        raise MemoryError

    monkeypatch.setattr("typer.Typer.__call__", full)
    refused([command, "x"], advice)
    refused(
        [command, "x", "--set", "tuning.terrain.cell=1e-4"],
        "take back what makes it large among tuning.terrain.cell=1e-4, or",
    )


def test_an_origin_that_is_not_that_of_the_flight(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Found by the fuzzer: a latitude of 1e-300 ended in `negative dimensions are not allowed`."""
    origin = {"latitude": 1e-300, "longitude": 15.4, "height": 300.0}
    write_yaml(flight / "mav0" / "nav0" / "sensor.yaml", {"origin": origin})
    code, _, err = ran(flight, tmp_path, capsys)
    assert code == 2
    assert "km away from the rows of nav0/data.csv" in err
    assert err.count("\n") == 1


def test_only_the_height_is_missing(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = flight / "mav0" / "nav0" / "data.csv"
    for line in range(2, 2 + len(path.read_text().splitlines()) - 1):
        change_field(path, line, 3, "")
    code, out, err = ran(flight, tmp_path, capsys)
    assert code == 0
    assert "no GPS/INS position with height" in out
    assert "12 rows have latitude and longitude, but no height" in err


def test_photos_that_lack_the_altitude_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k in range(4):
        path = tmp_path / "survey" / f"{k}.jpg"
        tags = xmp_packet(dji_tags(AbsoluteAltitude=""))
        write_photo(path, k, second=f"{10 + 3 * k}", xmp=tags, place=(45.0 + 3e-5 * k, 7.6, 350.0))
        with Image.open(path) as image:
            exif, again = image.getexif(), image.copy()
            if k:
                del exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSAltitude]
        again.save(path, "JPEG", exif=exif, xmp=tags)
    _, _, err = ran(tmp_path / "survey", tmp_path, capsys)
    assert "3 of them lack the altitude alone" in err
