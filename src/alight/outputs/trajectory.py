"""The estimated body poses: TUM text for `evo`, and a table with velocity and 1-sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alight.arrays import F64
from alight.records import Motion

COLUMNS = (
    "t_ns,east_m,north_m,up_m,q_w,q_x,q_y,q_z,v_e,v_n,v_u,"
    "sigma_e,sigma_n,sigma_u,sigma_roll,sigma_pitch,sigma_yaw,state,tracks"
)


def tum_time(t_ns: int) -> str:
    """Seconds with all nine decimals; a float would round them away."""
    sign, t = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{t // 10**9}.{t % 10**9:09d}"


def tum(motions: Sequence[Motion]) -> bytes:
    """One line a pose: t tx ty tz qx qy qz qw; world_from_body, seconds, ENU metres."""
    lines = ["# timestamp[s] tx ty tz[m, ENU] qx qy qz qw (world from body)"]
    for m in motions:
        w, x, y, z = m.world_from_body.quaternion
        e, n, u = m.world_from_body.translation
        lines.append(f"{tum_time(m.t_ns)} {e:.6f} {n:.6f} {u:.6f} {x:.9f} {y:.9f} {z:.9f} {w:.9f}")
    return ("\n".join(lines) + "\n").encode()


def attitude_sigma(m: Motion) -> F64:
    """1-sigma of roll, pitch, yaw, (3,) rad: root diagonal of the attitude's covariance in body axes."""
    R = m.world_from_body.rotation
    return np.sqrt(np.diag(R.T @ m.covariance[3:, 3:] @ R))


def _fields(values: F64 | None, decimals: int) -> list[str]:
    if values is None:
        return [""] * 3
    return [f"{v:.{decimals}f}" if np.isfinite(v) else "" for v in values]


def _row(m: Motion) -> str:
    return ",".join(
        [
            str(m.t_ns),
            *_fields(m.world_from_body.translation, 6),
            *(f"{q:.9f}" for q in m.world_from_body.quaternion),
            *_fields(m.velocity_world, 5),
            *_fields(np.sqrt(np.diag(m.covariance)[:3]), 5),
            *_fields(attitude_sigma(m), 7),
            m.state.name.lower(),
            str(m.tracks),
        ]
    )


def csv(motions: Sequence[Motion]) -> bytes:
    """One row a pose, SI and radians; an empty field is unknown."""
    return ("\n".join([COLUMNS, *map(_row, motions)]) + "\n").encode()
