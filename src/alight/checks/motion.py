"""Checks of mounting, time offset and focal length: motion in the pictures against GPS/INS and gyroscope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from alight.checks.evidence import RigEvidence
from alight.checks.navigation import attitude_readings, quarter_turns
from alight.checks.predicted_flow import AT, BodyMotion, FlowFit, PredictedFlow, body_motion
from alight.checks.result import Check, CheckResult, Judged, bad, good, unknown
from alight.checks.stereo import turn_words
from alight.geometry import Pose

OFFSETS = np.arange(-0.5, 0.501, 0.05)  # s, trial time offsets
UNEXPLAINED = 0.35  # share of the flow; if more is unexplained, there is no verdict
TILTED = np.radians(5.0)  # tolerance of a mounting: the attitude of GPS/INS is no better
CHECKS = ("mounting", "time offset", "focal length")


def check_motion(evidence: RigEvidence, blocked: str) -> tuple[list[CheckResult], FlowFit | None]:
    """Compare the flow of all cameras with GPS/INS and gyroscope.

    Args:
        blocked: name of a failed check of GPS/INS or IMU, which prevents any verdict here; empty: all passed.

    Returns:
        the results, and the fit of camera 0; None if there is no verdict on its flow.
    """

    def cannot_tell(why: str, *found: CheckResult) -> tuple[list[CheckResult], None]:
        return [*found, *(unknown(name, why) for name in CHECKS[len(found) :])], None

    if blocked:
        return cannot_tell(f"first mend the {blocked}")
    motion = body_motion(evidence.nav, evidence.imu, int(evidence.frames_ns[0]))
    if motion is None:
        return cannot_tell("neither gyroscope nor attitude of GPS/INS at the time of the pictures")
    seen = {cam.name: PredictedFlow(c, cam.body_from_cam, motion) for cam, c in evidence.by_camera}
    usable = {n: p for n, p in seen.items() if p.pairs >= 8 and np.median(p.flow) > 2.0}  # px
    if not usable:
        most = max(p.pairs for p in seen.values())
        return cannot_tell(f"the pictures hardly move, or show no texture ({most} pairs with flow)")
    mounting = _mounting(usable, motion, evidence)
    if mounting.verdict is Judged.BAD:
        return cannot_tell("first mend the mounting", mounting)
    fits = {name: flow.fit(flow.scan(OFFSETS)[1]) for name, flow in usable.items()}
    left = max(f.unexplained for f in fits.values())
    if left > UNEXPLAINED:
        why = f"{100 * left:.0f} % of the flow is left: the pictures do not show level ground that stands still"
        return cannot_tell(why, mounting)
    results = [_tilt(mounting, fits), _offset(list(fits.values()), motion.turned_by, evidence.ahead), _focal(fits)]
    return results, fits.get(evidence.rig.cameras[0].name)


def _mounting(usable: dict[str, PredictedFlow], motion: BodyMotion, evidence: RigEvidence) -> CheckResult:
    """Check each mounting for a wrong quarter or half turn, by the flow that each of the 24 rotations predicts.

    `usable`: flow by name of the camera; `motion`: motion of the body with which it was predicted.
    """
    if motion.velocity_world is None:
        return unknown(CHECKS[0], "needs velocity and attitude of GPS/INS")
    words, doubt, turned = list[str](), list[str](), list[str]()
    poses = {c.name: c.body_from_cam for c in evidence.rig.cameras}
    for name, flow in usable.items():
        down, size = flow.looks_down() or 0.0, float(np.median(flow.flow))
        own = flow.scan(OFFSETS)[0]
        words.append(f"{name} looks {np.degrees(np.arccos(np.clip(down, -1, 1))):.0f} degrees off straight down, "
                     f"{100 * own / size:.0f} % of its flow of {size:.1f} px is left")  # fmt: skip
        others = []
        for turn in quarter_turns()[1:] if own > 0.25 * size else []:
            other = flow.turned(Pose(poses[name].rotation @ turn, poses[name].translation))
            if (other.looks_down() or 0.0) > 0.17:  # a camera nearer to the horizon sees little ground
                others.append((other.scan(OFFSETS)[0], turn))
        others.sort(key=lambda pair: pair[0])
        if others and others[0][0] < 0.5 * own and others[0][0] < 0.4 * size:
            near = [t for c, t in others if c < 1.3 * others[0][0]]
            turned.append(" or ".join(turn_words(name, t) for t in near))
        elif own > UNEXPLAINED * size:
            doubt.append(name)
    shown = "; ".join(words)
    if turned:
        return bad(CHECKS[0], f"{shown}; {'; '.join(turned)}", "write the true mounting into T_BS of that camera")
    if doubt and (reading := _other_attitude(usable, evidence)):
        return bad(CHECKS[0], f"{shown}; it is right with the attitude of GPS/INS as {reading[0]}", reading[1])
    if doubt:
        return unknown(CHECKS[0], f"{shown}; no quarter turn explains it")
    return good(CHECKS[0], shown)


def _other_attitude(usable: dict[str, PredictedFlow], evidence: RigEvidence) -> tuple[str, str] | None:
    """Return the attitude convention that explains the flow of every camera, and its remedy; None if there is none.

    `usable`: see `_mounting`.
    """
    nav = evidence.nav.measured("world_from_body")
    cameras = {c.name: (e, c.body_from_cam) for c, e in zip(evidence.rig.cameras, evidence.cameras, strict=True)}
    for what, (attitudes, mend) in attitude_readings(nav.world_from_body).items():
        motion = body_motion(replace(nav, world_from_body=attitudes), evidence.imu, int(evidence.frames_ns[0]))
        if motion is None:
            continue
        flows = {n: PredictedFlow(*cameras[n], motion) for n in usable}
        if all(f.pairs and f.scan(OFFSETS)[0] < 0.2 * float(np.median(f.flow)) for f in flows.values()):
            return what, mend
    return None


def _tilt(mounting: CheckResult, fits: dict[str, FlowFit]) -> CheckResult:
    """Check mountings for errors of some degrees; return the new result.

    `mounting`: result of `_mounting`, which is returned if it is not good; `fits`: fit by name of the camera.
    """
    if mounting.verdict is not Judged.GOOD:
        return mounting
    found, vague = Check(mounting.name, [mounting.evidence]), False
    for name, fit in fits.items():
        turn, sigma = fit.parameters[AT.mounting], fit.sigma[AT.mounting]
        pitch, yaw, roll = np.degrees(turn)
        found.measured.append(
            f"{name} fits turned by pitch {pitch:+.1f}, yaw {yaw:+.1f}, roll {roll:+.1f} degrees about its x, y, z "
            f"(1-sigma {np.degrees(sigma.max()):.1f})"
        )
        if (np.abs(turn) > np.maximum(TILTED, 5.0 * sigma)).any():
            found.remedies = ["correct T_BS of the camera by this turn (T_BS times the turn), or calibrate it again"]
        vague |= bool((sigma > TILTED / 2).any())
    if vague and not found.remedies:
        found.measured.append("a few degrees cannot be seen: the aircraft turned too little")
    return found.result


def _offset(fits: list[FlowFit], turned_by: str, ahead: float) -> CheckResult:
    """Check the mean time offset of the cameras from the sensor `turned_by`; `ahead`: offset (s) applied already."""
    name = CHECKS[1]
    offsets, sigmas = np.array([f.parameters[AT.offset] for f in fits]), np.array([f.sigma[AT.offset] for f in fits])
    w = 1.0 / sigmas**2
    offset, sigma = float((w * offsets).sum() / w.sum()), float(max(sigmas.min(), np.ptp(offsets) / 2))
    evidence = (
        f"camera stamps are {1e3 * offset:+.1f} +- {1e3 * sigma:.1f} ms (1-sigma) ahead of the {turned_by}, "
        f"from the flow of {sum(len(f.depth_seconds) for f in fits)} pairs of pictures"
    )
    if sigma > 0.01:  # s
        return unknown(name, f"{evidence}: the aircraft turned too little")
    if abs(offset) > 0.48:
        return unknown(name, f"{evidence}: at the border of what is searched")
    limit = 0.02 if turned_by == "gyroscope" else 0.03  # s
    if abs(offset) > max(limit, 4.0 * sigma):
        mend = f"set motion.filter.time_offset={offset + ahead:.3f}, or stamp the middle of the exposure on one clock"
        return bad(name, evidence, mend)
    return good(name, evidence)


def _focal(fits: dict[str, FlowFit]) -> CheckResult:
    name = CHECKS[2]
    parts = [(camera, f.parameters[AT.focal], f.sigma[AT.focal], f.focal) for camera, f in fits.items()]
    evidence = "; ".join(
        f"{n} {f:.1f} px, the flow gives {100 * s:+.1f} +- {100 * e:.1f} % (1-sigma)" for n, s, e, f in parts
    )
    vague = 0.02  # 1-sigma
    off = [n for n, s, e, _ in parts if e < vague and abs(s) > max(0.045, 4.0 * e)]
    if off:
        return bad(name, evidence, f"calibrate {' and '.join(off)} at the image size and focus of the flight")
    if any(e > vague for _, _, e, _ in parts):
        return unknown(name, f"{evidence}: the aircraft turned too little")
    return good(name, evidence)
