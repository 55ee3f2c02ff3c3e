"""Rolling shutter: the rows of a photo are exposed one after the other, and the camera moves on meanwhile.

Over the readout a camera moves by its velocity times the readout and turns by a small angle. The readout is one number
of each camera, the turn six of each photo (eqs. 10 and 11 in docs/method/bundle.md). Cheap drones read a picture in
20 to 160 ms: 0.2 to 2 m of flight.
"""

from __future__ import annotations

import numpy as np

from alight.arrays import F64, I64

LONGEST = 60.0  # s, most between two photos that give the velocity of one of them
SAME_WAY = 0.8  # least cosine between the ways from the photo before and to the next, where both count
LEAST_WAY = 1.0  # m, least between them
FASTEST = 60.0  # m/s; a faster way comes from a wrong tag


def velocities(centres: F64, seconds: F64, camera: I64) -> F64:
    """Velocity (n, 3) m/s at every photo, from places and times of the photos before and after it; 0 where not known.

    Of two ways in different directions, at the end of a strip, the faster one counts: turns take time.

    Args:
        centres: (n, 3) metres.
        seconds: (n,) time of each photo; NaN: not known.
        camera: (n,) number of the camera of each: photos of one camera are compared.
    """
    out = np.zeros_like(centres)
    for one in np.unique(camera):
        who = np.flatnonzero((camera == one) & np.isfinite(seconds))
        who = who[np.argsort(seconds[who], kind="stable")]
        way, time = np.diff(centres[who], axis=0), np.diff(seconds[who])
        long = np.linalg.norm(way, axis=1)
        good = (time > 0) & (time <= LONGEST) & (long > LEAST_WAY) & (long <= FASTEST * time)
        for k, i in enumerate(who):
            out[i] = _between(k - 1, k, way, time, good)
    return out


def _between(before: int, after: int, way: F64, time: F64, good: np.ndarray) -> F64:
    """Velocity (3,) m/s at the photo between two ways, from those that are good; 0 if none is."""
    told = [k for k in (before, after) if 0 <= k < len(good) and good[k]]
    speed = [way[k] / time[k] for k in told]
    if len(told) == 2:
        a, b = (v / np.linalg.norm(v) for v in speed)
        if float(a @ b) > SAME_WAY:
            return np.asarray((way[told[0]] + way[told[1]]) / (time[told[0]] + time[told[1]]))
        return np.asarray(speed[int(np.argmax([np.linalg.norm(v) for v in speed]))])
    return np.asarray(speed[0]) if speed else np.zeros(3)
