"""The numeric streams of a flight log: `nav0`, `imu0` and the truth, from rows to samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import LocalFrame, Pose, matrix_from_quaternion
from alight.records import ImuSample, NavSample
from alight.sources.source import FAR, Findings, Trajectory
from alight.sources.tables import read_numbers

# no aircraft moves or turns like that; a sigma this small makes a matrix singular, one this large has no information
HIGHEST, FASTEST, QUICKEST, STRONGEST = 100_000.0, 3_000.0, 200.0, 5_000.0  # m, m/s, rad/s, m/s^2
SIGMAS = (1e-6, 1e6)  # of whatever unit; 0 is "not known"
NAV_COLUMNS, IMU_COLUMNS, TRUTH_COLUMNS = (23,), (7,), (17, 8)  # 8: truth without velocity and biases


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of one stream that can be used."""

    t_ns: I64  # (N,)
    values: F64  # (N, columns - 1), NaN = not measured


def _read(root: Path, stream: str, columns: tuple[int, ...], findings: Findings) -> tuple[Table, list[int]] | None:
    path = root / stream / "data.csv"
    if path.exists() and not path.is_file():
        findings.say(f"{stream}/data.csv is no plain file and is not read; give a file")
    if not path.is_file():
        return None
    t, values, lines = read_numbers(path, columns, f"{stream} rows", findings)
    return Table(t, values), lines


def _without(table: Table, lines: list[int], bad: dict[int, str], stream: str, findings: Findings) -> Table | None:
    """The rows that are not bad; the others are noted with their line. None when no row is left."""
    for i, why in sorted(bad.items()):
        findings.lose(f"{stream} rows", f"line {lines[i]}", why)
    keep = np.setdiff1d(np.arange(len(lines)), list(bad)).astype(np.intp)
    return Table(table.t_ns[keep], table.values[keep]) if len(keep) else None


def read_nav(root: Path, findings: Findings) -> Table | None:
    """Rows of `nav0`; None when there is none that can be used."""
    found = _read(root, "nav0", NAV_COLUMNS, findings)
    return None if found is None else usable_nav(*found, findings)


def usable_nav(table: Table, lines: list[int], findings: Findings) -> Table | None:
    """The rows of `nav0` that can be used; None when there is none."""
    v = table.values
    with np.errstate(over="ignore", invalid="ignore"):
        checks = {
            "latitude or longitude is no place on Earth": (np.abs(v[:, 0]) > 90) | (np.abs(v[:, 1]) > 360),
            "the quaternion is not of unit length": np.abs(np.linalg.norm(v[:, 3:7], axis=1) - 1) > 0.05,
            "the height is none of an aircraft": np.abs(v[:, 2]) > HIGHEST,
            "the velocity is none of an aircraft": (np.abs(v[:, 7:10]) > FASTEST).any(axis=1),
            "the angular rate is none of an aircraft": (np.abs(v[:, 10:13]) > QUICKEST).any(axis=1),
            "a sigma is negative": (v[:, 13:22] < 0).any(axis=1),
            f"a sigma is not between {SIGMAS[0]:g} and {SIGMAS[1]:g}": (
                (v[:, 13:22] > 0) & ((v[:, 13:22] < SIGMAS[0]) | (v[:, 13:22] > SIGMAS[1]))
            ).any(axis=1),
        }
    bad = {int(i): why for why, mask in checks.items() for i in np.flatnonzero(mask)}
    return _without(table, lines, bad, "nav0", findings)


def without_height(nav: Table) -> int:
    """Rows of `nav0` in which only the height is missing of a position."""
    known = np.isfinite(nav.values[:, :3])
    return int((known[:, 0] & known[:, 1] & ~known[:, 2]).sum())


def read_imu(root: Path, body_from_imu: Pose, findings: Findings) -> Table | None:
    """Rows of `imu0` turned into the body's axes; None when there is none that can be used."""
    found = _read(root, "imu0", IMU_COLUMNS, findings)
    return None if found is None else usable_imu(*found, body_from_imu, findings)


def usable_imu(table: Table, lines: list[int], body_from_imu: Pose, findings: Findings) -> Table | None:
    """The rows of `imu0` that can be used, turned into the body's axes; None when there is none."""
    holes = np.flatnonzero(~np.isfinite(table.values).all(axis=1))
    with np.errstate(invalid="ignore"):
        rates, forces = (np.abs(table.values[:, a:b]).max(axis=1) for a, b in ((0, 3), (3, 6)))
    bad = {
        int(i): "no turn or acceleration of an aircraft"
        for i in np.flatnonzero((rates > QUICKEST) | (forces > STRONGEST))
    }
    bad |= {int(i): "a field is empty" for i in holes}
    used = _without(table, lines, bad, "imu0", findings)
    if used is None:
        return None
    R = body_from_imu.rotation
    return Table(used.t_ns, np.concatenate([used.values[:, :3] @ R.T, used.values[:, 3:] @ R.T], axis=1))


def median_force(imu: Table) -> float:
    """Median specific force of all rows of `imu0`, m/s^2: about gravity."""
    return float(np.median(np.linalg.norm(imu.values[:, 3:], axis=1)))


def read_trajectory(root: Path, findings: Findings) -> Trajectory | None:
    """True body poses in the world; None when the log has none."""
    stream = "state_groundtruth_estimate0"
    if (found := _read(root, stream, TRUTH_COLUMNS, findings)) is None:
        return None
    v = found[0].values[:, :7]
    with np.errstate(over="ignore", invalid="ignore"):
        bent = ~(np.abs(np.linalg.norm(v[:, 3:7], axis=1) - 1) < 0.05) | ~(np.abs(v[:, :3]) < FAR).all(axis=1)
    bad = {int(i): "no position or no unit quaternion" for i in np.flatnonzero(bent)}
    table = _without(*found, bad, stream, findings)
    if table is None:
        return None
    return table.t_ns, [Pose.from_quaternion(row[3:7], row[:3]) for row in table.values]


def _measured(values: F64) -> F64 | None:
    return values.copy() if np.isfinite(values).all() else None


def _sigma(values: F64) -> F64 | None:
    return values.copy() if np.isfinite(values).all() and (values > 0).all() else None


def nav_samples(table: Table, local: LocalFrame) -> Iterator[NavSample]:
    """Samples of `nav0` in the world about `local`."""
    v = table.values
    position = local.to_enu(v[:, 0], v[:, 1], v[:, 2])
    for i, t in enumerate(table.t_ns):
        q = _measured(v[i, 3:7])
        yield NavSample(
            int(t),
            _measured(position[i]),
            None if q is None else matrix_from_quaternion(q),
            _measured(v[i, 7:10]),
            _measured(v[i, 10:13]),
            _sigma(v[i, 13:16]),
            _sigma(v[i, 16:19]),
            _sigma(v[i, 19:22]),
        )


def imu_samples(table: Table) -> Iterator[ImuSample]:
    """Samples of `imu0`."""
    for t, row in zip(table.t_ns, table.values, strict=True):
        yield ImuSample(int(t), row[:3].copy(), row[3:].copy())
