"""Kernels that eliminate the points of an adjustment, and compute their steps. Equations: docs/method/bundle.md.

Shapes: see `adjustment_kernels`. A block W between a point and other unknowns is stored transposed, (3, p).
"""

import numpy as np

from alight.arrays import F64, I64
from alight.compiled import kernel, pixelwise
from alight.motion.point_kernels import invert


@pixelwise
def _times_root(W: F64, root: F64, out: F64) -> None:
    """Write root' W to `out` (3, p), for a block W (3, p) and a point's upper triangular covariance root (3, 3)."""
    for a in range(W.shape[1]):
        out[0, a] = W[0, a] * root[0, 0]
        out[1, a] = W[0, a] * root[0, 1] + W[1, a] * root[1, 1]
        out[2, a] = W[0, a] * root[0, 2] + W[1, a] * root[1, 2] + W[2, a] * root[2, 2]


@pixelwise
def _subtract_product(G: F64, H: F64, at: int, to: int, width: int, S: F64) -> None:
    """Subtract G'H from the block of S that begins at row `at` and column `to`; G is (3, p), H is (3, `width`)."""
    for a in range(G.shape[1]):
        u, v, w = G[0, a], G[1, a], G[2, a]
        for b in range(width):
            S[at + a, to + b] -= u * H[0, b] + v * H[1, b] + w * H[2, b]


@pixelwise
def _subtract_photos(G: F64, H: F64, at: int, to: int, S: F64) -> None:
    """Call `_subtract_product` for H (3, 6) or (3, 12); a constant width lets the compiler make it a third faster."""
    if H.shape[1] == 12:
        _subtract_product(G, H, at, to, 12, S)
    else:
        _subtract_product(G, H, at, to, 6, S)


@pixelwise
def _subtract_times(G: F64, z: F64, at: int, rhs: F64) -> None:
    """Subtract G'z from the part of `rhs` that begins at index `at`; G is (3, p), z is (3,)."""
    for a in range(G.shape[1]):
        rhs[at + a] -= G[0, a] * z[0] + G[1, a] * z[1] + G[2, a] * z[2]


@kernel
def eliminate(
    starts: I64, photo: I64, coupling: F64, lens_coupling: F64, information: F64, gradient: F64,
    damping: float, regular: float, lenses: int, G: F64, S: F64, rhs: F64, inverse: F64,
) -> None:  # fmt: skip
    """Subtract the eliminated points from the normal equations of all other unknowns, lower triangle of S (eq. 8).

    Args:
        starts: (m + 1,) index of the first observation of each point, then N.
        photo: (N,) photo indices.
        coupling, lens_coupling, information, gradient: output of `linearise`.
        damping: share of the diagonal of a point's block that is added to it (Levenberg-Marquardt).
        regular: constant added to that diagonal.
        lenses: index of the first lens parameter in S.
        G: (longest, 3, e) scratch; `longest` is the greatest number of observations of a point.
        S, rhs: (p, p), (p,) normal equations, photos first; changed in place.
        inverse: (m, 3, 3) out: covariance of the points if the poses were exact.
    """
    each = coupling.shape[2]
    V, root, z, L = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, lens_coupling.shape[2]))
    for k in range(len(starts) - 1):
        for j in range(3):
            for h in range(3):
                V[j, h] = information[k, j, h]
            V[j, j] += damping * V[j, j] + regular
        invert(V, regular, root, inverse[k])
        for j in range(3):
            z[j] = root[0, j] * gradient[k, 0] + root[1, j] * gradient[k, 1] + root[2, j] * gradient[k, 2]
        _times_root(lens_coupling[k], root, L)
        _subtract_product(L, L, lenses, lenses, L.shape[1], S)
        _subtract_times(L, z, lenses, rhs)
        for n in range(starts[k], starts[k + 1]):
            own, at = G[n - starts[k]], each * photo[n]
            _times_root(coupling[n], root, own)
            for before in range(starts[k], n + 1):
                _subtract_photos(own, G[before - starts[k]], at, each * photo[before], S)
            _subtract_photos(L, own, lenses, at, S)
            _subtract_times(own, z, at, rhs)


@kernel
def move_points(
    starts: I64, photo: I64, coupling: F64, lens_coupling: F64, gradient: F64, inverse: F64, pose: F64, lens: F64,
    out: F64,
) -> None:  # fmt: skip
    """Write the steps `out` (m, 3) of the points that follow from the steps `pose` (n, e) and `lens` (k,) (eq. 7)."""
    g = np.empty(3)
    for k in range(len(starts) - 1):
        for j in range(3):
            g[j] = gradient[k, j]
            for f in range(len(lens)):
                g[j] -= lens_coupling[k, j, f] * lens[f]
            for n in range(starts[k], starts[k + 1]):
                for a in range(pose.shape[1]):
                    g[j] -= coupling[n, j, a] * pose[photo[n], a]
        for j in range(3):
            out[k, j] = inverse[k, j, 0] * g[0] + inverse[k, j, 1] * g[1] + inverse[k, j, 2] * g[2]
