"""Estimation of the offset between the clocks of pictures and of a vehicle's log, however large it is.

The observed motion of the picture is compared with the motion predicted from the log, at every offset with an overlap:

    u_k ~ w(t_k - offset) + rho m(t_k - offset)

u_k is the flow of a pair of pictures [1/s]. w is its part from the rotation (gyroscope), and m its part from the
velocity at a height of one metre. rho, one over the height above ground, is free in each `WINDOW` and not negative.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from alight.arrays import F64, I64
from alight.checks.evidence import CameraEvidence, ImuTable, NavTable
from alight.checks.features import grid_of, moved
from alight.checks.predicted_flow import OFFSET, BodyMotion, PredictedFlow, body_motion, upward
from alight.geometry import Pose
from alight.records import Event, Frame, ImuSample, NavSample, Rig

STEP = 0.05  # s between two trial offsets
WINDOW = 4.0  # s in which the height above ground stays nearly the same
LOBE = 1.0  # s: offsets nearer to the best one are no rivals, because the motion of a vehicle changes slowly
PART = 300  # number of flows that are searched together: half a minute or more
CLEAR = 0.7  # an offset is clear if its misfit is below this share of the best rival's misfit and of the whole motion


@dataclass(frozen=True)
class ClockOffset:
    """Time by which the stamps of the pictures are ahead of the stamps of the log."""

    seconds: float
    sigma: float  # s, 1-sigma
    unclear: str = ""  # reason why the offset must not be used; empty: it is clear


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Motion of a picture, predicted from a log, at time steps of `STEP`; NaN where it is unknown.

    D numbers describe the motion, such as the flows at some points of the picture.
    """

    start: float  # s, time of the first step
    turning: F64  # (N, D) 1/s, the part that does not depend on the height above ground
    moving: F64  # (N, D) m/s, the part that is divided by the height above ground


def align(seconds: F64, seen: F64, predicted: PredictedMotion) -> ClockOffset:
    """Find the offset at which a predicted motion best explains an observed one, among all offsets with an overlap.

    Args:
        seconds: (K,) s, ascending times of the observed motion, on the pictures' clock.
        seen: (K, D) observed motion, 1/s.
        predicted: motion predicted from a log.

    Returns:
        the offset of the pictures' clock from the prediction's clock.
    """
    observed = _Observed(seconds, seen)
    found = clearest(*observed.misfits(predicted))
    return found if found.unclear else observed.refined(found.seconds, predicted)


class _Observed:
    """An observed motion, (K, D) at (K,) s, divided into windows of constant height above ground."""

    def __init__(self, seconds: F64, seen: F64) -> None:
        self._seconds, self._seen = seconds, seen
        self._windows = np.flatnonzero(np.diff(seconds // WINDOW, prepend=-np.inf))
        self._lengths = np.diff([*self._windows, len(seconds)])

    def misfits(self, predicted: PredictedMotion) -> tuple[F64, F64]:
        """Return the (T,) ascending offsets with an overlap [s], and the (T,) unexplained share of the motion at each.

        Motion at times without a prediction is unexplained.
        """
        at = np.round((self._seconds - self._seconds[0]) / STEP).astype(np.intp)
        first = np.arange(len(predicted.turning) - 1, -at[-1] - 1, -1)  # index at which the first observation falls
        left = [np.linalg.norm(self._left(predicted, at + k), axis=1).sum() for k in first]
        whole = max(float(np.linalg.norm(self._seen, axis=1).sum()), 1e-12)
        return self._seconds[0] - predicted.start - first * STEP, np.array(left) / whole

    def refined(self, offset: float, predicted: PredictedMotion) -> ClockOffset:
        """Refine an offset (s) by robust Gauss-Newton; its sigma follows from the scatter between the windows."""
        for _ in range(10):
            r, later, earlier = (self._interpolated(offset + d, predicted) for d in (0.0, STEP / 2, -STEP / 2))
            J, length = (later - earlier) / STEP, np.linalg.norm(r, axis=1)
            weight = (1.0 + (length / max(2.0 * float(np.median(length)), 1e-9)) ** 2) ** -2
            score, A = weight * (J * r).sum(axis=1), float((weight * (J * J).sum(axis=1)).sum())
            step = float(np.clip(-score.sum() / max(A, 1e-12), -STEP, STEP))
            offset += step
            if abs(step) < 1e-5:
                break
        spread = max(float((s**2).sum()) for s in (score, np.add.reduceat(score, self._windows)))
        sigma = np.sqrt(spread) / max(A, 1e-12)
        vague = f"it is uncertain by {sigma:.3f} s: the motion changes too little" if sigma > STEP / 2 else ""
        return ClockOffset(offset, float(sigma), vague)

    def _interpolated(self, offset: float, predicted: PredictedMotion) -> F64:
        """Return the (K, D) motion that remains unexplained at an offset (s), interpolated between the steps."""
        at = (self._seconds - offset - predicted.start) / STEP
        index = np.floor(at).astype(np.intp).clip(0, len(predicted.turning) - 2)
        return self._left(predicted, index, (at - index)[:, None].clip(0.0, 1.0))

    def _left(self, predicted: PredictedMotion, index: I64, share: F64 | float = 0.0) -> F64:
        """Return the (K, D) motion that the prediction leaves unexplained at steps `index` (K,) + `share` (K, 1)."""
        inside = (index >= 0) & (index < len(predicted.turning))
        index = np.where(inside, index, 0)
        turning, moving = predicted.turning[index], predicted.moving[index]
        if not np.isscalar(share):
            turning, moving = (a + share * (p[index + 1] - a)
                               for a, p in ((turning, predicted.turning), (moving, predicted.moving)))  # fmt: skip
        inside &= np.isfinite(turning[:, 0]) & np.isfinite(moving[:, 0])
        off = np.where(inside[:, None], self._seen - turning, self._seen)
        arm = np.where(inside[:, None], moving, 0.0)
        size = np.maximum(np.add.reduceat((arm * arm).sum(axis=1), self._windows), 1e-12)
        rho = np.maximum(np.add.reduceat((off * arm).sum(axis=1), self._windows) / size, 0.0)
        return np.asarray(off - np.repeat(rho, self._lengths)[:, None] * arm)


def clearest(offsets: F64, left: F64) -> ClockOffset:
    """Return the one of `offsets` (T,), s, with the least unexplained share `left` (T,), and whether it is clear."""
    best = int(np.argmin(left))
    found, unclear = float(offsets[best]), ""
    others = np.where(np.abs(offsets - found) > LOBE, left, np.inf)
    rival = int(np.argmin(others))
    if left[best] > CLEAR:
        unclear = f"the best one leaves {100 * left[best]:.0f} % of the pictures' motion unexplained"
    elif left[best] > CLEAR * others[rival]:
        unclear = f"another one, {offsets[rival] - found:+.1f} s away, explains the pictures' motion nearly as well"
    return ClockOffset(found, STEP, unclear)


def predicted_motion(motion: BodyMotion, body_from_cam: Pose, spots: F64, span: float) -> PredictedMotion:
    """Predict the flow at points of a picture from gyroscope and GPS/INS.

    Args:
        spots: (S, 2) normalised coordinates of the points.
        span: s between the two pictures of a pair.
    """
    t = np.arange(motion.span[0] + span / 2, motion.span[1] - span / 2, STEP)
    begin, end = (motion.turning(motion.inside(t + half)) for half in (-span / 2, span / 2))
    rate = (begin.inv() * end).as_rotvec() / span - motion.bias
    w = rate @ body_from_cam.rotation  # (N, 3) of the camera, in camera axes
    x = np.concatenate([spots, np.ones((len(spots), 1))], axis=1)
    away = -np.cross(w[:, None, :], x[None])  # (N, S, 3) rate of each ray
    turning = away[..., :2] - spots * away[..., 2:]
    moving = np.full_like(turning, 0.0)
    if motion.velocity_world is not None and motion.attitude is not None:
        world_from_cam = motion.attitude(motion.inside(t)).as_matrix() @ body_from_cam.rotation
        v_world = np.stack([np.interp(t, motion.seconds, motion.velocity_world[:, k]) for k in range(3)], axis=-1)
        v = np.einsum("nij,ni->nj", world_from_cam, v_world)
        below = -np.einsum("nij,i->nj", world_from_cam, upward(np.zeros(2))) @ x.T  # (N, S) height per depth
        moving = np.clip(below, 0.0, None)[..., None] * (spots * v[:, None, 2:] - v[:, None, :2])
    return PredictedMotion(float(t[0]), turning.reshape(len(t), -1), moving.reshape(len(t), -1))


def offset_of_frames(rig: Rig, frames: Iterable[Frame], nav: NavTable, imu: ImuTable) -> ClockOffset:
    """Find the offset between the clocks of the frames and of GPS/INS and IMU, from the first usable part.

    Args:
        frames: exposures in order of time; camera 0 is used.
        nav: all rows of GPS/INS.
        imu: all inertial samples; may be empty.
    """
    camera, mounting = CameraEvidence(rig.cameras[0].camera), rig.cameras[0].body_from_cam
    found = ClockOffset(0.0, np.inf, "the pictures show no motion")
    for frame in frames:
        if frame.images[0] is None:
            continue
        camera.add(frame.t_ns, np.asarray(frame.images[0]), 0.0)
        if len(camera.flows) == PART:
            found = find_offset(camera, mounting, nav, imu)
            if not found.unclear:
                return found
            del camera.flows[: PART // 2]
    return find_offset(camera, mounting, nav, imu) if len(camera.flows) > PART // 2 or found.sigma == np.inf else found


def contradicted_shift(rig: Rig, events: Iterable[Event], shift: float, seconds: float = 20.0) -> str:
    """Return a warning if the pictures contradict the calibrated clock offset of camera 0; empty if they do not.

    Args:
        events: events of a recording with all streams; its first `seconds` are read.
        shift: `timeshift_cam_imu` in s, already applied to the stamps.
    """
    camera, nav, imu = CameraEvidence(rig.cameras[0].camera), list[NavSample](), list[ImuSample]()
    first = None
    for event in events:
        if isinstance(event, NavSample):
            nav.append(event)
        elif isinstance(event, ImuSample):
            imu.append(event)
        else:
            first = event.t_ns if first is None else first
            if event.t_ns - first > seconds * 1e9:
                break
            if event.images[0] is not None:
                camera.add(event.t_ns, np.asarray(event.images[0]), 0.0)
    left = find_offset(camera, rig.cameras[0].body_from_cam, NavTable.of(nav), ImuTable.of(imu))
    if left.unclear or abs(left.seconds) < max(0.02, 4.0 * left.sigma):  # s, the limits of the time offset of a rig
        return ""
    return (
        f"timeshift_cam_imu of cam0 is {shift:+.4f} s, but its pictures and the other streams give "
        f"{shift - left.seconds:+.4f} +- {left.sigma:.4f} s; calibrate again, or set "
        f"motion.filter.time_offset={left.seconds - shift:.4f}"
    )


def find_offset(camera: CameraEvidence, body_from_cam: Pose, nav: NavTable, imu: ImuTable) -> ClockOffset:
    """Find the offset between the clocks of a camera and of GPS/INS and IMU.

    Args:
        camera: measurements from the camera's pictures, stamped by its own clock.
        body_from_cam: mounting of the camera.
        nav: all rows of GPS/INS.
        imu: all inertial samples; may be empty.
    """
    flows = [f for f in camera.flows if f.share > 0.4]
    origin = int(imu.t_ns[0] if len(imu.t_ns) else nav.t_ns[0]) if len(imu.t_ns) + len(nav.t_ns) else 0
    motion = body_motion(nav, imu, origin)
    if motion is None or motion.span[1] - motion.span[0] < LOBE:
        return ClockOffset(0.0, np.inf, "the log has no motion for a second on end")
    if len(flows) < 8:
        return ClockOffset(0.0, np.inf, "the pictures show no motion")
    begin, end = (np.array([getattr(f, name) for f in flows], np.int64) for name in ("begin_ns", "end_ns"))
    spots, span = grid_of(camera.lens), 1e-9 * (end - begin)
    seen = (moved(np.array([f.homography for f in flows]), spots[None]) - spots) / span[:, None, None]
    middle = 0.5e-9 * ((begin - begin[0]) + (end - begin[0]))
    predicted = predicted_motion(motion, body_from_cam, spots, float(np.median(span)))
    found = align(middle, seen.reshape(len(flows), -1), predicted)
    shift = round(1e9 * found.seconds) + int(begin[0]) - origin
    if found.unclear:
        return replace(found, seconds=1e-9 * shift)
    near = [replace(f, begin_ns=f.begin_ns - shift, end_ns=f.end_ns - shift) for f in flows]
    fit = PredictedFlow(replace(camera, flows=near), body_from_cam, motion).fit(0.0)  # exact, but blind to the speed
    left, sigma = float(fit.parameters[OFFSET]), float(fit.sigma[OFFSET])
    if sigma > STEP / 2 or abs(left) > STEP:
        left, sigma = 0.0, found.sigma
    return ClockOffset(1e-9 * shift + left, sigma)
