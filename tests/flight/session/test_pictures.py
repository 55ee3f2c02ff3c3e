"""A camera that hangs repeats the same bits; one that looks at still ground does not, because of its noise."""

from __future__ import annotations

import math

import numpy as np

from alight.flight.session.inputs import PictureWatch
from alight.records import Frame

S = 1_000_000_000


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (24, 32, 3), np.uint8)


def test_a_frozen_camera_is_left_out_and_the_other_one_goes_on() -> None:
    watch, still = PictureWatch(), picture(0)
    for k in range(6):
        found = watch.fresh(Frame(k * S, (picture(k + 1), still)), k * S)
        assert found is not None
        assert (found.images[1] is None) is (k > 0)
        assert found.images[0] is not None
    assert watch.stuck == (1,)
    assert watch.frozen == 0
    assert watch.age(7 * S) == 2.0
    assert watch.fresh(Frame(8 * S, (picture(20), picture(21))), 8 * S) is not None
    assert watch.stuck == ()


def test_all_frozen_is_no_exposure() -> None:
    watch, pair = PictureWatch(), (picture(0), picture(1))
    assert math.isinf(watch.age(0))
    assert watch.fresh(Frame(S, pair), S) is not None
    for k in range(2, 5):
        assert watch.fresh(Frame(k * S, tuple(i.copy() for i in pair)), k * S) is None
    assert watch.stuck == (0, 1)
    assert watch.frozen == 3
    assert watch.age(5 * S) == 4.0


def test_a_camera_that_gives_nothing_is_not_called_frozen() -> None:
    watch = PictureWatch()
    for k in range(4):
        found = watch.fresh(Frame(k * S, (picture(k), None)), k * S)
        assert found is not None
        assert found.images[1] is None
    assert watch.fresh(Frame(9 * S, (None, None)), 9 * S) is None
    assert watch.stuck == ()
    assert watch.frozen == 0
