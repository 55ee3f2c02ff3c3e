"""A film beside an autopilot's log: its places come from the log, at the time that the pictures show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from autopilot_logs import Autopilot, write_dataflash
from drawn_films import HEIGHT, RATE, draw_film, winding_flight

from alight.geometry import LocalFrame
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
    (tmp_path / "b.BIN").write_bytes(b"")
    with pytest.raises(InputError, match="holds 2 logs of an autopilot"):
        open_source(tmp_path / "a.mp4")
    (tmp_path / "00000042.BIN").rename(tmp_path / "a.BIN")
    assert open_source(tmp_path / "a.mp4").length == source.length
