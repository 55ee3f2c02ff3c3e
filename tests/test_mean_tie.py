"""The tie of a landing's set-points: the autopilot's estimate, without the noise of its reports."""

from __future__ import annotations

import numpy as np

from alight.trials.mean_tie import COUNT, JUMP, MeanTie


def test_the_noise_of_reports_is_averaged() -> None:
    rng, tie, steps = np.random.default_rng(3), MeanTie(), list[np.ndarray]()
    np.testing.assert_array_equal(tie.mean, 0.0)
    for _ in range(200):
        tie.add(np.array([1.0, -2.0, 0.5]) + rng.normal(0, 0.3, 3), 4)
        steps.append(tie.mean)
    assert tie.frame_id == 4
    spread = np.std(np.array(steps[COUNT:]) - [1.0, -2.0, 0.5])
    assert 0.05 < spread < 1.3 * 0.3 / np.sqrt(COUNT)


def test_a_jump_and_another_frame_are_followed_at_once() -> None:
    tie = MeanTie()
    for _ in range(COUNT):
        tie.add(np.zeros(3), 0)
    tie.add(np.array([JUMP + 0.1, 0.0, 0.0]), 0)
    np.testing.assert_allclose(tie.mean, [JUMP + 0.1, 0.0, 0.0])
    tie.add(np.array([JUMP + 0.2, 0.0, 0.0]), 0)
    np.testing.assert_allclose(tie.mean, [JUMP + 0.15, 0.0, 0.0])
    tie.add(np.ones(3), 1)
    np.testing.assert_allclose(tie.mean, 1.0)
