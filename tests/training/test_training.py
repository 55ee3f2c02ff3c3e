"""The commands that fit the tables: draws, cards and nets. The fits need scikit-learn, the extra `train`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from alight.learned.terms import LAND_COVER_TERMS

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def commands(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    before = set(sys.modules)
    for folder in ("bench", "training"):
        monkeypatch.syspath_prepend(str(ROOT / folder))
    yield
    for name in set(sys.modules) - before:  # bench and training have modules with common names
        if str(ROOT / "training") in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def test_draws_are_by_weight_and_each_flight_is_shifted_as_one() -> None:
    from land_cover import SHIFT, rounds_of

    weight = np.r_[np.full(5000, 0.9 / 5000), np.full(5000, 0.1 / 5000)]
    flight = np.repeat(np.arange(100), 100)
    rounds = list(rounds_of(np.random.default_rng(0), weight, flight, 7, rounds=20, batch=1000))
    assert all(len(r.cells) == 10_000 for r in rounds)
    assert_allclose(np.mean([(r.cells < 5000).mean() for r in rounds]), 0.9, atol=0.01)
    assert rounds[0].shift.shape == (100, 7)
    assert_allclose(np.std([r.shift for r in rounds]), SHIFT, rtol=0.03)


def test_a_card_keeps_the_sections_that_a_fit_does_not_change() -> None:
    from card import with_sections

    card = "# t\n\n## What it is\nA.\n\n## Metrics\nold\n\n- 1\n\n## Limits\nB.\n"
    assert with_sections(card, {"Metrics": r"new \d"}) == (
        "# t\n\n## What it is\nA.\n\n## Metrics\nnew \\d\n\n## Limits\nB.\n"
    )
    with pytest.raises(ValueError, match="Date"):
        with_sections(card, {"Date": ""})


def test_the_land_cover_net_learns_classes_that_its_terms_tell_apart() -> None:
    pytest.importorskip("sklearn")
    from land_cover import CLASSES, Rows, fit_net

    rng, count = np.random.default_rng(0), 40_000
    kind = rng.integers(0, CLASSES, count)
    values = rng.normal(size=(count, len(LAND_COVER_TERMS))).astype(np.float32)
    values[:, :CLASSES] += 4 * np.eye(CLASSES)[kind]
    flight = rng.integers(0, 20, count)
    net = fit_net(Rows(LAND_COVER_TERMS, values, kind, np.full(count, 1 / count), flight))
    found = {name: values[None, :, i] for i, name in enumerate(LAND_COVER_TERMS)}
    assert (net.outputs(found.items())[:, 0].argmax(axis=0) == kind).mean() > 0.9


def test_rates_are_monotone_and_learn_the_terms_that_matter() -> None:
    pytest.importorskip("sklearn")
    from p_safe import Part, Rows, caution, expected, fit

    rng, count = np.random.default_rng(0), 6000
    x, y = rng.uniform(-1, 1, (2, count, 2))
    unseen = rng.uniform(0, 1, count)
    true = np.exp(-4 + 3 * (x[:, 0] > 0)) + unseen * np.exp(-3 + 3 * (y[:, 1] > 0))
    r = Rows(
        (Part(("a", "b"), x, np.ones(count)), Part(("c", "d"), y, unseen)),
        rng.uniform(size=count) < -np.expm1(-true), rng.integers(0, 3, count), np.full(count, 1 / count),
    )  # fmt: skip
    rates = fit(r, 0.5)
    for k in rates:
        assert (np.diff(k.heights, axis=1) >= 0).all()
    got = expected(rates, r)
    assert np.corrcoef(np.log(got), np.log(true))[0, 1] > 0.85
    assert abs(got.mean() / true.mean() - 1) < 0.1
    assert caution(4 * true, r) <= caution(true, r) <= caution(0.25 * true, r)
