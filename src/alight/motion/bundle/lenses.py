"""The cameras of a set of photos: each zoom level is a camera of its own, with a lens of its own to be estimated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from alight.arrays import F64, I64
from alight.geometry import Camera
from alight.motion.bundle.rolling import row_time


@dataclass(frozen=True, eq=False)
class PhotoLenses:
    """The cameras, and which of them took each photo."""

    cameras: tuple[Camera, ...]
    of: I64  # (n,) number of the camera of each photo
    readouts: tuple[float, ...] = ()  # s, of each camera from its first row to its last; none: all rows at once
    told: tuple[float | None, ...] = ()  # s, the readouts that the makers tell, which are held; none: nobody does

    @classmethod
    def one(cls, camera: Camera, photos: int) -> PhotoLenses:
        """All photos by one camera."""
        return cls((camera,), np.zeros(photos, np.int64))

    def of_photo(self, photo: int) -> Camera:
        """The camera of one photo."""
        return self.cameras[int(self.of[photo])]

    @property
    def parts(self) -> list[slice]:
        """Where the numbers of each camera stand among all lens numbers: scale aspect cu cv distortion... readout."""
        ends = np.cumsum([0] + [5 + len(c.distortion) for c in self.cameras])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def moved(self, lens: F64) -> PhotoLenses:
        """The cameras moved by lens offsets (k,) (eq. 3)."""
        moved = tuple(lens_camera(c, lens[part]) for c, part in zip(self.cameras, self.parts, strict=True))
        return replace(self, cameras=moved, readouts=tuple(float(lens[part.stop - 1]) for part in self.parts))

    @property
    def readout_numbers(self) -> list[int]:
        """Where the readouts stand among all lens numbers."""
        return [part.stop - 1 for part in self.parts]

    def told_of(self, camera: int) -> float | None:
        """The readout that a camera's maker tells, s."""
        return self.told[camera] if self.told else None

    def with_told(self, lens: F64) -> F64:
        """Lens numbers (k,) with the readouts that the makers tell."""
        lens = lens.copy()
        for k, number in enumerate(self.readout_numbers):
            lens[number] = lens[number] if self.told_of(k) is None else self.told_of(k)
        return lens

    def readout(self, photo: I64) -> F64:
        """(N,) seconds from the first row to the last of photos (N,)."""
        return np.array(self.readouts or (0.0,) * len(self.cameras))[self.of[photo]]

    def row_time(self, photo: I64, pixels: F64) -> F64:
        """(N,) when pixels (N, 2) were exposed, in readouts from the middle of their photos."""
        return row_time(pixels[:, 1], np.array([float(c.height) for c in self.cameras])[self.of[photo]])

    def project(self, photo: I64, points: F64) -> F64:
        """(N, 2) pixels of (N, 3) points in the optical frames of their photos (N,)."""
        return self._each(photo, points, Camera.project)

    def rays(self, photo: I64, pixels: F64) -> F64:
        """(N, 3) rays of (N, 2) pixels."""
        return self._each(photo, pixels, Camera.rays)

    def distort(self, photo: I64, xy: F64) -> F64:
        """(N, 2) distorted of (N, 2) ideal coordinates."""
        return self._each(photo, xy, Camera.distort)

    def focal(self, photo: I64) -> F64:
        """(N, 2) focal lengths, pixels."""
        return np.array([(c.fu, c.fv) for c in self.cameras])[self.of[photo]]

    def by_camera(self, photo: I64) -> Iterator[tuple[int, Camera, I64]]:
        """Each camera's number and the rows of its photos."""
        for k, camera in enumerate(self.cameras):
            yield k, camera, np.flatnonzero(self.of[photo] == k)

    def _each(self, photo: I64, values: F64, function: Callable[[Camera, F64], F64]) -> F64:
        if len(self.cameras) == 1:
            return function(self.cameras[0], values)
        parts = [(rows, function(camera, values[rows])) for _, camera, rows in self.by_camera(photo)]
        out = np.empty((len(values), parts[0][1].shape[1]))
        for rows, found in parts:
            out[rows] = found
        return out


def lens_camera(prior: Camera, lens: F64) -> Camera:
    """Return the prior camera moved by lens offsets (k,) (eq. 3)."""
    s, a, du, dv = lens[:4]
    d = tuple(float(x) for x in np.add(prior.distortion, lens[4:-1])) if prior.distortion else ()
    fv = prior.fv * (1 + s)
    return replace(prior, fu=prior.fu * (1 + s) * (1 + a), fv=fv, cu=prior.cu + du, cv=prior.cv + dv, distortion=d)
