"""Read trajectories in TUM format: `t x y z qx qy qz qw`, in seconds and metres."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np

from alight.documents import DocumentError, read_bytes
from alight.geometry import LocalFrame, Pose
from alight.records import InputError
from alight.sources.source import LARGEST, Trajectory

HINT = "each line needs: seconds x y z qx qy qz qw"


def _line(text: str) -> tuple[int, Pose]:
    stamp, *rest = text.replace(",", " ").split()
    # decimal, because float64 seconds since 1970 resolve only 240 ns, and poses are looked up by their exact time
    t_ns = int((Decimal(stamp) * 1_000_000_000).to_integral_value())
    x, y, z, qx, qy, qz, qw = (float(v) for v in rest)
    if not np.isfinite([x, y, z]).all() or abs(t_ns) >= 2**63:
        raise ValueError("a number out of range")
    return t_ns, Pose.from_quaternion([qw, qx, qy, qz], [x, y, z])


def read_tum(path: Path, local: LocalFrame) -> Trajectory:
    """Read body poses in the world (ENU around `local`), with times to the nanosecond.

    Raises:
        InputError: the file is missing or has no pose, a line is malformed, the times do not rise, or the positions are
            not local (UTM, ECEF).
    """
    try:
        lines = read_bytes(path, 1_000_000_000).decode("utf-8-sig", errors="replace").splitlines()
    except OSError as e:
        raise InputError(f"{path}: cannot be read ({e.strerror}); --poses takes a file in TUM format") from e
    except DocumentError as e:
        raise InputError(f"{path}: {e}; --poses takes a file in TUM format") from e
    times: list[int] = []
    poses: list[Pose] = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            t, pose = _line(line)
        except (ValueError, ArithmeticError) as e:
            raise InputError(f"{path}, line {number}: no pose; {HINT}") from e
        if np.abs(pose.translation).max() > LARGEST["position_world"]:
            origin = f"latitude {local.latitude:g}, longitude {local.longitude:g}"
            raise InputError(
                f"{path}, line {number}: far from everything; write east, north, up in metres from {origin}"
            )
        if times and t <= times[-1]:
            raise InputError(f"{path}, line {number}: time does not rise; put the lines in order of time")
        times.append(t)
        poses.append(pose)
    if not poses:
        raise InputError(f"{path}: no pose in it; {HINT}")
    return np.array(times, dtype=np.int64), poses
