"""Pose of the camera at the exposure of a row: kernels (eq. 10 in docs/method/bundle.md)."""

from alight.arrays import F64
from alight.compiled import pixelwise
from alight.motion.rotation_kernels import exponential, multiply

HEIGHT, READOUT = 9, 10  # columns of the lens table of the loops (`adjustment_kernels`)


@pixelwise
def row_time(row: float, height: float) -> float:
    """Time of exposure of a pixel row, -0.5 at the first to 0.5 at the last, in readouts from the photo's middle."""
    return (row + 0.5) / height - 0.5


@pixelwise
def quadratic(t: float) -> float:
    """Factor of the quadratic turn of a photo at a time of `row_time`; that of the linear turn is `t`."""
    return t * t - 1.0 / 12.0


@pixelwise
def expose(
    R: F64, C: F64, turns: F64, velocity: F64, readout: float, t: float, turn: F64, row_R: F64, row_C: F64
) -> None:
    """Write the pose of a camera when a row was exposed (eq. 10).

    Args:
        R, C: (3, 3), (3,) world_from_cam in the middle of the photo.
        turns: (2, 3) rad, linear and quadratic in time.
        velocity: (3,) m/s.
        readout: s.
        t: of `row_time`.
        turn: (3, 3) out, from the row's camera to that of the middle.
        row_R, row_C: out, as `R`, `C`.
    """
    q = quadratic(t)
    exponential(
        t * turns[0, 0] + q * turns[1, 0], t * turns[0, 1] + q * turns[1, 1], t * turns[0, 2] + q * turns[1, 2], turn
    )
    multiply(R, turn, row_R)
    for i in range(3):
        row_C[i] = C[i] + velocity[i] * readout * t
