"""Flow of the picture predicted from gyroscope and GPS/INS, compared with the observed flow.

A point of the picture with the inverse depth rho moves between two exposures by

    x1 ~ R (x0 - rho w(x0) t),     w(x0) = (n . x0) / (n . z)

R is the rotation of the camera (gyroscope), t its translation (velocity of GPS/INS), and n the normal of the ground.
rho is free for each pair of exposures and not negative. The residual flow depends on errors of the time offset, the
mounting and the focal length. These errors affect many pairs in the same manner, whereas rho affects only one.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from alight.arrays import F64
from alight.checks.evidence import CameraEvidence, ImuTable, NavTable, integrated, seconds_since
from alight.checks.features import grid_of, moved
from alight.geometry import Pose
from alight.spread import robust_sigma

STEEP = 0.3  # limit of n . z: a camera whose axis is nearer to the horizon sees no level ground
FREE_BIAS = 0.03  # rad/s, 1-sigma of the bias if there is no attitude to estimate it
# parameters of a fit: time offset s, mounting rad, log of the focal length, bias rad/s, slope of the ground
OFFSET, MOUNTING, FOCAL, BIAS, GROUND = 0, slice(1, 4), 4, slice(5, 8), slice(8, 10)
_PRIORS = np.array([0.3, 0.5, 0.5, 0.5, 0.3, FREE_BIAS, FREE_BIAS, FREE_BIAS, 0.12, 0.12])  # 1-sigma
_STEPS = np.array([2e-3, *[1e-3] * 9])


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Motion of the body as functions of time, in s on the clock of GPS/INS and IMU."""

    turning: Slerp  # orientation; only its differences are used
    turned_by: str  # name of the sensor of `turning`
    attitude: Slerp | None  # world_from_body
    seconds: F64  # (N,) times of the velocity
    velocity_world: F64 | None  # (N, 3) m/s
    origin_ns: int
    span: tuple[float, float]  # s, in which all of the motion is known
    bias: F64  # (3,) rad/s of `turning`, estimated against the attitude
    bias_sigma: float  # rad/s

    def inside(self, seconds: F64) -> F64:
        """Clip times (s) to `span`."""
        return np.clip(seconds, *self.span)


def body_motion(nav: NavTable, imu: ImuTable, origin_ns: int) -> BodyMotion | None:
    """Return the motion by gyroscope and GPS/INS, in s from `origin_ns`; None: gyroscope and attitude are missing."""
    known, inertial = nav.measured("world_from_body").in_order(), imu.in_order()
    t, s = (seconds_since(table.t_ns, origin_ns) for table in (known, inertial))
    attitude = Slerp(t, Rotation.from_matrix(known.world_from_body)) if len(t) > 2 else None
    if len(s) > 20:
        turning, by = Slerp(s, integrated(s, inertial.angular_velocity_body)), "gyroscope"
    elif attitude is not None:
        s, turning, by = t, attitude, "attitude of GPS/INS"
    else:
        return None
    span = (float(s[0]), float(s[-1]))
    bias, sigma = _bias(turning, attitude, s, t) if attitude is not None else (np.zeros(3), FREE_BIAS)
    motion = BodyMotion(turning, by, attitude, s, None, origin_ns, span, bias, sigma)
    moving = nav.measured("velocity_world")
    if len(moving.t_ns) < 3 or attitude is None:
        return motion
    v = seconds_since(moving.t_ns, origin_ns)
    span = max(span[0], v[0], t[0]), min(span[1], v[-1], t[-1])
    return replace(motion, seconds=v, velocity_world=moving.velocity_world, span=span)


def _bias(turning: Slerp, attitude: Slerp, s: F64, t: F64) -> tuple[F64, float]:
    """Return the gyro bias, (3,) rad/s, and its sigma, from the turns by both sensors in windows of one second.

    Args:
        turning, attitude: orientations by the gyroscope and by GPS/INS, as functions of time.
        s, t: times, s, of the samples of `turning` and of `attitude`.
    """
    begin = np.arange(max(s[0], t[0]), min(s[-1], t[-1]) - 1.0, 0.5)
    if len(begin) < 4:
        return np.zeros(3), FREE_BIAS
    one, two = ((f(begin).inv() * f(begin + 1.0)).as_rotvec() for f in (turning, attitude))
    off = one - two
    bias = np.median(off, axis=0)
    spread = robust_sigma(off - bias)
    return bias, float(np.clip(spread / np.sqrt(len(begin) / 2), 1.5e-3, FREE_BIAS))


@dataclass(frozen=True, eq=False)
class FlowFit:
    """Mounting, clock and lens of one camera, estimated from its flow."""

    parameters: F64  # (10,) see `OFFSET`
    sigma: F64  # (10,)
    unexplained: float  # share of the flow that is left with these parameters
    depth_seconds: F64  # (K,) s from `origin_ns`, middle of each pair of exposures
    inverse_depth: F64  # (K,) 1/m along the optical axis, with mounting and focal length as calibrated
    normals: F64  # (K, 3) of the ground in the camera frame; NaN: unknown
    origin_ns: int
    focal: float  # px, as calibrated

    @property
    def depth_error(self) -> float:
        """Relative 1-sigma (0.01 is 1 %) of the scale of all inverse depths, caused by the focal length's error."""
        return float(self.sigma[FOCAL])


class PredictedFlow:
    """Observed and predicted flow of one camera.

    Args:
        camera: measurements from the camera's pictures.
        body_from_cam: mounting of the camera.
        motion: motion of the body.
    """

    def __init__(self, camera: CameraEvidence, body_from_cam: Pose, motion: BodyMotion) -> None:
        self._motion, self._mounting, self.focal = motion, body_from_cam, camera.lens.fu
        self._spots = grid_of(camera.lens)
        flows = [f for f in camera.flows if f.share > 0.4]
        self._begin = np.array([(f.begin_ns - motion.origin_ns) * 1e-9 for f in flows])
        self._end = np.array([(f.end_ns - motion.origin_ns) * 1e-9 for f in flows])
        self._seen = moved(np.array([f.homography for f in flows]).reshape(-1, 3, 3), self._spots[None])
        keep = (self._begin >= motion.span[0]) & (self._end <= motion.span[1])
        self._begin, self._end, self._seen = self._begin[keep], self._end[keep], self._seen[keep]
        self.pairs = len(self._begin)
        self._centre, self._priors = np.zeros(10), _PRIORS.copy()
        self._centre[BIAS], self._priors[BIAS] = motion.bias, motion.bias_sigma
        self.flow = self.focal * np.linalg.norm(self._seen - self._spots, axis=-1).mean(axis=-1)  # (K,) px

    def turned(self, mounting: Pose) -> PredictedFlow:
        """Return a copy with another mounting, `body_from_cam`."""
        out = copy(self)
        out._mounting = mounting
        return out

    def looks_down(self) -> float | None:
        """Return the median downward part of the optical axis (1: down, 0: level); None: no attitude or no flow."""
        if self._motion.attitude is None or not self.pairs:
            return None
        down = -self._motion.attitude(self._motion.inside(self._begin)).as_matrix()[:, 2, :]
        return float(np.median(down @ self._mounting.rotation[:, 2]))

    def residuals(self, parameters: F64) -> tuple[F64, F64]:
        """Return the (K, 18) px of unexplained flow, and (K,) inverse depths, for parameters (10,) (see `OFFSET`)."""
        m = self._motion
        offset, focal = parameters[OFFSET], np.exp(parameters[FOCAL])
        body_from_cam = self._mounting.rotation @ Rotation.from_rotvec(parameters[MOUNTING]).as_matrix()
        t0, t1 = m.inside(self._begin - offset), m.inside(self._end - offset)
        span = np.maximum(t1 - t0, 1e-3)[:, None]
        turn = m.turning(t0).inv() * m.turning(t1) * Rotation.from_rotvec(-parameters[BIAS] * span)
        cam_from_later = body_from_cam.T @ turn.as_matrix() @ body_from_cam  # (K, 3, 3)
        x0 = np.concatenate([self._spots / focal, np.ones((len(self._spots), 1))], axis=1)  # (9, 3)
        x1 = np.concatenate([self._seen / focal, np.ones_like(self._seen[..., :1])], axis=-1)
        y = x1 @ np.swapaxes(cam_from_later, 1, 2)
        y = y[..., :2] / np.maximum(y[..., 2:], 1e-3)
        off = y - x0[None, :, :2]  # (K, 9, 2): flow that rotation does not explain
        arms = self._arms(y, x0, t0, t1, body_from_cam, parameters[GROUND])
        left, depth = _least_squares(off, arms)
        return left.reshape(len(left), -1) * self.focal * focal, depth

    def _arms(self, y: F64, x0: F64, t0: F64, t1: F64, body_from_cam: F64, slope: F64) -> F64:
        """Return the flow (K, 9, 2, P) per unit of inverse depth (P = 1) or, without velocity, of translation (P = 3).

        Args:
            y: (K, 9, 2) observed points of the later pictures, turned into the axes of the earlier ones.
            x0: (9, 3) rays of the points in the earlier pictures.
            t0, t1: (K,) s, times of both pictures of each pair, on the clock of the motion.
            body_from_cam: (3, 3) rotation.
            slope: (2,) slope of the ground; see `upward`.
        """
        m = self._motion
        if m.velocity_world is None or m.attitude is None:
            free = np.zeros((len(y), x0.shape[0], 2, 3))
            free[..., 0, 0] = free[..., 1, 1] = 1.0
            free[..., 2] = -y
            return free
        middle = 0.5 * (t0 + t1)
        v = np.stack([np.interp(middle, m.seconds, m.velocity_world[:, k]) for k in range(3)], axis=-1)
        world_from_cam = m.attitude(m.inside(middle)).as_matrix() @ body_from_cam
        way = np.einsum("kij,ki->kj", world_from_cam, v) * (t1 - t0)[:, None]
        turn = (m.turning(t0).inv() * m.turning(t1)).as_matrix() - np.eye(3)
        way = way + (turn @ self._mounting.translation) @ body_from_cam
        normal = np.einsum("kij,i->kj", world_from_cam, upward(slope))  # (K, 3) of the ground in the camera frame
        slant = normal[:, 2:]
        ratio = (normal @ x0.T) / np.where(np.abs(slant) < 1e-6, 1e-6, slant)
        weight = np.where(-slant > STEEP, np.clip(ratio, 0.0, 3.0), 1.0)
        flow = -weight[..., None] * (way[:, None, :2] - y * way[:, None, 2:])
        return np.asarray(flow[..., None])

    def _normals(self, parameters: F64) -> F64:
        """Return the (K, 3) normals of the ground, camera frame, in the middle of each pair; NaN without attitude."""
        m = self._motion
        if m.attitude is None:
            return np.full((self.pairs, 3), np.nan)
        middle = m.inside(0.5 * (self._begin + self._end) - parameters[OFFSET])
        world_from_cam = m.attitude(middle).as_matrix() @ self._mounting.rotation
        return np.asarray(np.einsum("kij,i->kj", world_from_cam, upward(parameters[GROUND])))

    def cost(self, parameters: F64) -> float:
        """Return the median of the pairs' unexplained flow, px, for parameters (10,)."""
        return float(np.median(_length(self.residuals(parameters)[0])))

    def scan(self, offsets: F64) -> tuple[float, float]:
        """Return the least cost [px] over time offsets [s], and the offset of that cost."""
        costs = []
        for offset in offsets:
            p = self._centre.copy()
            p[OFFSET] = offset
            costs.append(self.cost(p))
        k = int(np.argmin(costs))
        return costs[k], float(offsets[k])

    def fit(self, start: float) -> FlowFit:
        """Refine all parameters together by Gauss-Newton with robust weights, starting from a time offset (s)."""
        p = self._centre.copy()
        p[OFFSET] = start
        for _ in range(8):
            r, A, g, _ = self._normal(p)
            step = np.clip(np.linalg.solve(A, g), -0.2, 0.2)
            p = p - step
            if np.abs(step).max() < 1e-4:
                break
        r, A, g, scores = self._normal(p)
        inverse = np.linalg.inv(A)
        blocks = np.array_split(scores, min(10, len(scores)))  # the spread of their results gives the sigma
        G = np.array([b.sum(axis=0) for b in blocks])
        spread = inverse @ (G.T @ G) @ inverse
        sigma = np.sqrt(np.maximum(np.diag(spread), np.diag(inverse)))
        calibrated = self._centre.copy()
        calibrated[OFFSET], calibrated[GROUND] = p[OFFSET], p[GROUND]
        depth = self.residuals(calibrated)[1]
        unexplained = float(np.median(_length(r))) / max(float(np.median(self.flow)), 1e-6)
        middle = 0.5 * (self._begin + self._end)
        normals = self._normals(calibrated)
        return FlowFit(p, sigma, unexplained, middle, depth, normals, self._motion.origin_ns, self.focal)

    def _normal(self, p: F64) -> tuple[F64, F64, F64, F64]:
        """Return residuals (K, 18), normal matrix (10, 10), gradient (10,), and gradient per pair (K, 10) at `p` (10,).

        Matrix and gradient include the priors; the gradients per pair do not.
        """
        r, _ = self.residuals(p)
        J = np.stack([(self.residuals(p + e)[0] - self.residuals(p - e)[0]) / (2 * s)
                      for e, s in zip(np.diag(_STEPS), _STEPS, strict=True)], axis=-1)  # (K, 18, 10)  # fmt: skip
        length = _length(r)
        scale = max(float(np.median(length)), 0.15)  # px
        w = 1.0 / (scale**2 * (1.0 + (length / (2.0 * scale)) ** 2) ** 2)
        w = w / 4.0  # nine flows of one homography are not eighteen measurements
        A = np.einsum("k,kri,krj->ij", w, J, J) + np.diag(1.0 / self._priors**2)
        scores = np.einsum("k,kri,kr->ki", w, J, r)
        return r, A, scores.sum(axis=0) + (p - self._centre) * [0.0, *(1.0 / self._priors[1:] ** 2)], scores


def upward(slope: F64) -> F64:
    """Return the (3,) upward normal of ground with a slope (2,), rise per metre to the east and to the north."""
    return np.asarray(np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope))


def _length(residuals: F64) -> F64:
    """Return the (K,) RMS flow per point of each pair, px, from residuals (K, 18)."""
    return np.asarray(np.sqrt((residuals**2).sum(axis=1) / (residuals.shape[1] / 2)))


def _least_squares(off: F64, arms: F64) -> tuple[F64, F64]:
    """Fit flow `off` (K, 9, 2) by P free factors of `arms` (K, 9, 2, P) per pair.

    Return the residual (K, 9, 2), and the inverse depth (K,): the factor if P = 1, NaN if P = 3.
    """
    if arms.shape[-1] == 1:
        a = arms[..., 0]
        depth = np.maximum((a * off).sum(axis=(1, 2)) / np.maximum((a * a).sum(axis=(1, 2)), 1e-12), 0.0)
        return off - depth[:, None, None] * a, depth
    A = arms.reshape(len(arms), -1, arms.shape[-1])
    b = off.reshape(len(off), -1)
    free = np.linalg.solve(
        np.einsum("kri,krj->kij", A, A) + 1e-9 * np.eye(A.shape[-1]), np.einsum("kri,kr->ki", A, b)[..., None]
    )
    return off - (A @ free)[..., 0].reshape(off.shape), np.full(len(off), np.nan)
