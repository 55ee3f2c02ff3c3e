"""Messages with large arrays between two processes."""

from __future__ import annotations

import multiprocessing
from multiprocessing.connection import Connection

import numpy as np
import pytest

from alight.flight.live.shared_arrays import receive, send


def echo(line: Connection) -> None:
    """Double what comes, in place, and send it back; end at None."""
    while (message := receive(line)) is not None:
        for array in message["arrays"]:
            array *= 2
        send(line, message)


@pytest.fixture
def line() -> Connection:
    own, other = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=echo, args=(other,), daemon=True)
    process.start()
    other.close()
    yield own
    send(own, None)
    process.join(10)
    assert process.exitcode == 0


def test_arrays_come_back_changed_and_the_sender_keeps_its_own(line: Connection) -> None:
    rng = np.random.default_rng(0)
    large, odd = rng.integers(0, 100, (300, 401, 3), np.uint8), rng.normal(size=(250, 99)).astype(np.float32)
    arrays = [large, odd, odd[::2, ::3], np.asfortranarray(odd), np.arange(3), np.zeros((0, 5))]
    before = [a.copy() for a in arrays]
    send(line, {"arrays": arrays, "text": "of the map"})
    answer = receive(line)
    assert answer["text"] == "of the map"
    for own, was, back in zip(arrays, before, answer["arrays"], strict=True):
        np.testing.assert_array_equal(own, was)
        np.testing.assert_array_equal(back, 2 * was)
        back += 1  # what was received can be written to


def test_a_message_outlives_the_next_ones(line: Connection) -> None:
    answers = []
    for k in range(5):
        send(line, {"arrays": [np.full(100_000, k)]})
        answers.append(receive(line)["arrays"][0])
    assert [int(a[0]) for a in answers] == [0, 2, 4, 6, 8]
    assert all((a == a[0]).all() for a in answers)


def test_a_closed_line_ends_the_wait() -> None:
    own, other = multiprocessing.Pipe()
    other.close()
    with pytest.raises(EOFError):
        receive(own)
