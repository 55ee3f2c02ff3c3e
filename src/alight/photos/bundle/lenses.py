"""Cameras of a set of photos: each zoom level is a camera of its own, with its own lens to estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from alight.arrays import F64, I64, Mask
from alight.geometry import Camera


@dataclass(frozen=True, eq=False)
class PhotoLenses:
    """The cameras of a set, and which camera took each photo."""

    cameras: tuple[Camera, ...]
    of: I64  # (n,) camera index of each photo
    readouts: tuple[float, ...] = ()  # s per camera, from the first row to the last; empty: all rows at once
    by_maker: tuple[float | None, ...] = ()  # s per camera, readout given by its maker, not estimated; None: not given

    def of_photo(self, photo: int) -> Camera:
        """Return the camera of one photo."""
        return self.cameras[int(self.of[photo])]

    @property
    def parts(self) -> list[slice]:
        """Slice of each camera's lens parameters among all k: scale, aspect, cu, cv, distortion..., readout."""
        ends = np.cumsum([0] + [5 + len(c.distortion) for c in self.cameras])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def moved(self, lens: F64) -> PhotoLenses:
        """Return the cameras changed by lens offsets (k,) (eq. 3)."""
        moved = tuple(lens_camera(c, lens[part]) for c, part in zip(self.cameras, self.parts, strict=True))
        return replace(self, cameras=moved, readouts=tuple(float(lens[k]) for k in self.readout_numbers))

    @property
    def readout_numbers(self) -> list[int]:
        """Indices of the readouts among all lens parameters."""
        return [part.stop - 1 for part in self.parts]

    def readout(self, photo: I64) -> F64:
        """Return the readout times (N,) in s, from first to last row, of the photos with indices `photo` (N,)."""
        return np.asarray(self.table()[0][self.of[photo], -1])

    def table(self) -> tuple[F64, I64]:
        """Return the lens table of the kernels (see `adjustment_kernels`), `lens` (c, 11) and `model` (c,)."""
        readouts = self.readouts or (0.0,) * len(self.cameras)
        rows = [
            (c.fu, c.fv, c.cu, c.cv, *c.coefficients, c.height, readout)
            for c, readout in zip(self.cameras, readouts, strict=True)
        ]
        return np.array(rows, np.float64), np.array([c.code for c in self.cameras], np.int64)

    def free_numbers(self, free: Mask) -> tuple[I64, I64]:
        """Return two (c, f) tables of each camera's free parameters: indices in its lens, indices among all free ones.

        `free` (k,) is the mask of free lens parameters. Indices in a lens are those of the kernels. Entries are -1
        where a camera has fewer than f free parameters.
        """
        count = np.array([free[part].sum() for part in self.parts])
        number, place = np.full((2, len(count), count.max()), -1, np.int64)
        for k, (camera, part) in enumerate(zip(self.cameras, self.parts, strict=True)):
            own, last = np.flatnonzero(free[part]), 4 + len(camera.coefficients)  # of the kernels' longer list
            number[k, : len(own)] = np.where(own == part.stop - part.start - 1, last, own)
            place[k, : len(own)] = count[:k].sum() + np.arange(len(own))
        return number, place

    def focal(self, photo: I64) -> F64:
        """Return the focal lengths (N, 2), fu and fv in pixels, of the photos with indices `photo` (N,)."""
        return np.array([(c.fu, c.fv) for c in self.cameras])[self.of[photo]]


def lens_camera(prior: Camera, lens: F64) -> Camera:
    """Return the prior camera changed by lens offsets (k,) (eq. 3)."""
    s, a, du, dv = lens[:4]
    d = tuple(float(x) for x in np.add(prior.distortion, lens[4:-1])) if prior.distortion else ()
    fv = prior.fv * (1 + s)
    return replace(prior, fu=prior.fu * (1 + s) * (1 + a), fv=fv, cu=prior.cu + du, cv=prior.cv + dv, distortion=d)
