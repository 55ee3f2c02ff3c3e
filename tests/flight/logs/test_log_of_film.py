"""A film beside an autopilot's log: its places come from the log, at the time that the pictures show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from autopilot_logs import Autopilot, write_dataflash
from drawn_films import HEIGHT, RATE, draw_film, winding_flight

from alight.geometry import LocalFrame
from alight.photos.reading import video
from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow
from alight.records import InputError, NavSample
from alight.runner.opening import open_source

PLACE = LocalFrame(45.0, 7.6, 310.0)
BEFORE = 57.0  # s of the log before the film


def test_the_log_of_a_films_name_or_the_only_one_gives_its_places(tmp_path: Path) -> None:
    places, courses = winding_flight(5, BEFORE + 40.0)
    first = int(BEFORE * RATE)
    draw_film(tmp_path / "a.mp4", places[first : first + 60], courses[first : first + 60])
    log = [
        NavSample(
            10**9 + round(k * 1e9 / RATE), np.array([p.real, p.imag, HEIGHT]), np.eye(3), np.zeros(3), np.zeros(3),
            np.full(3, 0.5), np.full(3, 0.1), np.full(3, 0.1),
        )
        for k, p in enumerate(places)
    ]  # fmt: skip
    write_dataflash(tmp_path / "00000042.BIN", Autopilot(log, PLACE))
    (tmp_path / "b.BIN").write_bytes(b"")  # no log
    source = open_source(tmp_path / "a.mp4")
    samples = [e for e in source.events() if isinstance(e, NavSample)]
    for k, sample in enumerate(samples):
        number = int(source.photos[k].name.partition("_")[2].partition(".")[0])
        assert sample.position_world is not None
        found = PLACE.to_enu(*source.local.to_geodetic(sample.position_world))
        flown = places[first + number]
        np.testing.assert_allclose(found, [flown.real, flown.imag, HEIGHT], atol=0.8)  # 0.15 s
    assert len(samples) > 5
    assert "00000042.BIN: 485 places; ellipsoid above sea level: +46.5 m" in source.notes["telemetry"]
    (tmp_path / "b.BIN").write_bytes(b"\xa3\x95")
    with pytest.raises(InputError, match="holds 2 logs of an autopilot"):
        open_source(tmp_path / "a.mp4")
    (tmp_path / "00000042.BIN").rename(tmp_path / "a.BIN")
    assert open_source(tmp_path / "a.mp4").length == source.length


def test_the_track_of_a_film_goes_before_a_log_of_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    places, courses = winding_flight(5, 3.0)
    draw_film(tmp_path / "a.mp4", places, courses)
    row = {"latitude": 45.0, "longitude": 7.6, "abs_alt": 348.0}
    track = FilmTelemetry.of([TelemetryRow(0.0, row), TelemetryRow(3.0, row)], "a track")
    monkeypatch.setattr(video, "telemetry_inside", lambda path, seconds: track)
    for name in ("00000041.BIN", "00000042.BIN"):
        (tmp_path / name).write_bytes(b"\xa3\x95")
    assert open_source(tmp_path / "a.mp4").notes["telemetry"].startswith("a track: 2 places")
    (tmp_path / "a.BIN").write_bytes(b"\xa3\x95")
    with pytest.raises(InputError, match=r"a\.BIN"):
        open_source(tmp_path / "a.mp4")
