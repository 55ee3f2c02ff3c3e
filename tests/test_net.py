"""Nets stored as text."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from alight.learned.layers import CLIP, pack_layer, standard, unpack_layer


def test_a_layer_survives_its_text() -> None:
    layer = np.random.default_rng(0).normal(0, 1, (6, 3)).astype(np.float32)
    weights, bias = unpack_layer(pack_layer(layer))
    assert weights.shape == (5, 3)
    assert_allclose(np.vstack([weights, bias]), layer, rtol=1e-3)
    assert_array_equal(unpack_layer(pack_layer(np.vstack([weights, bias])))[0], weights)


def test_what_lies_far_outside_of_what_was_learned_says_no_more() -> None:
    assert_allclose(standard(np.array([-99, 1, 3, 99], np.float32), 1.0, 2.0), [-CLIP, 0, 1, CLIP])
