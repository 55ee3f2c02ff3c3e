"""Faults of the pictures (exposure, focus, blur, dirt) and of the intrinsics."""

from __future__ import annotations

import numpy as np

from alight.checks.evidence import CameraEvidence, RigEvidence
from alight.checks.result import CheckResult, bad, good, unknown

SATURATED, BLACK = 0.15, 0.4  # share of the pixels, median
FLAT = 15.0  # grey values between the 5th and the 95th percentile
FLICKER = 0.12  # change of the log of the mean grey from one picture to the next, less that of its neighbours
UNLIKE = 0.4  # log of the ratio of the mean grey of two cameras
SOFT = 4.5  # px, width of the sharpest edges: a blur with a sigma of 1.8 px; good pictures have 1.8 to 2.8
SMEAR, SMEAR_RATIO = 2.0, 1.8  # px by which edges along the motion are wider, and ratio of the widths
STATIC_PAIRS = 3
OFF_CENTRE = 0.15  # of the picture's size
SKEWED = 0.05  # share by which fu and fv may differ


def check_exposure(evidence: RigEvidence) -> CheckResult:
    """Check for pictures that are saturated, black, flat, flickering, or unlike between the cameras."""
    name = "exposure"
    words, faults = list[str](), list[str]()
    for cam, seen in zip(evidence.rig.cameras, evidence.cameras, strict=True):
        if not seen.brightness:
            continue
        values = [[b.saturated, b.black, b.contrast, b.mean] for b in seen.brightness]
        saturated, black, contrast, mean = np.median(np.array(values), axis=0)
        flicker = _flicker(np.array([b.mean for b in seen.brightness]))
        words.append(
            f"{cam.name}: mean grey {mean:.0f}, contrast {contrast:.0f}, {100 * saturated:.1f} % saturated, "
            f"{100 * black:.1f} % black, flicker {100 * flicker:.1f} %"
        )
        faults += [f"{cam.name} {what}" for what, wrong in (
            ("is over-exposed: shorten the exposure or close the aperture", saturated > SATURATED),
            ("is under-exposed: lengthen the exposure", black > BLACK),
            ("shows hardly any contrast: mend exposure, gain or lens", contrast < FLAT),
            ("flickers: fix exposure and gain, or slow their control down", flicker > FLICKER),
        ) if wrong]  # fmt: skip
    if not words:
        return unknown(name, "no picture could be read")
    if ratio := _unlike(evidence):
        words.append(f"the cameras differ in brightness by {100 * (np.exp(ratio) - 1):.0f} %")
        if ratio > UNLIKE and not faults:
            faults.append("the cameras differ: give both the same exposure and gain")
    if faults:
        return bad(name, "; ".join(words), "; ".join(faults))
    return good(name, "; ".join(words))


def _flicker(means: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """Median change of brightness that its neighbours do not share."""
    if len(means) < 5:
        return 0.0
    logs = np.log(np.maximum(means, 1.0))
    return float(np.median(np.abs(logs[1:-1] - 0.5 * (logs[2:] + logs[:-2]))))


def _unlike(evidence: RigEvidence) -> float:
    """Largest log ratio of the mean grey of a camera to that of camera 0, median over the exposures."""
    means = [dict(zip(c.seconds, (b.mean for b in c.brightness), strict=True)) for c in evidence.cameras]
    found = []
    for other in means[1:]:
        shared = [t for t in means[0] if t in other]
        if shared:
            ratios = [np.log(max(other[t], 1.0) / max(means[0][t], 1.0)) for t in shared]
            found.append(abs(float(np.median(ratios))))
    return max(found, default=0.0)


def check_sharpness(evidence: RigEvidence) -> CheckResult:
    """Focus and motion blur, from the width of the sharpest edges."""
    name = "sharpness"
    words, faults, blind = list[str](), list[str](), False
    for cam, seen in zip(evidence.rig.cameras, evidence.cameras, strict=True):
        widths = np.array([w for _, w in seen.edges]).reshape(-1, 2)
        widths = widths[np.isfinite(widths).all(axis=1)]
        if len(widths) < 3:
            blind = True
            words.append(f"{cam.name}: too few edges")
            continue
        x, y = np.median(widths, axis=0)
        words.append(f"{cam.name}: sharpest edges {x:.1f} px wide across x, {y:.1f} px across y")
        along, across = _by_motion(seen, x, y)
        if along - across > SMEAR and along > SMEAR_RATIO * across:
            faults.append(f"{cam.name} is blurred along its motion: shorten the exposure or fly slower")
        elif min(x, y) > SOFT:
            faults.append(f"{cam.name} is out of focus, or its lens is wet: focus at the flying height and lock it")
    if faults:
        return bad(name, "; ".join(words), "; ".join(faults))
    return unknown(name, "; ".join(words)) if blind else good(name, "; ".join(words))


def _by_motion(seen: CameraEvidence, x: float, y: float) -> tuple[float, float]:
    """Edge widths along and across the motion of the picture, if it is along an axis; else the same width twice."""
    if len(seen.flows) < 5:
        return x, x
    share = np.median(np.abs([f.shift for f in seen.flows]), axis=0)
    if share.max() < 2.5 * max(share.min(), 0.5):
        return x, x
    return (x, y) if share[0] > share[1] else (y, x)


def check_lens(evidence: RigEvidence) -> CheckResult:
    """Check for dirt on the lens and parts of the aircraft in view, which stand still while the ground moves."""
    name = "lens and view"
    words, found, blind = list[str](), False, False
    for cam, seen in zip(evidence.rig.cameras, evidence.cameras, strict=True):
        if seen.static.pairs < STATIC_PAIRS:
            blind = True
            words.append(f"{cam.name}: the ground moved too little ({seen.static.pairs} pairs of pictures)")
            continue
        spots = [s.words(cam.camera.width, cam.camera.height) for s in seen.static.spots()]
        found |= bool(spots)
        listed = "; ".join(spots[:5]) + (f"; and {len(spots) - 5} more" if len(spots) > 5 else "")
        words.append(f"{cam.name}: {listed or 'nothing stands still'} ({seen.static.pairs} pairs of pictures)")
    if found:
        mend = "clean the lens and its window, and keep propellers, landing gear and the aircraft's shadow out of view"
        return bad(name, "; ".join(words), mend)
    return unknown(name, "; ".join(words)) if blind else good(name, "; ".join(words))


def check_intrinsics(evidence: RigEvidence) -> CheckResult:
    """Check for intrinsics that no camera has."""
    name = "intrinsics"
    words, faults = list[str](), list[str]()
    for cam in evidence.rig.cameras:
        lens = cam.camera
        words.append(f"{cam.name}: principal point ({lens.cu:.0f}, {lens.cv:.0f}) of {lens.width}x{lens.height}, "
                     f"focal length {lens.fu:.0f}, {lens.fv:.0f} px")  # fmt: skip
        away = max(abs(lens.cu / (lens.width - 1) - 0.5), abs(lens.cv / (lens.height - 1) - 0.5))
        if away > OFF_CENTRE:
            faults.append(f"{cam.name}: the principal point is far from the middle, calibrate at this image size")
        if abs(lens.fu / lens.fv - 1.0) > SKEWED:
            faults.append(f"{cam.name}: fu and fv differ, calibrate pictures that were not stretched")
    return bad(name, "; ".join(words), "; ".join(faults)) if faults else good(name, "; ".join(words))
