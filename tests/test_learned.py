"""Fitted tables: read and checked, and the nets in them evaluated as their plain formulas say."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from alight.learned import CLIP, AffineLayer, Net, monotone_costs, net_bytes, net_of, read_net, relu_net, table_path
from alight.learned.terms import HAZARD_TERMS, LAND_COVER_TERMS

NAMES = ("a", "b", "c")


@pytest.fixture
def net() -> Net:
    rng = np.random.default_rng(0)
    usual, spread = rng.normal(size=3).astype(np.float16), np.full(3, 0.5)
    layers = [rng.normal(size=s).astype(np.float16).astype(np.float32) for s in ((3, 5), (5,), (8, 1), (1,))]
    calibration = np.array([[-2.0, 0.0, 3.0], [-1.0, 0.5, 2.0]])
    return Net(
        NAMES,
        usual.astype(np.float32),
        spread.astype(np.float32),
        AffineLayer(*layers[:2]),
        AffineLayer(*layers[2:]),
        calibration,
    )


def given(shape: tuple[int, int] = (4, 6)) -> dict[str, np.ndarray]:
    return {n: np.random.default_rng(i).normal(size=shape).astype(np.float32) for i, n in enumerate(NAMES)}


def standardised(net: Net, found: dict[str, np.ndarray]) -> np.ndarray:
    x = np.stack([found[n].ravel() for n in net.terms], axis=1)
    return np.clip((x - net.usual) / net.spread, -4, 4)


def test_a_net_survives_its_file(net: Net) -> None:
    again = net_of(net_bytes(net), NAMES)
    assert again.terms == NAMES
    assert_allclose(again.usual, net.usual, rtol=1e-3)
    for a, b in ((again.hidden, net.hidden), (again.output, net.output)):
        assert_array_equal(a.weights, b.weights)
        assert_array_equal(a.bias, b.bias)
    assert_array_equal(again.calibration, net.calibration)
    assert net_bytes(again) == net_bytes(net_of(net_bytes(again), NAMES))


def test_a_term_far_outside_of_the_training_data_counts_no_further(net: Net) -> None:
    one = net.standardised(["b"], [np.array([-99, 0, 99], np.float32) + net.usual[1]])
    assert_allclose(one[:, 0], [-CLIP, 0, CLIP])


def test_the_rectified_net_is_its_formula_whatever_the_order_of_the_terms(net: Net) -> None:
    plain = replace(net, output=AffineLayer(net.output.weights[:5], net.output.bias))
    x = standardised(net, given())
    want = np.maximum(x @ net.hidden.weights + net.hidden.bias, 0) @ plain.output.weights + plain.output.bias
    assert_allclose(relu_net(plain, given().items())[..., 0].ravel(), want[:, 0], rtol=1e-4, atol=1e-5)
    assert_allclose(relu_net(plain, list(given().items())[::-1])[..., 0].ravel(), want[:, 0], rtol=1e-4, atol=1e-5)


def test_the_monotone_net_is_its_formula(net: Net) -> None:
    x = standardised(net, given())
    seen = np.hstack([np.tanh(x @ net.hidden.weights + net.hidden.bias), x])
    assert_allclose(
        monotone_costs(net, given()), (seen @ net.output.weights + net.output.bias)[:, 0], rtol=1e-4, atol=1e-5
    )


def test_terms_that_are_missing_strange_or_doubled_are_refused(net: Net) -> None:
    found = given()
    for wrong in ({"a": found["a"], "b": found["b"]}, found | {"d": found["a"]}):
        with pytest.raises(ValueError, match="terms"):
            relu_net(net, wrong.items())
        with pytest.raises(ValueError, match="terms"):
            monotone_costs(net, wrong)
    with pytest.raises(ValueError, match="doubled"):
        relu_net(net, [*found.items(), ("a", found["a"])])


def damaged(**changes: object) -> bytes:
    with np.load(table_path("p_safe"), allow_pickle=False) as z:
        arrays = {k: z[k] for k in z.files} | changes
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"terms": np.array(HAZARD_TERMS[::-1])}, "other terms"),
        ({"usual": np.zeros(15, np.float32)}, "shapes"),
        ({"hidden_bias": np.zeros(3, np.float16)}, "biases"),
        ({"output_weights": np.full((32, 1), np.nan, np.float16)}, "finite"),
        ({"spread": np.zeros(16, np.float32)}, "spread"),
        ({"calibration": np.array([[1.0, 0.0], [0.0, 1.0]])}, "ascending"),
        ({"terms": np.array(HAZARD_TERMS, object)}, "allow_pickle"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(changes: dict[str, object], message: str) -> None:
    assert net_of(damaged(), HAZARD_TERMS).terms == HAZARD_TERMS
    with pytest.raises(ValueError, match=message):
        net_of(damaged(**changes), HAZARD_TERMS)


@pytest.mark.parametrize("name", ["p_safe", "land_cover"])
def test_the_tables_of_the_package_are_read_once(name: str) -> None:
    assert read_net(name) is read_net(name)
    assert len(LAND_COVER_TERMS) == len(set(LAND_COVER_TERMS)) == 88


def test_the_costs_of_p_safe_never_fall_where_a_term_grows() -> None:
    net = read_net("p_safe")
    assert (net.hidden.weights >= 0).all()
    assert (net.output.weights >= 0).all()
    assert net.calibration is not None
    assert (np.diff(net.calibration[1]) >= 0).all()


@pytest.mark.parametrize("name", ["p_safe", "land_cover", "appearance"])
def test_every_table_has_a_card_that_says_what_it_is(name: str) -> None:
    card = table_path(name).with_suffix(".md").read_text(encoding="utf-8")
    for heading in ("What it is", "Fitted on", "Made by", "Metrics", "Limits"):
        assert f"## {heading}" in card, heading


def test_the_card_of_p_safe_quotes_its_own_numbers() -> None:
    """The least probability it can give, and the spread of the coarseness, stand in the card as they are."""
    net, card = read_net("p_safe"), table_path("p_safe").with_suffix(".md").read_text(encoding="utf-8")
    assert net.calibration is not None
    least, most = 1 / (1 + np.exp(-net.calibration[1][[0, -1]]))
    assert f"never below {least:.2f}" in card
    assert f"never above {most:.3f}" in card
    assert f"spread of `coarseness` is {net.spread[0]:.3f}" in card
