"""Checks of the pictures (exposure, focus, blur, dirt) and of the intrinsics."""

from __future__ import annotations

import numpy as np

from alight.arrays import F64
from alight.checks.evidence import CameraEvidence, RigEvidence
from alight.checks.picture_quality import Brightness
from alight.checks.result import Check, CheckResult, unknown


def check_exposure(evidence: RigEvidence) -> CheckResult:
    """Check for saturated, black, flat or flickering pictures, and for cameras that differ in brightness."""
    found = Check("exposure")
    for cam, seen in evidence.by_camera:
        if not seen.brightness:
            continue
        light = Brightness(*np.median(np.array(seen.brightness), axis=0))
        flicker = _flicker(np.array([b.mean for b in seen.brightness]))
        found.measured.append(
            f"{cam.name}: mean grey {light.mean:.0f}, contrast {light.contrast:.0f}, {100 * light.saturated:.1f} % "
            f"saturated, {100 * light.black:.1f} % black, flicker {100 * flicker:.1f} %"
        )
        found.judge(
            (light.saturated > 0.15, f"{cam.name} is over-exposed: shorten the exposure or close the aperture"),
            (light.black > 0.4, f"{cam.name} is under-exposed: lengthen the exposure"),
            (light.contrast < 15.0, f"{cam.name} shows hardly any contrast: mend exposure, gain or lens"),
            (flicker > 0.12, f"{cam.name} flickers: fix exposure and gain, or slow their control down"),
        )
    if not found.measured:
        return unknown(found.name, "no picture could be read")
    if ratio := _brightness_ratio(evidence):
        found.measured.append(f"the cameras differ in brightness by {100 * (np.exp(ratio) - 1):.0f} %")
        unlike = ratio > 0.4 and not found.remedies
        found.judge((unlike, "the cameras differ: give both the same exposure and gain"))
    return found.result


def _flicker(means: F64) -> float:
    """Return how much mean greys (N,) flicker; 0 for fewer than five pictures.

    The flicker is the median of |log grey - mean log grey of the pictures before and after|.
    """
    if len(means) < 5:
        return 0.0
    logs = np.log(np.maximum(means, 1.0))
    return float(np.median(np.abs(logs[1:-1] - 0.5 * (logs[2:] + logs[:-2]))))


def _brightness_ratio(evidence: RigEvidence) -> float:
    """Return how much the cameras differ in brightness, as the absolute value of a log ratio; 0 for one camera.

    The ratio of a camera is the median of log(mean grey / mean grey of camera 0) over the exposures of both cameras.
    The largest ratio of all cameras is returned.
    """
    first, *others = [dict(zip(c.seconds, (b.mean for b in c.brightness), strict=True)) for c in evidence.cameras]
    ratios = [[np.log(max(m[t], 1.0) / max(first[t], 1.0)) for t in first if t in m] for m in others]
    return max((abs(float(np.median(r))) for r in ratios if r), default=0.0)


def check_sharpness(evidence: RigEvidence) -> CheckResult:
    """Check focus and motion blur by the width of the sharpest edges; good pictures have 1.8 to 2.8 px."""
    found = Check("sharpness")
    for cam, seen in evidence.by_camera:
        widths = np.array(seen.edges).reshape(-1, 2)
        widths = widths[np.isfinite(widths).all(axis=1)]
        if len(widths) < 3:
            found.incomplete = True
            found.measured.append(f"{cam.name}: too few edges")
            continue
        x, y = np.median(widths, axis=0)
        found.measured.append(f"{cam.name}: sharpest edges {x:.1f} px wide across x, {y:.1f} px across y")
        along, across = _by_motion(seen, x, y)
        smeared = bool(along - across > 2.0 and along > 1.8 * across)
        found.judge(
            (smeared, f"{cam.name} is blurred along its motion: shorten the exposure or fly slower"),
            (
                not smeared and min(x, y) > 4.5,  # px: a blur with a sigma of 1.8 px
                f"{cam.name} is out of focus, or its lens is wet: focus at the flying height and lock it",
            ),
        )
    return found.result


def _by_motion(seen: CameraEvidence, x: float, y: float) -> tuple[float, float]:
    """Return the edge widths along and across the motion, px, given the widths across x and y.

    If the motion is oblique or unknown, `x` is returned for both.
    """
    if len(seen.flows) < 5:
        return x, x
    share = np.median(np.abs([f.shift for f in seen.flows]), axis=0)
    if share.max() < 2.5 * max(share.min(), 0.5):
        return x, x
    return (x, y) if share[0] > share[1] else (y, x)


def check_lens(evidence: RigEvidence) -> CheckResult:
    """Check for dirt on the lens and parts of the aircraft in view, which stand still while the ground moves."""
    found, dirty = Check("lens and view"), False
    for cam, seen in evidence.by_camera:
        pairs = seen.static.pairs
        if pairs < 3:
            found.incomplete = True
            found.measured.append(f"{cam.name}: the ground moved too little ({pairs} pairs of pictures)")
            continue
        spots = seen.static.spots(cam.camera.width, cam.camera.height)
        dirty |= bool(spots)
        listed = "; ".join(spots[:5]) + (f"; and {len(spots) - 5} more" if len(spots) > 5 else "")
        found.measured.append(f"{cam.name}: {listed or 'nothing stands still'} ({pairs} pairs of pictures)")
    mend = "clean the lens and its window, and keep propellers, landing gear and the aircraft's shadow out of view"
    found.judge((dirty, mend))
    return found.result


def check_intrinsics(evidence: RigEvidence) -> CheckResult:
    """Check for intrinsics that no real camera has."""
    found = Check("intrinsics")
    for cam in evidence.rig.cameras:
        lens = cam.camera
        found.measured.append(
            f"{cam.name}: principal point ({lens.cu:.0f}, {lens.cv:.0f}) of {lens.width}x{lens.height}, "
            f"focal length {lens.fu:.0f}, {lens.fv:.0f} px"
        )
        away = max(abs(lens.cu / (lens.width - 1) - 0.5), abs(lens.cv / (lens.height - 1) - 0.5))
        found.judge(
            (away > 0.15, f"{cam.name}: the principal point is far from the middle, calibrate at this image size"),
            (
                abs(lens.fu / lens.fv - 1.0) > 0.05,
                f"{cam.name}: fu and fv differ, calibrate pictures that were not stretched",
            ),
        )
    return found.result
