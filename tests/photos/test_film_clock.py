"""The time between a film and its telemetry, from the pictures' motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn_films import RATE, draw_film, rows_of, winding_flight

from alight.photos.reading.film_clock import PicturePath, film_offset, picture_path
from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow
from alight.photos.reading.video import film_clock
from alight.records import InputError

LEAD, SECONDS = 12.0, 34.0  # s of flight before the film, and of film


def telemetry(rows: list[tuple[float, float, float]], of_film: bool = True, every: int = 1) -> FilmTelemetry:
    values = [TelemetryRow(t, {"latitude": a, "longitude": o, "rel_alt": 30.0}) for t, a, o in rows[::every]]
    return FilmTelemetry.of(values, "track", of_film=of_film)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[float, float, float]]]:
    """A film of a part of a winding flight, and the whole flight on the film's clock."""
    places, courses = winding_flight(1, LEAD + SECONDS + 12.0)
    path, part = tmp_path_factory.mktemp("film") / "a.mp4", slice(int(LEAD * RATE), int((LEAD + SECONDS) * RATE))
    draw_film(path, places[part], courses[part])
    return path, rows_of(places, -LEAD)


def test_the_offset_of_a_film_is_found_within_a_third_of_a_second(
    film: tuple[Path, list[tuple[float, float, float]]],
) -> None:
    """Subtitles that begin up to 10 s earlier or later than the film, as long as it or longer, at 5 and 1 Hz."""
    path, rows = film
    pictures = picture_path(path)
    for begin in (-10.0, -6.3, -1.0, 0.0, 1.4, 5.0, 10.0):
        for length, every in ((SECONDS, 1), (SECONDS + 9.0, 1), (SECONDS + 9.0, 5)):
            cut = [(t - begin, a, o) for t, a, o in rows if begin <= t < begin + length]
            found = film_offset(pictures, telemetry(cut, every=every))
            assert not found.unclear, (begin, length, every)
            assert found.seconds == pytest.approx(-begin, abs=0.3), (begin, length, every)


@pytest.mark.parametrize(
    ("places", "length", "why"),
    [
        (np.arange(0.0, 230.0) * (1 + 0j), 40.0, "nearly as well"),  # straight, at one speed
        (winding_flight(3, 46.0)[0], 12.0, "too short"),
        (winding_flight(4, 46.0)[0], 40.0, "unexplained"),  # of another flight
        (np.zeros(230, complex), 40.0, "no motion"),
    ],
)
def test_what_the_pictures_do_not_show_is_reported(places: np.ndarray, length: float, why: str) -> None:
    flown = winding_flight(3, 46.0)[0] if why != "nearly as well" else places
    seconds = np.arange(0.0, length, 1 / RATE)
    pictures = PicturePath(seconds, flown[: len(seconds)], np.ones(len(seconds), complex))
    found = film_offset(pictures, telemetry(rows_of(places[: int(length * RATE)])))
    assert why in found.unclear


@pytest.mark.parametrize("tilt", [-0.15, 0.0, 0.15])
def test_a_camera_that_is_tilted_does_not_show_another_offset(tilt: float) -> None:
    """Turning moves the middle of its picture sideways, as another offset would."""
    clear = 0
    for seed in range(12):
        places, courses = winding_flight(seed, 60.0)
        part, seconds = slice(50, 250), np.arange(0.0, 40.0, 1 / RATE)
        headings = np.exp(1j * courses)
        pictures = PicturePath(seconds, (places / 30.0 + tilt * 1j * headings)[part], headings[part])
        found = film_offset(pictures, telemetry(rows_of(places)))
        clear += not found.unclear
        assert found.unclear or found.seconds == pytest.approx(10.0, abs=0.3)
    assert clear >= 6


def test_a_cut_film_is_corrected_and_reported(film: tuple[Path, list[tuple[float, float, float]]]) -> None:
    path, rows = film
    early = telemetry([(t + 5.0, a, o) for t, a, o in rows if t >= -5.0])
    clock = film_clock(path, SECONDS, early, None)
    assert clock.offset == pytest.approx(5.0, abs=0.3)
    assert clock.warning == (
        f"the telemetry lasts 51.0 s, the film 34.0 s; the telemetry begins {clock.offset:.1f} s earlier than the "
        "film, by the pictures: places are corrected"
    )
    assert clock.accuracy == 0.0
    given = film_clock(path, SECONDS, early, -4.5)
    assert (given.offset, given.warning) == (4.5, "")


def test_a_film_whose_offset_is_unclear_is_used_with_a_warning_or_refused(tmp_path: Path) -> None:
    """The places of subtitles may be off by the time that was cut; a track with a clock of its own is no use."""
    places = np.arange(0.0, 110.0) * (0.8 + 0j)  # 4 m/s to the east
    draw_film(tmp_path / "a.mp4", places[50:], np.zeros(60))
    clock = film_clock(tmp_path / "a.mp4", 12.0, telemetry(rows_of(places)), None)
    assert clock.offset == 0.0
    assert clock.warning.startswith("the telemetry lasts 22.0 s, the film 12.0 s: whether film and telemetry are in st")
    assert clock.accuracy == pytest.approx(40.0, rel=0.05)
    with pytest.raises(InputError, match=r"is not clear from the pictures: .*set sources\.time_offset"):
        film_clock(tmp_path / "a.mp4", 12.0, telemetry(rows_of(places), of_film=False), None)
