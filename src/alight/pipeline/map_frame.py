"""The frame of a map and the world: results leave in the world, with the covariance of the map's place on Earth.

The filter works in a map frame whose offset from the world is a state: poses and heights agree with each other far
better than with GPS/INS. So all results are moved by one constant, the newest offset, and its covariance is given
beside it. A filter that begins anew gives its poses another frame number.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.geometry import Grid
from alight.records import Datum, ElevationMap, Motion, PlaceSigma, Sites


class Tie(NamedTuple):
    """Transform of positions from one map frame to another, by the place of both in the world."""

    shift: F64  # (3,) metres, to add
    sigma: float  # metres, 1-sigma of it on the ground, in the direction in which it is largest


@dataclass(frozen=True, eq=False)
class MapFrame:
    """Place of a map frame in the world."""

    frame_id: int  # `Motion.frame_id` of the poses that belong to it
    offset_world: F64  # (3,) metres, to add to positions of the map
    covariance: F64  # (3, 3) m^2, of the map's place in the world once the offset is applied

    @classmethod
    def of(cls, motion: Motion) -> MapFrame:
        """Map frame of a motion, whose covariance is the second moment with the offset not applied."""
        offset = np.zeros(3) if motion.offset_world is None else motion.offset_world
        return cls(motion.frame_id, offset, motion.covariance[:3, :3] - np.outer(offset, offset))

    def tie(self, other: MapFrame) -> Tie:
        """The tie from this frame to another one; the covariances of their places add up."""
        sigma = PlaceSigma.of(self.covariance + other.covariance).horizontal
        return Tie(self.offset_world - other.offset_world, sigma)

    # -- from the map to the world

    def motion(self, motion: Motion) -> Motion:
        """A motion of this frame with the offset applied."""
        if motion.offset_world is None:
            return motion
        covariance = motion.covariance.copy()
        covariance[:3, :3] -= np.outer(motion.offset_world, motion.offset_world)
        body = replace(motion.world_from_body, translation=self.point(motion.world_from_body.translation))
        cams = tuple(replace(c, translation=self.point(c.translation)) for c in motion.world_from_cams)
        return replace(motion, world_from_body=body, world_from_cams=cams, covariance=covariance, offset_world=None)

    def point(self, position: F64) -> F64:
        """A point of this frame in the world, (3,) metres."""
        return np.asarray(position + self.offset_world)

    def grid(self, grid: Grid) -> Grid:
        """A grid of this frame, moved to the world."""
        east, north = float(self.offset_world[0]), float(self.offset_world[1])
        return replace(grid, east=grid.east + east, north=grid.north + north)

    def elevation(self, elevation: ElevationMap) -> ElevationMap:
        """A map of this frame in the world, with its frame number and the covariance of its place.

        The offset is applied there, and is no common error of its heights any more.
        """
        datum, (east, north, up) = elevation.datum, self.offset_world
        if datum is not None:
            covariance = datum.covariance.copy()
            covariance[0, 0] = max(covariance[0, 0] - up**2, 0.0)
            datum = Datum(datum.east + east, datum.north + north, covariance)
        return replace(
            elevation,
            grid=self.grid(elevation.grid),
            height=elevation.height + np.float32(up) if up else elevation.height,
            datum=datum,
            frame_id=self.frame_id,
            position_covariance=self.covariance,
        )

    def sites(self, sites: Sites) -> Sites:
        """Sites and candidates of this frame in the world, with the frame number."""
        return replace(sites.moved(self.offset_world), frame_id=self.frame_id)


def in_world(motions: Iterable[Motion]) -> list[Motion]:
    """Motions in the world: each map frame is placed by the newest motion in it."""
    motions = list(motions)
    newest = {m.frame_id: MapFrame.of(m) for m in motions}
    return [newest[m.frame_id].motion(m) for m in motions]
