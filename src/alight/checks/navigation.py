"""Checks of GPS/INS against itself and the IMU: units, axes, conventions, clocks. No picture is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from alight.arrays import F64, I64
from alight.checks.evidence import ImuTable, NavTable, RigEvidence, integrated, seconds_since, trimmed_rms
from alight.checks.result import CheckResult, Judged, bad, good, unknown
from alight.geometry.rotations import ENU_FROM_NED, FRD_FROM_FLU

WINDOW = 0.4  # s over which turns are compared
AGREES = 0.4  # largest unexplained share of the turns for two streams that agree
UPRIGHT = 0.3  # cosine of the largest median tilt of a flying aircraft
AXES, ATTITUDE, CLOCK = "IMU axes", "attitude convention", "clock of GPS/INS against IMU"  # names of checks


def quarter_turns() -> list[F64]:
    """Return the 24 rotations that map axes to axes, the identity first."""
    found = [np.asarray(m) for m in Rotation.create_group("O").as_matrix().round() + 0.0]
    return sorted(found, key=lambda m: -float(np.trace(m)))


def named_axes(turn: F64) -> str:
    """Return the directions of the axes of a quarter turn as text, such as "x forward, y right, z down"."""
    words = (("forward", "back"), ("left", "right"), ("up", "down"))
    rows = np.argmax(np.abs(turn), axis=0)
    return ", ".join(
        f"{axis} {words[r][int(turn[r, k] < 0)]}" for k, (axis, r) in enumerate(zip("xyz", rows, strict=True))
    )


@dataclass(frozen=True, eq=False)
class TurnWindows:
    """Turns of the body in K windows, as rotation vectors, by the IMU and by the attitude of GPS/INS."""

    imu: F64  # (K, 3) rad
    nav: F64  # (K, 3) rad
    summed: F64  # (K, 3) rad: sum of the IMU's rates per axis, which cannot wrap whatever the unit

    def unexplained(self, body_from_imu: F64) -> float:
        """Return the share of turns that an IMU with axes `body_from_imu` leaves unexplained, about the worst axis."""
        off, turned = (
            np.array([trimmed_rms(column) for column in _centred(x).T])  # without the bias of the gyroscope
            for x in (self.imu @ np.asarray(body_from_imu).T - self.nav, self.nav)
        )
        used = turned > min(0.008, 0.99 * float(turned.max()))
        return float((off[used] / np.maximum(turned[used], 1e-9)).max())

    @property
    def difference(self) -> float:
        """Share of the turns that the IMU leaves unexplained over all axes, if its axes are as recorded."""
        return trimmed_rms(_centred(self.imu - self.nav)) / max(trimmed_rms(_centred(self.nav)), 1e-9)

    @property
    def enough(self) -> bool:
        """Whether the aircraft turned enough for a comparison; smaller turns are noise of the attitude."""
        return len(self.nav) >= 6 and trimmed_rms(_centred(self.nav)) > 0.008  # rad


def _centred(vectors: F64) -> F64:
    return vectors - np.median(vectors, axis=0)


class NavAndImu:
    """GPS/INS and IMU of the same part of a recording, to test hypotheses about their conventions.

    Args:
        nav: rows with an attitude, in order of time.
    """

    def __init__(self, nav: NavTable, imu: ImuTable) -> None:
        self.nav, self.imu = nav, imu
        ordered = imu.in_order()
        self._seconds, rates = seconds_since(ordered.t_ns, int(imu.t_ns[0])), ordered.angular_velocity_body
        self._path = Slerp(self._seconds, integrated(self._seconds, rates))
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(self._seconds)[:, None]
        self._angles = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def turns(self, attitudes: F64, lag: float = 0.0) -> TurnWindows:
        """Return the turns in the windows that both streams cover.

        Args:
            attitudes: (N, 3, 3) `world_from_body` of the rows of GPS/INS.
            lag: s that is subtracted from the stamps of GPS/INS.
        """
        t = seconds_since(self.nav.t_ns, int(self.imu.t_ns[0])) - lag
        ends = np.searchsorted(t, t + WINDOW - 1e-6)
        begins = np.flatnonzero((ends < len(t)) & (t >= self._seconds[0]))
        begins = begins[:: max(1, int(0.5 * np.median(ends[begins] - begins)))] if len(begins) else begins
        ends = ends[begins]
        keep = (t[ends] <= self._seconds[-1]) & (t[ends] - t[begins] < 1.5 * WINDOW)
        begins, ends = begins[keep], ends[keep]
        if not len(begins):
            return TurnWindows(*(np.empty((0, 3)) for _ in range(3)))
        R, path = Rotation.from_matrix(attitudes), self._path
        summed = [np.interp(t[ends], self._seconds, a) - np.interp(t[begins], self._seconds, a) for a in self._angles.T]
        return TurnWindows(
            (path(t[begins]).inv() * path(t[ends])).as_rotvec(), (R[begins].inv() * R[ends]).as_rotvec(),
            np.stack(summed, axis=-1),
        )  # fmt: skip

    def unexplained(self, attitudes: F64, turns: Sequence[F64]) -> F64:
        """Return the unexplained share of the turns for each `body_from_imu` in `turns`, at the best clock lag.

        `attitudes`: see `turns`.
        """
        lags = (0.05 * k for k in range(-6, 7))  # s
        tables = [t for lag in lags if (t := self.turns(attitudes, lag)).enough]
        return np.array([min((t.unexplained(m) for t in tables), default=0.0) for m in turns])

    def mean_up(self, attitudes: F64, body_from_imu: F64) -> F64 | None:
        """Return mean specific force minus mean acceleration, (3,) m/s^2, ENU: ideally 9.8 up; None if unknown.

        `attitudes`: see `turns`; `body_from_imu`: (3, 3) assumed axes of the IMU.
        """
        origin = int(self.nav.t_ns[0])
        s, t = seconds_since(self.nav.t_ns, origin), seconds_since(self.imu.t_ns, origin)
        inside = (t >= s[0]) & (t <= s[-1])
        if inside.sum() < 10:
            return None
        R = Slerp(s, Rotation.from_matrix(attitudes))(t[inside])
        mean = R.apply(self.imu.specific_force_body[inside] @ np.asarray(body_from_imu).T).mean(axis=0)
        v = self.nav.measured("velocity_world").velocity_world
        return np.asarray(mean - (v[-1] - v[0]) / (s[-1] - s[0]) if len(v) > 1 else mean)

    def is_upright(self, attitudes: F64, body_from_imu: F64) -> bool:
        """Whether the mean specific force points up or is unknown; see `mean_up` for the arguments."""
        force = self.mean_up(attitudes, body_from_imu)
        if force is None:
            return True
        size = float(np.linalg.norm(force))
        return size > 1e-3 and float(np.arccos(np.clip(force[2] / size, -1, 1))) < 0.35  # rad

    def fitting(self, attitudes: F64, turns: Sequence[F64]) -> list[F64]:
        """Return the `body_from_imu` in `turns` that fit gravity and the turns of `attitudes` (N, 3, 3), best first."""
        upright = [m for m in turns if self.is_upright(attitudes, m)]
        left = self.unexplained(attitudes, upright)
        return [upright[k] for k in np.argsort(left, kind="stable") if left[k] < AGREES]


def attitude_readings(world_from_body: F64) -> dict[str, tuple[F64, str]]:
    """Return the attitudes (N, 3, 3) read in each other convention, by its name, with the remedy as text."""
    R = np.asarray(world_from_body)
    x, y, z, w = Rotation.from_matrix(R).as_quat().T  # as read; SciPy has the real part last
    reordered = np.asarray(Rotation.from_quat(np.stack([w, x, y, z], axis=-1)).as_matrix())
    convert = "convert the attitude as in docs/your-data.md (enu_from_flu)"
    return {
        "a quaternion in the order x y z w": (reordered, "write q_w first: q_w, q_x, q_y, q_z"),
        "the inverse rotation (body from world)": (np.swapaxes(R, 1, 2), "write the conjugate quaternion"),
        "NED from FRD": (ENU_FROM_NED @ R @ FRD_FROM_FLU, convert),
        "ENU from FRD": (R @ FRD_FROM_FLU, convert),
        "NED from FLU": (ENU_FROM_NED @ R, convert),
    }


def check_gyroscope_unit(turns: TurnWindows | None) -> CheckResult:
    """Check the unit of the gyroscope by comparing its turns with the turns of the attitude."""
    name = "gyroscope unit"
    if turns is None or not turns.enough:
        return unknown(name, "no IMU with GPS/INS attitude" if turns is None else "the aircraft hardly turned")
    ratio = trimmed_rms(_centred(turns.summed)) / trimmed_rms(_centred(turns.nav))
    evidence = f"turns are {ratio:.3g} times those of the attitude of GPS/INS ({len(turns.nav)} windows of {WINDOW} s)"
    if 25.0 < ratio < 130.0:
        return bad(name, f"{evidence}: degrees a second", "write the angular velocity of imu0 in rad/s (x 0.01745)")
    if not 0.4 < ratio < 2.5:
        return bad(name, evidence, "write the angular velocity of imu0 in rad/s")
    return good(name, evidence)


def check_accelerometer_unit(imu: ImuTable) -> CheckResult:
    """Check the unit of the accelerometer by its mean specific force, which is 9.8 m/s^2 in flight, too."""
    name = "accelerometer unit"
    if len(imu.t_ns) < 20:
        return unknown(name, "no IMU")
    size = float(np.linalg.norm(imu.specific_force_body, axis=1).mean())
    evidence = f"mean specific force {size:.2f} m/s^2, gravity is 9.81"
    for scale, unit, factor in ((1.0, "g", "9.80665"), (1000.0, "mg", "0.00980665")):
        if 0.8 * scale < size < 1.25 * scale:
            mend = f"write the acceleration of imu0 in m/s^2 (x {factor})"
            return bad(name, f"{evidence}: unit {unit}", mend)
    if not 7.5 < size < 13.0:
        return bad(name, evidence, "write the specific force (with gravity) of imu0 in m/s^2")
    return good(name, evidence)


def _axes_wrong(evidence: str, mend: str) -> list[CheckResult]:
    return [bad(AXES, evidence, mend), unknown(ATTITUDE, f"first mend the {AXES}")]


def _attitude_wrong(evidence: str, mend: str) -> list[CheckResult]:
    return [unknown(AXES, f"first mend the {ATTITUDE}"), bad(ATTITUDE, evidence, mend)]


def check_attitude_alone(nav: NavTable) -> list[CheckResult]:
    """Check IMU axes and attitude convention by the attitude alone, if the IMU or the attitude is missing."""
    if len(nav.t_ns) < 10:
        return [unknown(n, "no attitude of GPS/INS") for n in (AXES, ATTITUDE)]
    upright = float(np.median(nav.world_from_body[:, 2, 2]))
    evidence = f"cosine of the tilt {upright:.2f} in the median"
    if upright > UPRIGHT:
        return [unknown(AXES, "no IMU"), good(ATTITUDE, f"{evidence}; there is no IMU to compare with")]
    readings = attitude_readings(nav.world_from_body)
    fits = [what for what, (other, _) in readings.items() if np.median(other[:, 2, 2]) > UPRIGHT]
    mend = "write the attitude ENU from FLU, quaternion w x y z; upright it would be as "
    return [unknown(AXES, "no IMU"), bad(ATTITUDE, f"{evidence}: upside down", mend + (" or ".join(fits) or "none"))]


def check_attitude(streams: NavAndImu) -> list[CheckResult]:
    """Check IMU axes and attitude convention by gravity and by the turns of both streams."""
    R, eye = streams.nav.world_from_body, np.eye(3)
    upright = float(np.median(R[:, 2, 2]))
    turned = streams.turns(R).enough
    force, left = streams.mean_up(R, eye), float(streams.unexplained(R, [eye])[0])
    evidence = f"cosine of the tilt {upright:.2f}"
    if force is not None:
        evidence += f", mean specific force east north up ({force[0]:.1f}, {force[1]:.1f}, {force[2]:.1f}) m/s^2"
    if turned:
        evidence += f", {100 * left:.0f} % of the turns of the attitude are left after those of the gyroscope"
    same = not turned or left < 0.6
    if same and upright > UPRIGHT and streams.is_upright(R, eye):
        axes = good(AXES, evidence) if turned else unknown(AXES, f"the aircraft hardly turned; {evidence}")
        return [axes, good(ATTITUDE, evidence)]
    readings = {
        what: mend for what, (other, mend) in attitude_readings(R).items()
        if np.median(other[:, 2, 2]) > UPRIGHT and streams.fitting(other, [eye])
    }  # fmt: skip
    mountings = streams.fitting(R, quarter_turns()[1:]) if upright > UPRIGHT else []
    if mountings and (turned or not readings):
        usual = [] if turned else [m for m in mountings if np.allclose(m, FRD_FROM_FLU)]  # prefer forward right down
        return _axes_wrong(
            f"{evidence}; the axes of imu0 fit as {named_axes([*usual, *mountings][0])}",
            "write the axes into T_BS of imu0/sensor.yaml, or the samples in x forward, y left, z up",
        )
    if readings:
        what = " or ".join(readings)
        if turned and streams.unexplained(R, [FRD_FROM_FLU])[0] < AGREES:
            what += ", or the gyroscope alone is forward right down"
        return _attitude_wrong(f"{evidence}; it fits as {what}", next(iter(readings.values())))
    mend = (
        "write the attitude ENU from FLU and the samples of imu0 in the axes of the body, or their turn into its T_BS"
    )
    if same and upright > UPRIGHT:
        return _axes_wrong(evidence, mend)
    return _attitude_wrong(f"{evidence}; attitude and IMU do not agree", mend)


def check_velocity(nav: NavTable) -> CheckResult:
    """Check the velocity of GPS/INS against the differences of its positions."""
    name = "velocity of GPS/INS"
    nav = nav.measured("position_world", "velocity_world").in_order()
    if len(nav.t_ns) < 5:
        return unknown(name, "no rows with position and velocity")
    s = seconds_since(nav.t_ns, int(nav.t_ns[0]))
    ends = np.searchsorted(s, s + 1.0 - 1e-6)
    begins = np.flatnonzero(ends < len(s))
    begins = begins[s[ends[begins]] - s[begins] < 1.5]
    ends = ends[begins]
    if len(begins) < 3:
        return unknown(name, "too few rows with position and velocity")
    steps = nav.position_world[ends] - nav.position_world[begins]
    travel = float(np.median(np.linalg.norm(steps, axis=1))) * (s[-1] - s[0])
    if travel < 6.0:
        return unknown(name, f"the aircraft hardly moved ({travel:.1f} m)")
    v, R = nav.velocity_world, nav.world_from_body
    readings = {"east north up": v, "north east down": v @ ENU_FROM_NED.T}
    if np.isfinite(R).all():
        readings["forward left up of the body"] = np.einsum("kij,kj->ki", R, v)
        readings["forward right down of the body"] = np.einsum("kij,kj->ki", R, v @ FRD_FROM_FLU.T)
    found = {what: _explained(s, u, begins, ends, steps) for what, u in readings.items()}
    share, scale = found["east north up"]
    evidence = f"leaves {100 * share:.0f} % of the way between positions 1 s apart, {travel:.0f} m in all"
    best = min(found, key=lambda k: found[k][0])
    if share > 0.18 and found[best][0] < 0.5 * min(share, 0.5):  # positions drift by themselves
        return bad(name, f"{evidence}; it fits as {best} ({100 * found[best][0]:.0f} %)", "write v_e, v_n, v_u")
    if share < 0.4:
        return good(name, evidence) if 1 / 1.6 < scale < 1.6 else _scaled(name, scale, travel)
    if share < 0.7:
        return unknown(name, f"{evidence}; positions and velocity agree only roughly")
    return bad(name, evidence, "write the velocity of the body over ground as v_e, v_n, v_u in m/s")


def _scaled(name: str, scale: float, travel: float) -> CheckResult:
    units = {3.6: "km/h", 1.944: "knots", 100.0: "cm/s", 1000.0: "mm/s", 3.281: "feet a second", 2.237: "mph"}
    near = min(units, key=lambda u: abs(np.log(scale / u)))
    evidence = f"{scale:.2f} times the way between the positions, {travel:.0f} m in all"
    if abs(np.log(scale / near)) < 0.06:
        evidence += f": {units[near]}"
    return bad(name, evidence, "write the velocity in m/s")


def _explained(s: F64, v: F64, begins: I64, ends: I64, steps: F64) -> tuple[float, float]:
    """Return the share of position steps that velocities leave unexplained, and the velocities' scale (1: m/s).

    Args:
        s, v: (N,) s and (N, 3), times and velocities in order of time.
        begins, ends: (K,) indices in `s` at which the steps begin and end.
        steps: (K, 3) metres, from position to position.
    """
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(s)[:, None], axis=0)])
    integral = way[ends] - way[begins]
    square = (integral * steps).sum(axis=1)
    scale = float(np.median((integral**2).sum(axis=1)) / max(float(np.median(square)), 1e-9))
    if scale <= 0 or scale > 1e6:
        return 1.0, 1.0
    off = np.linalg.norm(integral / scale - steps, axis=1)
    return float(np.median(off) / max(float(np.median(np.linalg.norm(steps, axis=1))), 1e-9)), scale


def check_nav_clock(streams: NavAndImu) -> CheckResult:
    """Check the lag between the clocks of GPS/INS and IMU, at which their turns agree best."""
    lags = np.arange(-0.5, 0.501, 0.02)
    tables = [streams.turns(streams.nav.world_from_body, float(lag)) for lag in lags]
    here = tables[len(tables) // 2]
    if not here.enough:
        return unknown(CLOCK, "the aircraft hardly turned")
    costs = np.array([t.difference**2 if t.enough else np.inf for t in tables])
    k = int(np.argmin(costs))
    if not 0 < k < len(lags) - 1 or not np.isfinite(costs[k - 1 : k + 2]).all():
        return unknown(CLOCK, "no clear peak within 0.5 s")
    a, b, c = costs[k - 1 : k + 2]
    curve = max((a - 2 * b + c) / 0.02**2, 1e-9)
    lag = float(lags[k] - (c - a) / (2 * 0.02) / curve)
    sigma = float(np.sqrt(2.0 * b / curve / max(len(here.nav) / 2, 1)))
    evidence = f"rows of GPS/INS are {1e3 * lag:+.0f} +- {1e3 * sigma:.0f} ms late (1-sigma)"
    limit = 0.03  # s by which the clocks may differ
    if sigma > limit / 2 or costs[k] > AGREES**2:
        return unknown(CLOCK, f"{evidence}; the turns of both are not alike enough")
    if abs(lag) > limit + 3 * sigma:
        return bad(CLOCK, evidence, f"stamp the rows of GPS/INS with the time of validity ({-1e3 * lag:+.0f} ms)")
    return good(CLOCK, evidence)


def check_navigation(evidence: RigEvidence) -> list[CheckResult]:
    """Run all checks of GPS/INS and IMU; if one depends on a wrong stream, its result names the fault to mend first."""
    nav, imu = evidence.nav.measured("world_from_body").in_order(), evidence.imu
    streams = NavAndImu(nav, imu) if len(nav.t_ns) >= 10 and len(imu.t_ns) >= 20 else None
    turns = streams.turns(nav.world_from_body) if streams else None
    out = [check_velocity(evidence.nav), check_accelerometer_unit(imu), check_gyroscope_unit(turns)]
    if unit := next((r for r in out[1:] if r.verdict is Judged.BAD), None):
        return out + [unknown(n, f"first mend the {unit.name}") for n in (AXES, ATTITUDE, CLOCK)]
    axes = check_attitude(streams) if streams else check_attitude_alone(nav)
    if any(r.verdict is Judged.BAD for r in axes):
        return [*out, *axes, unknown(CLOCK, "first mend the axes")]
    if streams is None:
        return [*out, *axes, unknown(CLOCK, "needs an IMU and the attitude of GPS/INS")]
    return [*out, *axes, check_nav_clock(streams)]
