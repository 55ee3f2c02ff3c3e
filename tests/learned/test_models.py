"""Fitted tables: read and checked, their models evaluated as by the plain formulas, and their invariants."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from alight.learned import KnownGround, Net, Rate, read_floors, read_known, read_net, read_rate, table_path
from alight.learned.models import RATES, FittedTable
from alight.learned.terms import LAND_COVER_TERMS, NearTerm

NAMES = ("a", "b", "c")
RATE = Rate(
    NAMES[:2], np.array([[0.0, 1.0, 2.0], [-1.0, 0.0, 4.0]]), np.array([[0.0, 0.5, 0.5], [0.0, 0.0, 2.0]]), -3.0
)
FROM_AFAR, NEAR_BY = ("relief_rate", "density_rate", "ground_rate"), ("near_obstacle_rate", "near_ground_rate")


def a_net() -> Net:
    rng = np.random.default_rng(0)
    numbers = [rng.normal(size=s).astype(np.float16).astype(np.float32) for s in (3, (3, 5), 5, (5, 1), 1)]
    return Net(NAMES, numbers[0], np.full(3, 0.5, np.float32), *numbers[1:])


def some_ground() -> KnownGround:
    one = np.ones(2, np.float32)
    return KnownGround(
        NAMES[:2], 0 * one, one, np.eye(2, dtype=np.float32), np.diag([1.0, 2.0]).astype(np.float32), 4.0
    )


def given(shape: tuple[int, int] = (4, 6)) -> dict[str, np.ndarray]:
    return {n: np.random.default_rng(i).normal(size=shape).astype(np.float32) for i, n in enumerate(NAMES)}


@pytest.mark.parametrize("table", [a_net(), RATE, some_ground()])
def test_a_table_survives_its_file(table: FittedTable) -> None:
    again = type(table).of(table.to_bytes(), table.terms)
    for name, value in vars(table).items():
        assert_array_equal(getattr(again, name), value)
    assert again.to_bytes() == table.to_bytes()


@pytest.mark.parametrize(
    ("table", "changes", "message"),
    [
        (a_net(), {"terms": np.array(NAMES[::-1])}, "other terms"),
        (a_net(), {"usual": np.zeros(2, np.float32)}, "shapes"),
        (a_net(), {"hidden_bias": np.zeros(3, np.float16)}, "shapes"),
        (a_net(), {"output_weights": np.full((5, 1), np.nan, np.float16)}, "finite"),
        (a_net(), {"spread": np.zeros(3, np.float32)}, "not allowed"),
        (a_net(), {"terms": np.array(NAMES, object)}, "allow_pickle"),
        (some_ground(), {"whitening": np.eye(3)}, "shapes"),
        (some_ground(), {"spread": np.zeros(2)}, "not allowed"),
        (RATE, {"terms": np.array(["b", "a"])}, "other terms"),
        (RATE, {"knots": RATE.knots[:1]}, "shapes"),
        (RATE, {"bias": np.float64(np.nan)}, "finite"),
        (RATE, {"heights": -RATE.heights}, "not allowed"),
        (RATE, {"knots": RATE.knots[:, ::-1]}, "not allowed"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(table: FittedTable, changes: dict[str, Any], message: str) -> None:
    with np.load(io.BytesIO(table.to_bytes())) as z:
        arrays = {k: z[k] for k in z.files} | changes
    out = io.BytesIO()
    np.savez(out, **arrays)
    with pytest.raises(ValueError, match=message):
        type(table).of(out.getvalue(), table.terms)


def test_a_table_without_one_of_its_arrays_is_refused() -> None:
    with pytest.raises(ValueError, match="hidden_weights"):
        Net.of(RATE.to_bytes(), RATE.terms)


def test_a_term_far_outside_of_the_training_data_counts_no_further() -> None:
    net = a_net()
    far = given() | {"b": np.array([-99, 0, 99], np.float32) + net.usual[1]}
    values = net.standardised((name, v.ravel()[:3]) for name, v in far.items())
    assert_allclose(values[net.terms.index("b")], [-net.clip, 0, net.clip])


def test_the_rectified_net_is_its_formula_whatever_the_order_of_the_terms() -> None:
    net, found = a_net(), given()
    x = np.clip((np.stack([found[n].ravel() for n in NAMES], axis=1) - net.usual) / net.spread, -4, 4)
    want = np.maximum(x @ net.hidden_weights + net.hidden_bias, 0) @ net.output_weights + net.output_bias
    for terms in (found.items(), list(found.items())[::-1]):
        assert_allclose(net.outputs(terms)[0].ravel(), want[:, 0], rtol=2e-3, atol=2e-3)


def test_terms_that_are_missing_strange_or_doubled_are_refused() -> None:
    net, found = a_net(), given()
    for wrong in ({"a": found["a"], "b": found["b"]}, found | {"d": found["a"]}):
        with pytest.raises(ValueError, match="terms"):
            net.outputs(wrong.items())
    with pytest.raises(ValueError, match="doubled"):
        net.outputs([*found.items(), ("a", found["a"])])


def test_the_net_of_the_package_is_read_once() -> None:
    assert read_net() is read_net()
    assert len(LAND_COVER_TERMS) == len(set(LAND_COVER_TERMS)) == 45


def test_what_lies_on_the_mean_of_a_kind_is_known_and_what_is_far_from_all_is_not() -> None:
    known = read_known()
    on = known.usual + known.means * known.spread
    assert known.novelty(on.astype(np.float32)).max() < 0.05
    far = known.usual + 6 * known.spread * np.where(np.arange(45) % 2, 1, -1)
    assert known.novelty(far[None].astype(np.float32))[0] > 1


def test_novelty_is_the_squared_distance_to_the_nearest_kind_over_its_limit() -> None:
    x = np.random.default_rng(3).normal(size=(50, 2)).astype(np.float32)
    want = np.min([((x - m) ** 2) @ np.array([1.0, 4.0]) for m in np.eye(2)], axis=0) / 4.0
    assert_allclose(some_ground().novelty(x), want, rtol=1e-4, atol=1e-5)


def test_the_logarithm_of_a_rate_is_the_sum_of_its_curves() -> None:
    found = {"a": np.array([-5.0, 0.5, 9.0], np.float32), "b": np.array([-9.0, 2.0, 99.0], np.float32)}
    assert_allclose(RATE.log_rate(found), [-3.0, -3.0 + 0.25 + 1.0, -3.0 + 0.5 + 2.0], rtol=1e-6)


@pytest.mark.parametrize("name", RATES)
def test_no_evidence_makes_a_touchdown_likelier_where_it_is_worse(name: str) -> None:
    rng, rate = np.random.default_rng(1), read_rate(name)
    for t, at in enumerate(rate.knots):
        for _ in range(10):
            low, high = rate.knots[:, 0], rate.knots[:, -1]
            usual = low + (high - low) * rng.uniform(-0.5, 1.5, len(low))
            some = {k: np.full(80, v, np.float32) for k, v in zip(rate.terms, usual, strict=True)}
            some[rate.terms[t]] = np.linspace(at[0] - 2, at[-1] + 2, 80, dtype=np.float32)
            assert (np.diff(rate.log_rate(some)) >= -1e-6).all(), rate.terms[t]


@pytest.mark.parametrize("rates", [FROM_AFAR, NEAR_BY])
def test_quiet_even_known_ground_can_be_a_site(rates: tuple[str, ...]) -> None:
    best = [read_rate(n).log_rate({k: np.full(1, -99.0, np.float32) for k in RATES[n]})[0] for n in rates]
    assert np.exp(-np.exp(best).sum()) > 0.97


@pytest.mark.parametrize("name", read_floors())
def test_no_evidence_lowers_a_floor(name: str) -> None:
    floor, rng = read_floors()[name], np.random.default_rng(1)
    names = sorted({term for product in floor.products for term in product})
    for term in set(names) - {NearTerm.NARROW}:  # it chooses between two curves
        for _ in range(20):
            some = {k: np.full(80, rng.uniform(-2, 2), np.float32) for k in names}
            at = floor.expected(some | {term: np.linspace(-3, 3, 80, dtype=np.float32)})
            assert at.min() >= 0
            assert (np.diff(at) >= -1e-6).all(), term


@pytest.mark.parametrize("name", [*RATES, "detection", "known_ground", "land_cover", "appearance", "floors", "heights"])
def test_every_table_has_a_card_that_explains_it(name: str) -> None:
    card = table_path(name).with_suffix(".md").read_text(encoding="utf-8")
    for heading in ("What it is", "Fitted on", "Made by", "Metrics", "Limits"):
        assert f"## {heading}" in card, heading
