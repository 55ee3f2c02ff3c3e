"""GPS/INS against itself and against the IMU: units, axes, conventions, clocks. No picture is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from alight.arrays import F64
from alight.checks.evidence import ImuTable, NavTable, RigEvidence
from alight.checks.predicted_flow import increasing, integrated, seconds_since
from alight.checks.result import CheckResult, bad, good, unknown

GRAVITY = 9.81  # m/s^2
WINDOW = 0.4  # s over which turns are compared
TURNED = 0.008  # rad RMS in a window: less is noise of the attitude
AGREES = 0.4  # of the turns that may be left where two streams agree
CLEAR = 0.6  # of the turns that must be left where they do not
UPRIGHT = 0.3  # cosine of the largest tilt of an aircraft that flies, in the median
TILT = 0.35  # rad between the mean specific force and up
TRAVEL = 6.0  # m
SCALED = 1.6  # times: positions drift by 0.2 m/s, knots and km/h are 1.94 and 3.6 times
DRIFT = 0.18  # share of the way that positions drift by themselves
STRIDE = 1.0  # s over which positions are compared with the velocity
LAGS = tuple(0.05 * k for k in range(-6, 7))  # s, clocks that are tried where axes are compared
LAG = 0.03  # s by which the clocks may differ
FRD = np.diag([1.0, -1.0, -1.0])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def quarter_turns() -> list[F64]:
    """The 24 rotations that take axes to axes, the identity first."""
    found = [np.asarray(m) for m in Rotation.create_group("O").as_matrix().round() + 0.0]
    return sorted(found, key=lambda m: -float(np.trace(m)))


def named_axes(turn: F64) -> str:
    """Directions of the axes of a quarter turn, in words: x forward, y right, z down."""
    words = (("forward", "back"), ("left", "right"), ("up", "down"))
    parts = []
    for k, axis in enumerate("xyz"):
        row = int(np.argmax(np.abs(turn[:, k])))
        parts.append(f"{axis} {words[row][int(turn[row, k] < 0)]}")
    return ", ".join(parts)


@dataclass(frozen=True, eq=False)
class TurnWindows:
    """Turns of the body in each window, by the IMU and by the attitude of GPS/INS."""

    imu: F64  # (K, 3) rad
    nav: F64  # (K, 3) rad
    summed: F64  # (K, 3) rad: the rates of the IMU added up axis by axis, which no wrong unit can wrap

    def left(self, body_from_imu: F64) -> float:
        """Unexplained share of the turns under an assumption on the axes of the IMU, for the worst axis that turned."""
        off = self.imu @ np.asarray(body_from_imu).T - self.nav
        off, turned = (_sizes(x - np.median(x, axis=0)) for x in (off, self.nav))  # less the bias of the gyroscope
        used = turned > min(TURNED, 0.99 * float(turned.max()))
        return float((off[used] / np.maximum(turned[used], 1e-9)).max())

    @property
    def difference(self) -> float:
        """Unexplained share of the turns with the axes as they are, all axes together."""
        off = self.imu - self.nav
        return _size(off - np.median(off, axis=0)) / max(_size(self.nav - np.median(self.nav, axis=0)), 1e-9)

    @property
    def enough(self) -> bool:
        """True if the aircraft turned enough to compare."""
        return len(self.nav) >= 6 and _size(self.nav - np.median(self.nav, axis=0)) > TURNED


def _size(vectors: F64) -> float:
    """Root of the mean square without the largest twentieth: outliers have no effect."""
    squares = np.sort((vectors**2).sum(axis=1))
    return float(np.sqrt(squares[: max(1, int(0.95 * len(squares)))].mean()))


def _sizes(vectors: F64) -> F64:
    """(3,) `_size` of each axis."""
    return np.array([_size(column[:, None]) for column in vectors.T])


class ImuPath:
    """Orientation and angles integrated from the gyroscope, as functions of time."""

    def __init__(self, imu: ImuTable) -> None:
        at = increasing(imu.t_ns)
        self.origin_ns = int(imu.t_ns[0])
        self._seconds, rates = seconds_since(imu.t_ns[at], self.origin_ns), imu.angular_velocity_body[at]
        self._path = Slerp(self._seconds, integrated(self._seconds, rates))
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(self._seconds)[:, None]
        self._angles = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def turns(self, nav: NavTable, attitudes: F64, lag: float = 0.0) -> TurnWindows:
        """Return the turns in the windows that both streams cover.

        Args:
            attitudes: (N, 3, 3) of the rows of `nav`.
            lag: s that is subtracted from the stamps of GPS/INS.
        """
        t = (nav.t_ns - self.origin_ns) * 1e-9 - lag
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


def least_left(path: ImuPath, nav: NavTable, attitudes: F64, turns: Sequence[F64]) -> F64:
    """Unexplained share of the turns at the best lag of the clocks, for each assumption on the axes of the IMU."""
    tables = [t for lag in LAGS if (t := path.turns(nav, attitudes, lag)).enough]
    return np.array([min((t.left(m) for t in tables), default=0.0) for m in turns])


def with_attitude(nav: NavTable) -> NavTable:
    """The rows that have an attitude, in order of time."""
    known = nav.known("world_from_body")
    return known.where(increasing(known.t_ns))


def reordered(world_from_body: F64) -> F64:
    """(N, 3, 3) attitudes whose quaternions were written x, y, z, w and read as w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(world_from_body).as_quat().T  # as read; SciPy has the real part last
    return np.asarray(Rotation.from_quat(np.stack([w, x, y, z], axis=-1)).as_matrix())


def attitude_readings(world_from_body: F64) -> dict[str, tuple[F64, str]]:
    """The (N, 3, 3) attitudes read by other conventions, by the name of the convention, with the remedy."""
    R = np.asarray(world_from_body)
    convert = "convert the attitude as in docs/your-camera.md (enu_from_flu)"
    return {
        "a quaternion in the order x y z w": (reordered(R), "write q_w first: q_w, q_x, q_y, q_z"),
        "the inverse rotation (body from world)": (np.swapaxes(R, 1, 2), "write the conjugate quaternion"),
        "NED from FRD": (NED @ R @ FRD, convert),
        "ENU from FRD": (R @ FRD, convert),
        "NED from FLU": (NED @ R, convert),
    }


def mean_up(nav: NavTable, imu: ImuTable, attitudes: F64, body_from_imu: F64) -> F64 | None:
    """Mean specific force in the world less the mean acceleration, m/s^2: 9.8 up where all is right."""
    s = (nav.t_ns - nav.t_ns[0]) * 1e-9
    t = (imu.t_ns - nav.t_ns[0]) * 1e-9
    inside = (t >= s[0]) & (t <= s[-1])
    if inside.sum() < 10:
        return None
    R = Slerp(s, Rotation.from_matrix(attitudes))(t[inside])
    mean = R.apply(imu.specific_force_body[inside] @ np.asarray(body_from_imu).T).mean(axis=0)
    v = nav.velocity_world[np.isfinite(nav.velocity_world).all(axis=1)]
    return np.asarray(mean - (v[-1] - v[0]) / (s[-1] - s[0]) if len(v) > 1 else mean)


def is_up(force: F64 | None) -> bool:
    """True if a specific force is about that of gravity and upright."""
    if force is None:
        return True
    size = float(np.linalg.norm(force))
    return size > 1e-3 and float(np.arccos(np.clip(force[2] / size, -1, 1))) < TILT


def check_gyroscope_unit(turns: TurnWindows | None) -> CheckResult:
    """Unit of the gyroscope: its turns against those of the attitude."""
    name = "gyroscope unit"
    if turns is None or not turns.enough:
        return unknown(name, "no IMU with GPS/INS attitude" if turns is None else "the aircraft hardly turned")
    centred = [x - np.median(x, axis=0) for x in (turns.summed, turns.nav)]
    ratio = _size(centred[0]) / _size(centred[1])
    evidence = f"turns are {ratio:.3g} times those of the attitude of GPS/INS ({len(turns.nav)} windows of {WINDOW} s)"
    if 25.0 < ratio < 130.0:
        return bad(name, f"{evidence}: degrees a second", "write the angular velocity of imu0 in rad/s (x 0.01745)")
    if not 0.4 < ratio < 2.5:
        return bad(name, evidence, "write the angular velocity of imu0 in rad/s")
    return good(name, evidence)


def check_accelerometer_unit(imu: ImuTable) -> CheckResult:
    """Unit of the accelerometer: its mean specific force is 9.8 m/s^2, also in flight."""
    name = "accelerometer unit"
    if len(imu.t_ns) < 20:
        return unknown(name, "no IMU")
    size = float(np.linalg.norm(imu.specific_force_body, axis=1).mean())
    evidence = f"mean specific force {size:.2f} m/s^2, gravity is {GRAVITY}"
    if 0.8 < size < 1.25:
        return bad(name, f"{evidence}: unit g", "write the acceleration of imu0 in m/s^2 (x 9.80665)")
    if 800.0 < size < 1250.0:
        return bad(name, f"{evidence}: unit mg", "write the acceleration of imu0 in m/s^2 (x 0.00980665)")
    if not 7.5 < size < 13.0:
        return bad(name, evidence, "write the specific force (with gravity) of imu0 in m/s^2")
    return good(name, evidence)


def check_attitude(nav: NavTable, imu: ImuTable, path: ImuPath | None) -> list[CheckResult]:
    """Axes of the IMU and convention of the attitude, from gravity and from the turns of both."""
    axes, attitude = "IMU axes", "attitude convention"
    if len(nav.t_ns) < 10:
        return [unknown(n, "no attitude of GPS/INS") for n in (axes, attitude)]
    R = nav.world_from_body
    upright = float(np.median(R[:, 2, 2]))
    if path is None:
        evidence = f"cosine of the tilt {upright:.2f} in the median"
        if upright > UPRIGHT:
            return [unknown(axes, "no IMU"), good(attitude, f"{evidence}; there is no IMU to compare with")]
        return [unknown(axes, "no IMU"), bad(attitude, f"{evidence}: upside down", _other_reading(R))]
    return _with_imu(nav, imu, path, upright)


def _other_reading(R: F64) -> str:
    fits = [what for what, (other, _) in attitude_readings(R).items() if np.median(other[:, 2, 2]) > UPRIGHT]
    return "write the attitude ENU from FLU, quaternion w x y z; upright it would be as " + (
        " or ".join(fits) or "none"
    )


def _with_imu(nav: NavTable, imu: ImuTable, path: ImuPath, upright: float) -> list[CheckResult]:
    axes, attitude = "IMU axes", "attitude convention"
    R, eye = nav.world_from_body, np.eye(3)
    turns = path.turns(nav, R)
    force, left = mean_up(nav, imu, R, eye), float(least_left(path, nav, R, [eye])[0])
    evidence = f"cosine of the tilt {upright:.2f}"
    if force is not None:
        evidence += f", mean specific force east north up ({force[0]:.1f}, {force[1]:.1f}, {force[2]:.1f}) m/s^2"
    if turns.enough:
        evidence += f", {100 * left:.0f} % of the turns of the attitude are left after those of the gyroscope"
    same = not turns.enough or left < CLEAR
    if same and is_up(force) and upright > UPRIGHT:
        if not turns.enough:
            return [unknown(axes, f"the aircraft hardly turned; {evidence}"), good(attitude, evidence)]
        return [good(axes, evidence), good(attitude, evidence)]
    readings = [
        (what, mend) for what, (other, mend) in attitude_readings(R).items()
        if np.median(other[:, 2, 2]) > UPRIGHT and _fitting(nav, imu, path, other, [eye])
    ]  # fmt: skip
    mountings = _fitting(nav, imu, path, R, quarter_turns()[1:]) if upright > UPRIGHT else []
    if mountings and (turns.enough or not readings):
        best = mountings[0] if turns.enough else _usual(mountings)
        words = f"the axes of imu0 fit as {named_axes(best)}"
        mend = "write the axes into T_BS of imu0/sensor.yaml, or the samples in x forward, y left, z up"
        return [bad(axes, f"{evidence}; {words}", mend), unknown(attitude, f"first mend the {axes}")]
    if readings:
        what = " or ".join(w for w, _ in readings)
        if turns.enough and least_left(path, nav, R, [FRD])[0] < AGREES:
            what += ", or the gyroscope alone is forward right down"
        return [
            unknown(axes, f"first mend the {attitude}"),
            bad(attitude, f"{evidence}; it fits as {what}", readings[0][1]),
        ]
    mend = (
        "write the attitude ENU from FLU and the samples of imu0 in the axes of the body, or their turn into its T_BS"
    )
    if same and upright > UPRIGHT:
        return [bad(axes, evidence, mend), unknown(attitude, f"first mend the {axes}")]
    return [
        unknown(axes, f"first mend the {attitude}"),
        bad(attitude, f"{evidence}; attitude and IMU do not agree", mend),
    ]


def _usual(mountings: list[F64]) -> F64:
    """Return the most common one of several mountings that fit: forward right down."""
    return next((m for m in mountings if np.allclose(m, FRD)), mountings[0])


def _fitting(nav: NavTable, imu: ImuTable, path: ImuPath, attitudes: F64, turns: Sequence[F64]) -> list[F64]:
    """The assumptions on the axes of the IMU that gravity and the turns allow, the best first."""
    upright = [m for m in turns if is_up(mean_up(nav, imu, attitudes, m))]
    left = least_left(path, nav, attitudes, upright)
    return [upright[k] for k in np.argsort(left, kind="stable") if left[k] < AGREES]


def check_velocity(nav: NavTable) -> CheckResult:
    """Velocity of GPS/INS against the differences of its positions."""
    name = "velocity of GPS/INS"
    known = nav.known("position_world", "velocity_world")
    known = known.where(increasing(known.t_ns))
    if len(known.t_ns) < 5:
        return unknown(name, "no rows with position and velocity")
    s = (known.t_ns - known.t_ns[0]) * 1e-9
    ends = np.searchsorted(s, s + STRIDE - 1e-6)
    begins = np.flatnonzero(ends < len(s))
    ends = ends[begins]
    begins, ends = (x[s[ends] - s[begins] < 1.5 * STRIDE] for x in (begins, ends))
    if len(begins) < 3:
        return unknown(name, "too few rows with position and velocity")
    steps = known.position_world[ends] - known.position_world[begins]
    travel = float(np.median(np.linalg.norm(steps, axis=1))) * (s[-1] - s[0]) / STRIDE
    if travel < TRAVEL:
        return unknown(name, f"the aircraft hardly moved ({travel:.1f} m)")
    v, R = known.velocity_world, known.world_from_body
    readings = {"east north up": v, "north east down": v @ NED.T}
    if np.isfinite(R).all():
        readings |= {
            "forward left up of the body": np.einsum("kij,kj->ki", R, v),
            "forward right down of the body": np.einsum("kij,kj->ki", R, v @ FRD.T),
        }
    found = {what: _explained(s, u, begins, ends, steps) for what, u in readings.items()}
    share, scale = found["east north up"]
    evidence = f"leaves {100 * share:.0f} % of the way between positions {STRIDE:g} s apart, {travel:.0f} m in all"
    best = min(found, key=lambda k: found[k][0])
    if share > DRIFT and found[best][0] < 0.5 * min(share, 0.5):
        return bad(name, f"{evidence}; it fits as {best} ({100 * found[best][0]:.0f} %)", "write v_e, v_n, v_u")
    if share < 0.4:
        return good(name, evidence) if 1 / SCALED < scale < SCALED else _scaled(name, scale, travel)
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


def _explained(s: F64, v: F64, begins: F64, ends: F64, steps: F64) -> tuple[float, float]:
    """Share of the steps that the integral of a velocity does not explain after the best scale, and that scale."""
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(s)[:, None], axis=0)])
    said = way[ends] - way[begins]
    square = (said * steps).sum(axis=1)
    scale = float(np.median((said**2).sum(axis=1)) / max(float(np.median(square)), 1e-9))
    if scale <= 0 or scale > 1e6:
        return 1.0, 1.0
    off = np.linalg.norm(said / scale - steps, axis=1)
    return float(np.median(off) / max(float(np.median(np.linalg.norm(steps, axis=1))), 1e-9)), scale


def check_nav_clock(nav: NavTable, path: ImuPath | None) -> CheckResult:
    """Clock of GPS/INS against that of the IMU: turns of both, shifted in time."""
    name = "clock of GPS/INS against IMU"
    if path is None:
        return unknown(name, "needs an IMU and the attitude of GPS/INS")
    lags = np.arange(-0.5, 0.501, 0.02)
    tables = [path.turns(nav, nav.world_from_body, float(lag)) for lag in lags]
    here = tables[len(tables) // 2]
    if not here.enough:
        return unknown(name, "the aircraft hardly turned")
    costs = np.array([t.difference**2 if t.enough else np.inf for t in tables])
    k = int(np.argmin(costs))
    if not 0 < k < len(lags) - 1 or not np.isfinite(costs[k - 1 : k + 2]).all():
        return unknown(name, "no clear peak within 0.5 s")
    a, b, c = costs[k - 1 : k + 2]
    curve = max((a - 2 * b + c) / 0.02**2, 1e-9)
    lag = float(lags[k] - (c - a) / (2 * 0.02) / curve)
    sigma = float(np.sqrt(2.0 * b / curve / max(len(here.nav) / 2, 1)))
    evidence = f"rows of GPS/INS are {1e3 * lag:+.0f} +- {1e3 * sigma:.0f} ms late (1-sigma)"
    if sigma > LAG / 2 or costs[k] > AGREES**2:
        return unknown(name, f"{evidence}; the turns of both are not alike enough")
    if abs(lag) > LAG + 3 * sigma:
        return bad(name, evidence, f"stamp the rows of GPS/INS with the time of validity ({-1e3 * lag:+.0f} ms)")
    return good(name, evidence)


def check_navigation(evidence: RigEvidence) -> list[CheckResult]:
    """Run all checks of GPS/INS and IMU; a check that needs a wrong stream names the fault to mend first."""
    nav, imu = with_attitude(evidence.nav), evidence.imu
    both = len(nav.t_ns) >= 10 and len(imu.t_ns) >= 20
    path = ImuPath(imu) if both else None
    turns = path.turns(nav, nav.world_from_body) if path else None
    out = [check_velocity(evidence.nav), check_accelerometer_unit(imu), check_gyroscope_unit(turns)]
    unit = next((r for r in out[1:] if r.verdict == "bad"), None)
    names = ("IMU axes", "attitude convention", "clock of GPS/INS against IMU")
    if unit is not None:
        return out + [unknown(n, f"first mend the {unit.name}") for n in names]
    out += check_attitude(nav, imu, path)
    if any(r.verdict == "bad" for r in out[3:]):
        return [*out, unknown(names[2], "first mend the axes")]
    return [*out, check_nav_clock(nav, path)]
