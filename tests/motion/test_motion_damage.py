"""Named damage, and the required response of the filter; the expectation stands in each docstring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from motion_scenarios import COVERED, DEGRADED, DROPPED, GOOD, JUMP, LOST, MOVING, OUTAGE, TURNED, Outcome
from point_flight import NOISE, PointFlight, blind, damaged, nees, run, seconds

from alight.geometry import so3_log
from alight.records import Motion, MotionState, NavSample, Tracks

SMALL = {"count": 60.0}


def fly(scenario: object, **changes: float) -> Outcome:
    return replace(scenario, flight={**SMALL, **scenario.flight}, **changes).fly(1)  # type: ignore[call-overload,attr-defined]


def test_a_gps_jump_of_5_m_for_3_s() -> None:
    """GPS is 5 m off for 3 s: DEGRADED (vision only) while it lasts, GOOD within a second after. The poses do not
    follow (0.1 m against the same flight undamaged, a second after) and do not jump."""
    o = fly(JUMP, length=11.0)
    assert o.share(GOOD, 1.0, 6.0) > 0.98
    assert o.states(6.3, 9.0) == {DEGRADED}
    assert o.states(10.0, 11.0) == {GOOD}
    assert o.against_whole(6.0)[0] < 0.3
    assert o.against_whole(10.0)[0] < 0.1
    assert o.jumps().max() < 0.15


def test_a_fifth_of_the_frames_dropped() -> None:
    """Every fifth frame is missing, which does not degrade the motion: GOOD nearly always, errors within sigma."""
    o = fly(DROPPED, length=8.0)
    assert o.share(GOOD, 1.0, 8.0) > 0.95
    assert o.normalised(2.0) < 4.0


def test_a_lens_covered_for_3_s() -> None:
    """No feature is seen for 3 s: DEGRADED (GPS/INS only) within 0.6 s, GOOD within one second after, no jump."""
    o = fly(COVERED, length=11.0)
    assert o.states(6.6, 9.0) == {DEGRADED}
    assert {m.why.split(":")[0] for m in o.motions if 6.6 < seconds(m) < 9.0} == {"GPS/INS only"}
    assert o.states(10.0, 11.0) == {GOOD}
    assert o.normalised(10.0) < 4.0
    assert o.jumps().max() < 0.15


def test_a_third_of_the_features_moves() -> None:
    """30 % of the features drift with the wind, and are rejected by the gate: GOOD, errors within sigma all the way."""
    o = fly(MOVING, length=8.0)
    assert o.share(GOOD, 1.0, 8.0) > 0.95
    assert o.normalised(2.0) < 4.0


def test_an_ins_heading_10_degrees_off() -> None:
    """The compass is 10 degrees off from the start, six times its claimed sigma, and the pictures contradict it.
    Pictures and GPS give the heading: attitude within 1.5 degrees after 5 s, GOOD, in one map."""
    o = fly(TURNED, length=8.0)
    assert o.states(6.0, 8.0) == {GOOD}
    assert o.turned(5.0) < np.radians(1.5)
    assert o.motions[-1].frame_id == 0


def test_gps_silent_for_30_s() -> None:
    """No GPS/INS for 30 s at 5 m/s: DEGRADED (vision only), never LOST; drift below 1.5 % of the way; then GOOD."""
    o = fly(OUTAGE)
    assert o.states(10.5, 38.0) == {DEGRADED}
    assert o.states(39.0, 40.0) == {GOOD}
    assert o.drift() < 0.015
    assert o.normalised(8.0) < 4.5


def test_a_jump_that_stays_is_taken_in_after_5_s() -> None:
    """GPS jumps by 15 m and stays there: DEGRADED for 5 s, then GOOD; the vehicle does not follow."""
    f = PointFlight(seed=2, seconds=9.0, count=60)

    def jump(e: object) -> object:
        late = isinstance(e, NavSample) and seconds(e) > 2.0
        return replace(e, position_world=e.position_world + np.array([15.0, 0.0, 0.0])) if late else e  # type: ignore[type-var,operator]

    motions = run(damaged(f.events, jump))[1]  # type: ignore[arg-type]
    assert {m.state for m in motions if 2.5 < seconds(m) < 6.5} == {DEGRADED}
    assert motions[-1].state is GOOD
    off = [m.world_from_body.translation - f.truth(m.t_ns).translation for m in motions]
    assert np.linalg.norm(off[-1] - off[15]) < 1.0


def test_blind_and_without_gps_is_lost_and_found_again_in_another_map() -> None:
    """Nothing comes for 4 s: LOST, and with GPS/INS again another map number. The poses before and after are tied
    together by GPS alone, and the map number shows this; GOOD within a second."""
    f = PointFlight(seed=3, seconds=8.0, count=60)

    def cut(e: object) -> object:
        if not 2.0 <= seconds(e) < 6.0:  # type: ignore[arg-type]
            return replace(e, ids=e.ids + 1_000_000) if isinstance(e, Tracks) and seconds(e) >= 6.0 else e
        return None if isinstance(e, NavSample) else blind(e) if isinstance(e, Tracks) else e

    estimator, motions = run(damaged(f.events, cut))  # type: ignore[arg-type]
    assert {m.state for m in motions if 4.1 < seconds(m) < 6.0} == {LOST}
    assert {m.frame_id for m in motions if seconds(m) < 6.0} == {0}
    assert motions[-1].frame_id == 1
    assert {m.state for m in motions if seconds(m) > 7.0} == {GOOD}
    window = estimator.clone_window()
    assert window is not None
    assert {m.frame_id for m in window.posterior().motions} == {1}
    assert max(nees(m, f.truth(m.t_ns)) for m in motions if seconds(m) > 7.0) < 30.0


def test_lost_is_reported_while_it_lasts() -> None:
    """Blind and without GPS, the motion is DEGRADED, then LOST, with the reason, and the covariance grows."""
    f = PointFlight(seed=4, seconds=5.0, count=60)

    def cut(e: object) -> object:
        if seconds(e) < 1.0:  # type: ignore[arg-type]
            return e
        return None if isinstance(e, NavSample) else blind(e) if isinstance(e, Tracks) else e

    motions = run(damaged(f.events, cut))[1]  # type: ignore[arg-type]
    states = [m.state for m in motions]
    assert MotionState.DEGRADED in states[: states.index(LOST)]
    assert motions[-1].state is LOST
    assert "GPS" in motions[-1].why
    assert motions[-1].covariance[0, 0] > motions[9].covariance[0, 0]


def test_motions_are_the_same_with_and_without_a_recording() -> None:
    """With `smooth: false` nothing is kept for the smoother."""
    f = PointFlight(seed=5, seconds=1.0, count=60)
    runs = [run(f.events, NOISE.model_copy(update={"smooth": smooth})) for smooth in (True, False)]
    assert [bool(estimator.refined().motions) for estimator, _ in runs] == [True, False]
    kept, free = (motions for _, motions in runs)
    assert len(kept) == len(free) > 5
    for a, b in zip(kept, free, strict=True):
        assert a.state is b.state
        np.testing.assert_array_equal(a.world_from_body.matrix, b.world_from_body.matrix)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_camera_that_is_mounted_otherwise() -> None:
    """The camera is turned by 20 mrad against the INS: with the mounting as a state, the tilt of the cameras is at most
    0.6 of that with the mounting held."""
    f = PointFlight(seed=6, seconds=10.0, count=60, imu=False, mounting=(0.012, -0.010, 0.012))
    motions = run(f.events, NOISE.model_copy(update={"mounting_sigma": 0.02}))[1]
    held = run(f.events)[1]
    body_from_cam = f.rig.cameras[0].body_from_cam

    def tilt(m: Motion) -> float:
        true = f.truth(m.t_ns) @ body_from_cam
        return float(np.linalg.norm(so3_log(m.world_from_cams[0].rotation @ true.rotation.T)[:2]))

    assert np.mean([tilt(m) for m in motions[-20:]]) < 0.6 * np.mean([tilt(m) for m in held[-20:]])
    assert motions[-1].state is GOOD
