"""Checks of two cameras against their calibration: epipolar residuals, sign of the depth, and depth against the flow.

The matches are made without the calibration. Otherwise a wrong calibration could hide by leaving no matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from alight.arrays import F64, I64
from alight.checks.evidence import trimmed_rms
from alight.checks.features import LEAST_MATCHES, on_one_geometry
from alight.checks.navigation import quarter_turns
from alight.checks.predicted_flow import STEEP, FlowFit
from alight.checks.result import CheckResult, bad, good, unknown
from alight.geometry import Camera, Pose, skew, so3_exp
from alight.records import RigCamera
from alight.spread import nmad
from alight.tracks import inverse_depth

RESIDUAL = 1.0  # px, largest RMS distance from the epipolar line in a good rig
DISPARITY = 2.5  # px; below it the sign of the depth is not significant

EXCHANGE = "exchange the folders cam0 and cam1 (or the cables); the calibrations stay"


@dataclass(frozen=True, eq=False)
class CameraPair:
    """Matches of two cameras as normalised coordinates."""

    first: F64  # (N, 2)
    other: F64  # (N, 2)
    focal: float  # px

    @classmethod
    def of_pixels(cls, first: Camera, other: Camera, a: F64, b: F64) -> CameraPair:
        """Return a pair from matched pixels (N, 2), `a` in the first camera and `b` in the other."""
        return cls(first.rays(a)[:, :2], other.rays(b)[:, :2], first.fu)

    def residuals(self, other_from_first: Pose) -> F64:
        """Return (N,) signed distances from the epipolar line, px, averaged over both pictures (Sampson)."""
        E = skew(other_from_first.translation) @ other_from_first.rotation
        a, b = (np.hstack([x, np.ones((len(x), 1))]) for x in (self.first, self.other))
        lines, back = a @ E.T, b @ E
        size = np.sqrt(0.5 * ((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)))
        return np.asarray((lines * b).sum(axis=1) / np.maximum(size, 1e-12) * self.focal)

    def depths(self, other_from_first: Pose) -> tuple[F64, F64]:
        """Return the inverse depth [1/m] and the disparity [px] of each match, both (N,)."""
        rho, arm = inverse_depth(self.first, self.other, other_from_first)
        return rho, rho * arm * self.focal


@dataclass(frozen=True, eq=False)
class StereoCase:
    """Two cameras with their matches, without outliers."""

    name: str
    first: RigCamera
    other: RigCamera
    exposures: int  # number of matched exposures
    t_ns: I64  # (N,) of the exposure of each match
    pixels: tuple[F64, F64]  # (N, 2) in both cameras
    pair: CameraPair

    @property
    def as_is(self) -> Pose:
        """`other_from_first` as calibrated."""
        return self.other.body_from_cam.inverse @ self.first.body_from_cam


def check_stereo(
    first: RigCamera, other: RigCamera, found: Sequence[tuple[int, F64, F64]], flow: FlowFit | None
) -> CheckResult:
    """Check one pair of cameras: calibration, order and baseline.

    Args:
        found: matches of each exposure: its time in ns, pixels in the first camera, pixels in the other camera.
        flow: fit of the flow of camera 0 with GPS/INS, to check the depth; None: unknown.
    """
    name = f"stereo {first.name} {other.name}"
    a, b = (np.concatenate([np.empty((0, 2)), *(matches[k] for matches in found)]) for k in (1, 2))
    if len(a) < LEAST_MATCHES:
        return unknown(name, f"{len(a)} matches in {len(found)} pairs of pictures, needs {LEAST_MATCHES}")
    pair = CameraPair.of_pixels(first.camera, other.camera, a, b)
    rigid = on_one_geometry(pair.first, pair.other, pair.focal)
    if rigid.sum() < max(LEAST_MATCHES, 0.3 * len(rigid)):
        return unknown(name, f"only {rigid.sum()} of {len(rigid)} matches follow one geometry")
    t_ns = np.repeat([t for t, *_ in found], [len(pixels) for _, pixels, _ in found])
    pair = CameraPair(pair.first[rigid], pair.other[rigid], pair.focal)
    case = StereoCase(name, first, other, len(found), t_ns[rigid], (a[rigid], b[rigid]), pair)
    if np.linalg.norm(case.as_is.translation) < 1e-3:
        return unknown(name, "the calibration gives both cameras one place")
    return _judged(case, flow)


def _judged(case: StereoCase, flow: FlowFit | None) -> CheckResult:
    off = case.pair.residuals(case.as_is)
    own = trimmed_rms(off)
    evidence = (
        f"{len(off)} matches in {case.exposures} pairs, epipolar residual {np.median(np.abs(off)):.2f} px in the "
        f"median, {own:.2f} px RMS"
    )
    exchanged = CameraPair.of_pixels(case.other.camera, case.first.camera, *case.pixels)
    swapped, front = trimmed_rms(exchanged.residuals(case.as_is.inverse)), exchanged.depths(case.as_is.inverse)[0] > 0
    rho, disparity = case.pair.depths(case.as_is)
    behind, shift = float((rho < 0).mean()), float(np.median(np.abs(disparity)))
    if own > 5.0 and (turned := _quarter_turn(case)):
        return bad(case.name, f"{evidence}; {turned}", "write the true mounting into T_BS of that camera")
    if swapped < RESIDUAL < 0.4 * own and front.mean() > 0.7:
        return bad(case.name, f"{evidence}; with the cameras exchanged it is {swapped:.2f} px", EXCHANGE)
    if behind > 0.7 and shift > DISPARITY:
        evidence += (
            f", {100 * behind:.0f} % of the depths are negative (disparity {shift:.1f} px); "
            f"with the cameras exchanged the residual is {swapped:.2f} px"
        )
        return _reversed(case.name, evidence, own, swapped)
    if own > RESIDUAL or (own > 0.6 and fitted_turn(case.pair, case.as_is, False)[1] < 0.4 * own):
        return _stale(case, evidence, own)
    if flow is None or not len(flow.inverse_depth) or not np.isfinite(flow.inverse_depth).all():
        if shift < DISPARITY:
            why = f"{evidence}; disparity {shift:.1f} px: too far away to tell the sign of the baseline"
            return unknown(case.name, why)
        return good(case.name, f"{evidence}, {100 * (1 - behind):.0f} % of the depths are positive")
    return _of_depth(case, evidence, flow)


def _reversed(name: str, evidence: str, own: float, swapped: float) -> CheckResult:
    """Return the result for negative depths; `evidence`: measurements so far, as text.

    `own`, `swapped`: epipolar residuals, px RMS, as calibrated and with the cameras exchanged.
    """
    sign = "turn the sign of the translation in T_BS of the cameras (baseline)"
    if swapped < 0.7 * own and own > 0.25:
        return bad(name, f"{evidence}: the cameras are exchanged", EXCHANGE)
    if own < 0.7 * swapped and swapped > 0.25:
        return bad(name, f"{evidence}: the baseline has the wrong sign", sign)
    return bad(name, f"{evidence}: cameras exchanged or baseline of the wrong sign", f"{EXCHANGE}; or {sign}")


def _quarter_turn(case: StereoCase) -> str:
    """Describe a quarter or half turn of a camera that explains the matches; empty if there is none."""
    found = []
    for k, cam in enumerate((case.first, case.other)):
        for m in quarter_turns()[1:]:
            mountings = [case.first.body_from_cam, case.other.body_from_cam]
            mountings[k] = Pose(mountings[k].rotation @ m, mountings[k].translation)
            pose = mountings[1].inverse @ mountings[0]
            if (case.pair.depths(pose)[0] > 0).mean() > 0.7:
                found.append((trimmed_rms(case.pair.residuals(pose)), turn_words(cam.name, m)))
    least = min((r for r, _ in found), default=np.inf)
    return " or ".join(words for r, words in found if r < min(1.5 * least + 0.2, 3.0))


def turn_words(camera: str, turn: F64) -> str:
    """Describe the turn `calibrated_from_true` of a camera, a quarter or half turn, as text."""
    vector = Rotation.from_matrix(turn).as_rotvec()
    angle = float(np.degrees(np.linalg.norm(vector)))
    axis = vector / max(float(np.linalg.norm(vector)), 1e-9)
    k = int(np.argmax(np.abs(axis)))
    what = ("the x axis of its picture", "the y axis of its picture", "its optical axis")[k]
    if abs(axis[k]) < 0.99:
        what = f"the axis ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}) of the camera"
    return f"{camera} is turned by {np.sign(axis[k]) * angle:.0f} degrees about {what}"


def fitted_turn(pair: CameraPair, as_is: Pose, lens: bool) -> tuple[F64, float]:
    """Fit corrections (4,) of the other camera: turn about its own axes [rad] and log of its focal length.

    A turn that moves the points along their epipolar lines is hardly observable; a weak prior constrains it.

    Args:
        as_is: calibrated pose `other_from_first`.
        lens: whether the focal length is free; otherwise its correction is 0.

    Returns:
        the corrections from the calibrated camera to the true one, and the residual after them, px RMS.
    """

    def residuals(p: F64) -> F64:
        moved = CameraPair(pair.first, pair.other * np.exp(-p[3]), pair.focal)
        return moved.residuals(Pose(so3_exp(-p[:3])) @ as_is)

    def cost(p: F64) -> F64:
        full = p if lens else np.append(p, 0.0)
        return np.concatenate([residuals(full), full * 1.5 * np.sqrt(len(pair.first))])

    found = least_squares(cost, np.zeros(4 if lens else 3), loss="soft_l1", f_scale=1.0, x_scale=0.01).x
    best = found if lens else np.append(found, 0.0)
    return best, trimmed_rms(residuals(best))


def _stale(case: StereoCase, evidence: str, own: float) -> CheckResult:
    again = "calibrate both cameras again (stereo calibration, focus of the flight)"
    left = own
    for lens in (False, True):
        best, left = fitted_turn(case.pair, case.as_is, lens)
        pitch, yaw, roll = 1e3 * best[:3]
        words = f"pitch {pitch:+.1f}, yaw {yaw:+.1f}, roll {roll:+.1f} mrad about its x, y, z"
        if lens:
            words += f" and a focal length {100 * best[3]:+.1f} % against the first one's"
        if left < max(min(0.5, 0.5 * own), 0.15 * own) and np.abs(best).max() < 0.12:
            mend = again if lens else f"turn T_BS of the second camera by this (T_BS times the turn), or {again}"
            return bad(case.name, f"{evidence}; the second camera turned by {words} leaves {left:.2f} px", mend)
    words = f"turning the second camera and its focal length leave {left:.2f} px: lens or base"
    return bad(case.name, f"{evidence}; {words}", again)


def _of_depth(case: StereoCase, evidence: str, flow: FlowFit) -> CheckResult:
    """Check the stereo depths against the depths of flow and GPS/INS; call it only if the epipolar lines are right.

    `evidence`: measurements so far, as text.
    """
    rho, disparity = case.pair.depths(case.as_is)
    seconds = (case.t_ns - flow.origin_ns) * 1e-9
    times, at = np.unique(seconds, return_inverse=True)
    normals = np.stack([np.interp(seconds, flow.depth_seconds, n) for n in flow.normals.T], axis=-1)
    ratio = (normals[:, :2] * case.pair.first).sum(axis=1) / normals[:, 2] + 1.0  # depth on the axis over depth
    level = (ratio > 0.4) & (ratio < 2.5) & (normals[:, 2] < -STEEP)
    if level.sum() < LEAST_MATCHES or len(np.unique(at[level])) < len(times):
        return good(case.name, f"{evidence}, {100 * (rho > 0).mean():.0f} % of the depths are positive")
    stereo = np.array([np.median((rho / ratio)[level & (at == k)]) for k in range(len(times))])
    arm = np.array([np.median((disparity / rho)[level & (at == k)]) for k in range(len(times))])  # px m
    expected = np.interp(times, flow.depth_seconds, _smooth(flow.inverse_depth))
    error = (stereo - expected) * arm
    off, sigma = float(np.median(error)), nmad(error) / np.sqrt(max(len(error) - 1, 1))
    expected_px = float(np.median(expected * arm))
    evidence += f", disparity {expected_px + off:.2f} px where flow and GPS/INS give {expected_px:.2f} px"
    share = 0.25 / float(np.median(-normals[:, 2])) ** 2  # relief has more effect in an oblique view
    limit = max(1.0, share * abs(expected_px), 4.0 * sigma, 4.0 * abs(expected_px) * flow.depth_error)
    if len(error) < 4 or abs(off) < limit:
        return good(case.name, evidence)
    base = float(np.linalg.norm(case.as_is.translation))
    words = (
        f"the cameras are turned towards each other by {1e3 * off / case.pair.focal:+.1f} mrad against the calibration"
    )
    if expected_px > 0.5 and expected_px + off > 0:
        words += f", or the base is {base * (expected_px + off) / expected_px:.3f} m instead of {base:.3f} m"
    mend = "measure the base; if it is right, calibrate the turn between the cameras again"
    return bad(case.name, f"{evidence}: {words}", mend)


def _smooth(values: F64) -> F64:
    padded = np.pad(values, 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1))
