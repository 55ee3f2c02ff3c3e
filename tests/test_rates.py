"""Rates of hazards: their lines, their files, and their invariants."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from alight.learned import Rate, rate_bytes, rate_of, read_rate, table_path
from alight.learned.terms import DENSITY_TERMS, GROUND_TERMS, NEAR_TERMS, RELIEF_TERMS

NAMES = ("a", "b")
KNOTS = np.array([[0.0, 1.0, 2.0], [-1.0, 0.0, 4.0]])
HEIGHTS = np.array([[0.0, 0.5, 0.5], [0.0, 0.0, 2.0]])
FROM_AFAR = {"relief_rate": RELIEF_TERMS, "density_rate": DENSITY_TERMS, "ground_rate": GROUND_TERMS}
NEAR_BY = {"near_obstacle_rate": NEAR_TERMS, "near_ground_rate": NEAR_TERMS}
PACKAGE = FROM_AFAR | NEAR_BY


def a_rate() -> Rate:
    return Rate(NAMES, KNOTS, HEIGHTS, -3.0)


def test_the_logarithm_of_a_rate_is_the_sum_of_its_lines() -> None:
    found = {"a": np.array([-5.0, 0.5, 9.0], np.float32), "b": np.array([-9.0, 2.0, 99.0], np.float32)}
    assert_allclose(a_rate().log_rate(found), [-3.0, -3.0 + 0.25 + 1.0, -3.0 + 0.5 + 2.0], rtol=1e-6)


def test_a_rate_survives_its_file() -> None:
    again = rate_of(rate_bytes(a_rate()), NAMES)
    for k in ("knots", "heights"):
        assert_allclose(getattr(again, k), getattr(a_rate(), k))
    assert again.bias == -3.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"terms": np.array(["b", "a"])}, "other terms"),
        ({"knots": KNOTS[:1]}, "shapes"),
        ({"bias": np.float64(np.nan)}, "finite"),
        ({"heights": -HEIGHTS}, "falls"),
        ({"knots": KNOTS[:, ::-1]}, "ascend"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(changes: dict[str, Any], message: str) -> None:
    with np.load(io.BytesIO(rate_bytes(a_rate()))) as z:
        arrays = {k: z[k] for k in z.files} | changes
    out = io.BytesIO()
    np.savez(out, **arrays)
    with pytest.raises(ValueError, match=message):
        rate_of(out.getvalue(), NAMES)


@pytest.mark.parametrize("name", PACKAGE)
def test_no_evidence_makes_a_touchdown_likelier_where_it_is_worse(name: str) -> None:
    rng, rate = np.random.default_rng(1), read_rate(name)
    assert rate.terms == PACKAGE[name]
    for t, at in enumerate(rate.knots):
        for _ in range(10):
            low, high = rate.knots[:, 0], rate.knots[:, -1]
            usual = low + (high - low) * rng.uniform(-0.5, 1.5, len(low))
            some = {k: np.full(80, v, np.float32) for k, v in zip(rate.terms, usual, strict=True)}
            some[rate.terms[t]] = np.linspace(at[0] - 2, at[-1] + 2, 80, dtype=np.float32)
            assert (np.diff(rate.log_rate(some)) >= -1e-6).all(), rate.terms[t]


@pytest.mark.parametrize("rates", [FROM_AFAR, NEAR_BY])
def test_quiet_even_known_ground_can_be_a_site(rates: dict[str, tuple[str, ...]]) -> None:
    best = [read_rate(n).log_rate({k: np.full(1, -99.0, np.float32) for k in t})[0] for n, t in rates.items()]
    assert np.exp(-np.exp(best).sum()) > 0.97


@pytest.mark.parametrize("name", [*PACKAGE, "detection", "known_ground", "land_cover", "appearance"])
def test_every_table_has_a_card_that_says_what_it_is(name: str) -> None:
    card = table_path(name).with_suffix(".md").read_text(encoding="utf-8")
    for heading in ("What it is", "Fitted on", "Made by", "Metrics", "Limits"):
        assert f"## {heading}" in card, heading
