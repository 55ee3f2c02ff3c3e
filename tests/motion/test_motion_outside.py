"""Keyframe posterior and trajectory against outside tools: gtsam, and evo called as a program (extra `reference`)."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from point_flight import PointFlight, best, run
from pose_window import ALIKE, CAMS, clone_slice, ground, row_of_poses, seen_from

from alight.geometry import Pose, so3_exp, so3_log
from alight.motion.ekf.keyframe_posterior import CloneWindow
from alight.motion.ekf.state import CORE, FilterState


def loose_state(seed: int, count: int = 5) -> tuple[FilterState, object, np.ndarray]:
    """Return poses with errors of their prior, and the observations of forty points from the true poses."""
    rng = np.random.default_rng(seed)
    true, x = row_of_poses(rng, count), ground(rng, 40)
    state = FilterState(0, true.R[0], np.zeros(CORE), np.eye(CORE) * 1e-12)
    for k in range(count):
        off = rng.normal(size=6) * np.repeat([2e-3, 0.1], 3)
        state.R, state.core[3:6] = so3_exp(off[:3]) @ true.R[k], true.p[k] + off[3:]
        state.add_clone(k)
        at = clone_slice(k)
        state.P[at, :], state.P[:, at] = 0.0, 0.0
        state.P[at, at] = np.diag(np.repeat([4e-6, 1e-2], 3))
    return state, seen_from(true, x, rng, 1e-3), x


def test_the_keyframe_posterior_agrees_with_gtsam(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve the same priors and observations, with equal weights, by gtsam's Levenberg-Marquardt over all points.

    Poses agree to 2 mm and 0.05 mrad, sigmas to 3 %.
    """
    monkeypatch.setattr("alight.motion.robust.robust_weights", lambda misfit, median: np.ones(len(misfit)))
    gtsam = pytest.importorskip("gtsam", reason="gtsam is not installed: pip install 'alight[reference]'")
    state, observations, x = loose_state(1)
    found = CloneWindow.of(state, observations, CAMS, ALIKE).refined()  # type: ignore[arg-type]
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    pose_noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([2e-3, 0.1], 3))
    pixel, lens = gtsam.noiseModel.Isotropic.Sigma(2, 1e-3), gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)
    bodies = [gtsam.Pose3(gtsam.Rot3(c.rotation), c.translation) for c in CAMS]
    for k, (R, p) in enumerate(zip(state.clones.R, state.clones.p, strict=True)):
        pose = gtsam.Pose3(gtsam.Rot3(R), p)
        graph.add(gtsam.PriorFactorPose3(k, pose, pose_noise))
        start.insert(k, pose)
    for j, point in enumerate(x):
        start.insert(1000 + j, point)
        for k in range(len(state.clones)):
            for i, body in enumerate(bodies):
                z = observations.normalised[j, k, i]  # type: ignore[attr-defined]
                graph.add(gtsam.GenericProjectionFactorCal3_S2(z, pixel, k, 1000 + j, lens, body))
    result = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    marginals = gtsam.Marginals(graph, result)
    for k in range(len(state.clones)):
        theirs = result.atPose3(k)
        np.testing.assert_allclose(found.clones.p[k], theirs.translation(), atol=2e-3)
        assert np.linalg.norm(so3_log(found.clones.R[k] @ theirs.rotation().matrix().T)) < 5e-5
        ours = found.P[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        turn = theirs.rotation().matrix()  # gtsam's errors are in the body
        there = turn @ marginals.marginalCovariance(k)[3:, 3:] @ turn.T
        np.testing.assert_allclose(np.sqrt(np.diag(ours)[3:]), np.sqrt(np.diag(there)), rtol=0.03)


def test_evo_reads_the_trajectory_and_agrees(tmp_path: Path) -> None:
    """evo's absolute position error of a flight is the same as ours."""
    evo = shutil.which("evo_ape") or str(Path(sys.executable).parent / "evo_ape")
    if not Path(evo).exists():
        pytest.skip("evo is not installed: pip install 'alight[reference]'")
    f = PointFlight(seed=7, seconds=2.0, count=40)
    motions = run(f.events)[1]
    for name, poses in (
        ("truth", [f.truth(m.t_ns) for m in motions]),
        ("said", [Pose(m.world_from_body.rotation, best(m)[0]) for m in motions]),
    ):
        lines = []
        for m, pose in zip(motions, poses, strict=True):
            w, *v = pose.quaternion
            lines.append(f"{m.t_ns / 1e9:.9f} " + " ".join(f"{n:.9f}" for n in (*pose.translation, *v, w)))
        (tmp_path / f"{name}.tum").write_text("\n".join(lines) + "\n")
    files = [str(tmp_path / "truth.tum"), str(tmp_path / "said.tum")]
    done = subprocess.run([evo, "tum", *files], capture_output=True, text=True, check=True, cwd=tmp_path)
    theirs = next(float(line.split()[1]) for line in done.stdout.splitlines() if line.split()[:1] == ["rmse"])
    off = [best(m)[0] - f.truth(m.t_ns).translation for m in motions]
    assert theirs == pytest.approx(float(np.sqrt(np.mean(np.square(off).sum(axis=1)))), rel=1e-4)
