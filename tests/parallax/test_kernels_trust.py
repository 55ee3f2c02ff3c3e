"""The kernels of sigma, flags and fusion against plain NumPy; one thread and two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from alight.parallax import uncertainty_kernels as trust

ROWS, COLS, N = 13, 17, 5
BITS = (1, 2, 4, 8)


def numbers(seed: int, low: float, high: float, holes: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = rng.uniform(low, high, (ROWS, COLS)).astype(np.float32)
    out[rng.random(out.shape) < holes] = np.nan
    return out


def whole(seed: int, below: int, kind: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, below, (ROWS, COLS)).astype(kind)


def halves(seed: int, low: float, high: float) -> np.ndarray:
    return numbers(seed, low, high)[: -(-ROWS // 2), : -(-COLS // 2)].copy()


def enlarged(half: np.ndarray) -> np.ndarray:
    return np.repeat(np.repeat(half, 2, axis=0), 2, axis=1)[:ROWS, :COLS]


def pool_input() -> tuple[np.ndarray, ...]:
    even = np.s_[: ROWS // 2 * 2, : COLS // 2 * 2]
    all_of = numbers(1, -1, 1, 0.2), numbers(2, -1, 1, 0.2), numbers(3, 0, 0.1), numbers(4, 0, 200), numbers(5, 0.1, 1)
    return tuple(np.ascontiguousarray(a[even]) for a in all_of)


def run_pool() -> tuple[np.ndarray, ...]:
    out = np.full((8, ROWS // 2, COLS // 2), -9, np.float32)
    trust.pool(*pool_input(), 0.25, out)
    return tuple(out)


def sigma_input() -> tuple[np.ndarray, ...]:
    precision = np.where(whole(3, 5) == 0, np.float32(0), numbers(4, 10, 200))
    return numbers(1, -1, 1, 0.2), numbers(2, 0.01, 0.1), precision, halves(6, 0, 0.01)


def run_sigma() -> tuple[np.ndarray, ...]:
    out = np.full((ROWS, COLS), -9, np.float32)
    trust.height_sigma(*sigma_input(), 0.4, out)
    return (out,)


def flag_input() -> tuple[np.ndarray, ...]:
    near = whole(10, 2, np.uint16)[: -(-ROWS // 2), : -(-COLS // 2)] * np.uint16(64)
    return near, halves(14, 0, 1), numbers(1, -2, 2, 0.2), whole(11, 5), whole(12, 5), numbers(4, 0.1, 1, 0.3)


def run_flag() -> tuple[np.ndarray, ...]:
    share, out = np.full((ROWS, COLS), -9, np.float32), np.full((ROWS, COLS), 9999, np.uint16)
    trust.flag(*flag_input(), -1.5, 1.4, BITS, share, out)
    return share, out


def veil_input() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(20)
    visible = (rng.random((N, -(-ROWS // 2), -(-COLS // 2))) < 0.5).astype(np.uint8)
    return visible, rng.normal(size=(N, ROWS, COLS)).astype(np.float32)


def run_veil() -> tuple[np.ndarray, ...]:
    visible, samples = veil_input()
    trust.veil(visible, samples)
    return (samples,)


def fuse_input() -> tuple[list[np.ndarray], list[np.ndarray]]:
    new = [
        numbers(30, -0.2, 0.2, 0.2),
        numbers(31, 0.02, 0.2, 0.1),
        whole(32, 9, np.uint16),
        whole(33, 9),
        numbers(34, 0, 1),
        numbers(35, 0.05, 0.2),
    ]
    old = [
        numbers(40, -0.2, 0.2, 0.3),
        numbers(41, 0.02, 0.2),
        whole(42, 9, np.uint16),
        whole(43, 9),
        numbers(44, 0, 1),
        numbers(45, 0.05, 0.2),
    ]
    return new, old


def run_fuse() -> tuple[np.ndarray, ...]:
    new, old = fuse_input()
    trust.fuse(*new, *old, 1.5)
    return tuple(new)


def test_pool() -> None:
    h, mean, noise, precision, per_px = (a.astype(np.float64) for a in pool_input())
    fours = [np.stack([a[i::2, j::2] for i in (0, 1) for j in (0, 1)]) for a in (h, mean, noise, precision)]
    h, mean = np.where(np.isnan(fours[0]), 0.25, fours[0]), np.nan_to_num(fours[1])
    fitted = np.minimum(fours[2] / (fours[3] * per_px[::2, ::2] ** 2 + 1e-12), 25.0)
    want = (h.min(0), h.max(0), h.mean(0), h.var(0), mean.mean(0), (mean**2).mean(0), fours[2].mean(0), fitted.mean(0))
    for got, w in zip(run_pool(), want, strict=True):
        assert_allclose(got, w, rtol=1e-4, atol=1e-6)


def test_sigma() -> None:
    h, noise, precision, hidden2 = (a.astype(np.float64) for a in sigma_input())
    with np.errstate(divide="ignore"):
        want = np.sqrt(0.4 * noise / precision + enlarged(hidden2))
    want[(precision == 0) | np.isnan(h)] = np.nan
    assert np.isnan(h).any()
    assert (precision == 0).any()
    assert_allclose(run_sigma()[0], want, rtol=1e-5, equal_nan=True)


def test_flag() -> None:
    near, share, h, seen, used, sigma = flag_input()
    want = enlarged(near).copy()
    marks = (
        np.isnan(h) | (seen < 2),
        (used < 2) | (np.isnan(sigma) & np.isfinite(h)),
        seen < 3,
        (h < -1.5) | (h > 1.4),
    )
    for where, bit in zip(marks, BITS, strict=True):
        assert where.any()
        want[where] |= np.uint16(bit)
    got = run_flag()
    assert_array_equal(got[0], enlarged(share))
    assert_array_equal(got[1], want)


def test_veil_hides_views_unless_only_one_would_be_left() -> None:
    visible, samples = veil_input()
    fine = np.repeat(np.repeat(visible, 2, axis=1), 2, axis=2)[:, :ROWS, :COLS]
    hidden = (fine == 0) & (fine.sum(axis=0) >= 2)
    assert hidden.any()
    assert (~hidden & (fine == 0)).any()
    assert_array_equal(run_veil()[0], np.where(hidden, np.float32(np.nan), samples))


def test_fuse() -> None:
    """All four cases of eq. 16 agree: new cell, worse sigma, agreement, contradiction."""
    (h, s, f, v, e, g), (h0, s0, f0, v0, e0, g0) = fuse_input()
    got = run_fuse()
    for i in np.ndindex(ROWS, COLS):
        if not np.isnan(h0[i]) and (np.isnan(h[i]) or not s[i] < 1.5 * s0[i]):
            want = (h0[i], s0[i], f0[i], v0[i], e0[i], g0[i])
        elif not np.isnan(h0[i]) and abs(h[i] - h0[i]) < 3 * np.hypot(s[i], s0[i]):
            a, b = 1 / s0[i] ** 2, 1 / s[i] ** 2
            want = ((a * h0[i] + b * h[i]) / (a + b), max((a + b) ** -0.5, 0.95 * s[i]), f[i], v[i], e[i], g[i])
        else:
            want = (h[i], s[i], f[i], v[i], e[i], g[i])
        assert_allclose([float(a[i]) for a in got], want, rtol=2e-5, atol=1e-6, equal_nan=True)


# -- threads

CALLS: dict[str, Callable[[], tuple[np.ndarray, ...]]] = {
    "pool": run_pool, "height_sigma": run_sigma, "flag": run_flag, "veil": run_veil, "fuse": run_fuse,
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_the_number_of_threads_changes_no_bit(name: str, on_one_and_all: Callable[..., Any]) -> None:
    for a, b in zip(*on_one_and_all(CALLS[name]), strict=True):
        assert a.tobytes() == b.tobytes()


def test_every_kernel_is_tested_here() -> None:
    public = {n for n, k in vars(trust).items() if hasattr(k, "py_func") and not n.startswith("_")}
    assert public == set(CALLS)
