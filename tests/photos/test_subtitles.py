"""Telemetry in subtitles: the dialects, and the order of latitude and longitude."""

from __future__ import annotations

import re

import pytest

from alight.photos.reading.subtitles import read_subtitles
from alight.records import InputError

TURIN = {"latitude": 45.0315, "longitude": 7.6205}


def subtitles(*lines: str) -> str:
    return "\n".join(f"{k}\n00:00:{k:02d},000 --> 00:00:{k + 1:02d},000\n{line}\n" for k, line in enumerate(lines))


@pytest.mark.parametrize(
    ("line", "values"),
    [
        # named numbers: Mavic 3, Air 2S, Mini 2; Mavic 2 with its misspelt longitude; other names; a decimal comma
        ('<font size="28">FrameCnt: 1, DiffTime: 33ms\n2024-05-01 10:20:30.250\n[iso: 100] [shutter: 1/1000.0]'
         " [focal_len: 24.00] [dzoom_ratio: 1.50] [latitude: 45.031500] [longitude: 7.620500]"
         " [rel_alt: 30.1 abs_alt: 330.2] [ct: 5500] [gb_yaw: 12.5 gb_pitch: -89.9 gb_roll: 0.0] </font>",
         {"rel_alt": 30.1, "abs_alt": 330.2, "focal_len": 24.0, "dzoom_ratio": 1.5, "gb_yaw": 12.5, "gb_pitch": -89.9}),
        ("[iso : 110] [latitude : 45.0315] [longtitude : 7.6205] [altitude: 55.0] </font>", {"abs_alt": 55.0}),
        ("|LAT:45.0315|LON:7.6205|ALT:132.86|", {"abs_alt": 132.86}),
        ("[latitude: 45,0315] [longitude: 7,6205] [rel_alt: 30,5 abs_alt: 330,2]", {"rel_alt": 30.5, "abs_alt": 330.2}),
        ("Lat: N45.0315 Lon: 7.6205E", {}),
        ("[latitude: 45.0315] [longitude: 7.6205] [rel_alt: 100.0ft]", {"rel_alt": 30.48}),
        *((f"[latitude: 45.0315] [longitude: 7.6205] [rel_alt: {up}]", {"rel_alt": 30.0})
          for up in ("98.4252 feet", "98.4252'", "98.4252 FT.", "30 meters", "30.0 m [iso 100]", "30 iso: 100")),
        ("[latitude: 45.0315] [longitude: 7.6205] relative_altitude: 30.5 absolute_altitude: 330.2 gimbal_pitch: -80",
         {"rel_alt": 30.5, "abs_alt": 330.2, "gb_pitch": -80.0}),
        *((f"[latitude: 45.0315] [longitude: 7.6205] [{zoom}]", {"dzoom_ratio": 2.0})
          for zoom in ("dzoom: 2.00", "DZOOM: 2.00X", "digital_zoom: 2", "dzoom_ratio : 2.0")),
        # places in brackets: Phantom 4, Mavic Pro, Matrice 300, Avata 2, Autel
        ("F/5.6, SS 400, EV 0, GPS (7.6205, 45.0315, 15), D 3.5m, H 10.2m, H.S 1m/s, G.PRY (-24.4°, 0.0°, 110.4°)",
         {"rel_alt": 10.2, "gb_pitch": -24.4, "gb_roll": 0.0, "gb_yaw": 110.4}),
        ("HOME(7.6204,45.0314) 2017.08.05 14:11:51\nGPS(7.6205,45.0315,16) BAROMETER:1.9", {"rel_alt": 1.9}),
        ("HOME(7.6204,45.0314) 2017.8.5 14:11:51\nGPS(7.6205,45.0315,16) Hb:1.9 Hs:1.9", {"rel_alt": 1.9}),
        ("2021.09.18 21:23:30\nGPS(45.0315,7.6205,0.0M) BAROMETER:363.3M", {"rel_alt": 363.3}),
        ("GPS(45.0315,7.6205,349.535) BAROMETER(44.4) HOME(45.0314,7.6204)", {"abs_alt": 349.535, "rel_alt": 44.4}),
        ("GPS(45.0315,7.6205,349) BAROMETER(44.4)", {"abs_alt": 349.0, "rel_alt": 44.4}),
        ("GPS(45.0315,7.6205,44.0) BAROMETER(44.4)", {"rel_alt": 44.4}),  # above take-off as well
        ("GPS(E: 7.6205, N: 45.0315, -37) ReH:12", {"abs_alt": -37.0, "rel_alt": 12.0}),
        ("GPS: N45.0315 E7.6205 H: 20m", {"rel_alt": 20.0}),
        ("GPS(45.0315N, 7.6205E)", {}),
        ("GPS(45,0315, 7,6205, 349,5)", {"abs_alt": 349.5}),
        ("GPS(45,0315;7,6205;349,5)", {"abs_alt": 349.5}),
    ],
)  # fmt: skip
def test_dialects(line: str, values: dict[str, float]) -> None:
    (row,) = read_subtitles(subtitles(line), "a.srt").rows
    assert {k: row.values[k] for k in TURIN} == TURIN
    assert {k: pytest.approx(v) for k, v in row.values.items() if k in values or k in ("abs_alt", "rel_alt")} == values


@pytest.mark.parametrize(
    "line",
    [
        "GPS(45 1 53.4 N, 7 37 13.8 E, 348.0)", "GPS(N 45 1 53.4, E 7 37 13.8, 348.0)",
        "GPS(45°1'53.4\"N, 7°37'13.8\"E, 348.0)", "GPS(7 37.230E; 45 1.890N; 348.0)",
        "[latitude: 45°1’53.4”N] [longitude: 7 37 13.8 E] [abs_alt: 348.0]",
    ],
)  # fmt: skip
def test_degrees_minutes_and_seconds(line: str) -> None:
    (row,) = read_subtitles(subtitles(line), "a.srt").rows
    assert row.place == pytest.approx((45.0315, 7.6205), abs=1e-9)
    assert row.values["abs_alt"] == 348.0
    assert not row.coarse


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("GPS(45 6 3.5, 7 36 1.1, 348.0)", "no hemisphere letters"),
        ("GPS(45 6.05, 7 36.02, 348.0)", "no hemisphere letters"),
        ("[latitude: 45 6 3.5] [longitude: 7 36 1.1]", "no hemisphere letters"),
        ("[latitude: 45°6'3.5\"] [longitude: 7°36'1.1\"]", "no hemisphere letters"),
        ("[latitude: 7.6E] [longitude: 45.1N]", "exchange"),
    ],
)
def test_a_place_that_would_be_misread_is_refused(line: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"a\.srt: .*{why}"):
        read_subtitles(subtitles(line), "a.srt")


@pytest.mark.parametrize(
    ("words", "warning"),
    [
        ("rel_alt: 30 abs_alt: 330 zoom_ratio: 1.0", ""),
        ("rel_alt: 30 zoom_ratio: 2.0", "a.srt: zoom_ratio is not used"),
        ("rel_alt: 30 drone_height: 12", "a.srt: drone_height is not used"),
        ("abs_alt: 330 rel_alt: 98.4 cubits",
         "a.srt: the unit 'cubits' of rel_alt is not known, and rel_alt is not used"),
        ("altitude: 30.4", "a.srt: altitude is taken to count from sea level, which is not declared: if from take-off, "
         "name it rel_alt"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_named(words: str, warning: str) -> None:
    found = read_subtitles(subtitles(f"[latitude: 45.0315] [longitude: 7.6205] {words}"), "a.srt")
    assert found.warning == warning
    assert ("rel_alt" in found.rows[0].values) == ("rel_alt: 30 " in words)


@pytest.mark.parametrize(
    ("lines", "place", "why"),
    [
        (["GPS(149.0251,-20.2533,16)"], (-20.2533, 149.0251), "an angle beyond 90 degrees"),
        (["GPS(7.6,45.0,16)", "GPS(7.6,95.0,16)"], (7.6, 45.0), "an angle beyond 90 degrees"),
        (["GPS(W: -117.-9605, N: 33.6323, -37)"], (33.6323, -117.9605), "hemisphere letters"),
        (["GPS(33.6S, 17.9W, 12)"], (-33.6, -17.9), "hemisphere letters"),
        (["GPS(S33.6, W17.9, 12)"], (-33.6, -17.9), "hemisphere letters"),
        (["GPS(45.03,7.62,349.5)"], (45.03, 7.62), "the third number is a height"),
        (["GPS(7.62,45.03,16)"], (45.03, 7.62), "the third number is a count of satellites"),
        ([f"GPS(45.03,7.62,{h}) H {h}.2m" for h in (12, 20, 31)], (45.03, 7.62), "the third number is the height"),
        (["GPS(45.0300,7.6220) HOME(45.0300,7.6200) D 157.2m"], (45.03, 7.622), "the distance from HOME"),
        (["GPS(7.6220,45.0300) HOME(7.6200,45.0300) D=157.2m"], (45.03, 7.622), "the distance from HOME"),
    ],
)  # fmt: skip
def test_the_order_of_latitude_and_longitude_is_decided_by_the_whole_film(
    lines: list[str], place: tuple[float, float], why: str
) -> None:
    found = read_subtitles(subtitles(*lines), "a.srt")
    assert found.rows[0].place == place
    assert found.found.endswith(f": {why}")


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("GPS(45.03,7.62)", "nothing shows"),
        ("GPS(45.03,7.62,44) BAROMETER:44.1", "nothing shows"),
        ("GPS(95.03,107.62,16)", "contradict"),
        ("GPS(45.03N,7.62N,16)", "contradict"),
        ("GPS(45.0300,7.6220,16) HOME(45.0300,7.6200) D 157.2m", "contradict"),
    ],
)
def test_an_unclear_order_is_refused(line: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"a\.srt: .*{why}.* whether latitude or longitude comes first.*\.gpx"):
        read_subtitles(subtitles(line), "a.srt")


def test_places_that_are_none_are_left_out() -> None:
    """No fix, zeros, and a letter that contradicts the sign."""
    text = subtitles(
        "GPS(N/A,N/A,5) BAROMETER:0.0",
        "GPS(0.0,0.0,0.0M)",
        "GPS(36.6146,-6.1120,0.0M)",
        "[latitude: N-45] [longitude: 7]",
    )
    assert [r.place for r in read_subtitles(text, "a.srt").rows] == [(36.6146, -6.112)]
    assert read_subtitles("no subtitles", "a.srt").rows == ()


@pytest.mark.parametrize(
    "text",
    [
        subtitles("2026-05-04 10:00:00\nGPS(45.0315,7.6205,9.5)", "2026-05-04 10:00:01\nGPS(45.0316,7.6205,9.5)"),
        "WEBVTT\n\n00:00.000 --> 00:01.000\nGPS(45.0315,7.6205,9.5)\n\n"
        "00:01.000 --> 00:02.000\nGPS(45.0316,7.6205,9.5)\n",
        "[Script Info]\n[Events]\nFormat: Layer, Start, End, Style, Name, MarginL, MarginR, MarginV, Effect, Text\n"
        "Dialogue: 0,0:00:00.00,0:00:01.00,Default,,0,0,0,,{\\b1}HOME(7.6,45)\\NGPS(E: 7.6205, N: 45.0315, 9)\n"
        "Dialogue: 0,0:00:01.00,0:00:02.00,Default,,0,0,0,,HOME(7.6,45)\\NGPS(E: 7.6205, N: 45.0316, 9)\n",
        "1\n2026.05.04 10:00:00,393\n[latitude: 45.0315] [longitude: 7.6205]\n\n"
        "2\n2026.05.04 10:00:01,393\n[latitude: 45.0316] [longitude: 7.6205]\n",
    ],
    ids=["srt", "vtt", "ass", "dates alone"],
)
def test_kinds_of_files(text: str) -> None:
    for lines in (text, "\ufeff" + text.replace("\n", "\r\n")):
        rows = read_subtitles(lines, "a").rows
        assert [(r.seconds, r.values["latitude"]) for r in rows] == [(0.0, 45.0315), (1.0, 45.0316)]


def test_values_between_rows_are_interpolated_and_none_is_invented() -> None:
    text = subtitles(*(f"2026-05-04 10:00:{k:02d}\nGPS(45.03,{7.6 + 0.001 * k},349.{k}) H {k}m" for k in range(4)))
    late = re.sub(r"00:00:03", "00:00:09", text)
    telemetry = read_subtitles(late, "a.srt")
    middle, last = telemetry.at(0.5), telemetry.at(9.9)
    assert middle is not None
    assert middle.place == pytest.approx((45.03, 7.6005))
    assert middle.values["rel_alt"] == 0.5
    assert f"{middle.taken:%S.%f}" == "00.500000"
    assert last is not None
    assert last.values["rel_alt"] == 3.0
    assert [telemetry.at(t) is None for t in (-1.5, -0.5, 1.9, 5.0, 8.9, 10.5)] == [
        True,
        False,
        False,
        True,
        True,
        True,
    ]
