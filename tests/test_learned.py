"""Fitted tables: read and checked, and their nets evaluated as by the plain formulas."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from alight.learned import (
    CLIP,
    AffineLayer,
    KnownGround,
    Net,
    net_bytes,
    net_of,
    read_known,
    read_net,
    relu_net,
    table_path,
)
from alight.learned.terms import LAND_COVER_TERMS

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
    far = given() | {"b": np.array([-99, 0, 99], np.float32) + net.usual[1]}
    values = net.standardised((name, v.ravel()[:3]) for name, v in far.items())
    assert_allclose(values[net.terms.index("b")], [-CLIP, 0, CLIP])


def test_the_rectified_net_is_its_formula_whatever_the_order_of_the_terms(net: Net) -> None:
    plain = replace(net, output=AffineLayer(net.output.weights[:5], net.output.bias))
    x = standardised(net, given())
    want = np.maximum(x @ net.hidden.weights + net.hidden.bias, 0) @ plain.output.weights + plain.output.bias
    assert_allclose(relu_net(plain, given().items())[0].ravel(), want[:, 0], rtol=2e-3, atol=2e-3)
    assert_allclose(relu_net(plain, list(given().items())[::-1])[0].ravel(), want[:, 0], rtol=2e-3, atol=2e-3)


def test_terms_that_are_missing_strange_or_doubled_are_refused(net: Net) -> None:
    found = given()
    for wrong in ({"a": found["a"], "b": found["b"]}, found | {"d": found["a"]}):
        with pytest.raises(ValueError, match="terms"):
            relu_net(net, wrong.items())
    with pytest.raises(ValueError, match="doubled"):
        relu_net(net, [*found.items(), ("a", found["a"])])


def damaged(**changes: object) -> bytes:
    with np.load(table_path("land_cover"), allow_pickle=False) as z:
        arrays = {k: z[k] for k in z.files} | changes
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"terms": np.array(LAND_COVER_TERMS[::-1])}, "other terms"),
        ({"usual": np.zeros(3, np.float32)}, "shapes"),
        ({"hidden_bias": np.zeros(3, np.float16)}, "biases"),
        ({"output_weights": np.full((48, 8), np.nan, np.float16)}, "finite"),
        ({"spread": np.zeros(45, np.float32)}, "spread"),
        ({"calibration": np.array([[1.0, 0.0], [0.0, 1.0]])}, "ascending"),
        ({"terms": np.array(LAND_COVER_TERMS, object)}, "allow_pickle"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(changes: dict[str, object], message: str) -> None:
    assert net_of(damaged(), LAND_COVER_TERMS).terms == LAND_COVER_TERMS
    with pytest.raises(ValueError, match=message):
        net_of(damaged(**changes), LAND_COVER_TERMS)


def test_the_net_of_the_package_is_read_once() -> None:
    assert read_net("land_cover") is read_net("land_cover")
    assert len(LAND_COVER_TERMS) == len(set(LAND_COVER_TERMS)) == 45


def test_what_lies_on_the_mean_of_a_kind_is_known_and_what_is_far_from_all_is_not() -> None:
    known = read_known()
    on = known.usual + known.means * known.spread
    assert known.novelty(on.astype(np.float32)).max() < 0.05
    far = known.usual + 6 * known.spread * np.where(np.arange(45) % 2, 1, -1)
    assert known.novelty(far[None].astype(np.float32))[0] > 1


def test_novelty_is_the_squared_distance_to_the_nearest_kind_over_its_limit() -> None:
    rng = np.random.default_rng(3)
    whitening = np.diag([1.0, 2.0]).astype(np.float32)
    known = KnownGround(
        ("a", "b"), np.zeros(2, np.float32), np.ones(2, np.float32), np.eye(2, dtype=np.float32), whitening, 4.0
    )
    x = rng.normal(size=(50, 2)).astype(np.float32)
    want = np.min([((x - m) ** 2) @ np.array([1.0, 4.0]) for m in np.eye(2)], axis=0) / 4.0
    assert_allclose(known.novelty(x), want, rtol=1e-4, atol=1e-5)
