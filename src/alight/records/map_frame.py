"""Map frame and world: results leave the pipeline in the world, with the covariance of the map's absolute position.

The filter works in a map frame whose offset from the world is a state. Poses and heights agree with each other far
better than with GPS/INS. So all results are moved by one constant, the newest offset, and its covariance is given
separately. A filter that is reinitialised gives its poses another map number.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from alight.arrays import F64
from alight.geometry import Grid
from alight.records.landing import Sites
from alight.records.motion import Motion
from alight.records.surface import Datum, ElevationMap, PlaceSigma


class Tie(NamedTuple):
    """Shift between two map frames, derived from the world positions of both."""

    shift: F64  # (3,) metres, to be added to positions of the first frame
    sigma: float  # metres, horizontal 1-sigma of the shift in its most uncertain direction


@dataclass(frozen=True, eq=False)
class MapFrame:
    """Position of a map frame in the world."""

    frame_id: int  # map number, `Motion.frame_id` of its poses
    offset_world: F64  # (3,) metres, added to map positions
    covariance: F64  # (3, 3) m^2, of a map position that was converted to the world

    @classmethod
    def of(cls, motion: Motion) -> MapFrame:
        """Build the map frame of a motion, with the covariance of the motion's position in the world."""
        offset = np.zeros(3) if motion.offset_world is None else motion.offset_world
        return cls(motion.frame_id, offset, motion.covariance[:3, :3] - np.outer(offset, offset))

    def tie(self, other: MapFrame) -> Tie:
        """Return the tie from this frame to `other`; its covariance is the sum of both frames' covariances."""
        sigma = PlaceSigma.of(self.covariance + other.covariance).horizontal
        return Tie(self.offset_world - other.offset_world, sigma)

    # -- from the map to the world

    def motion(self, motion: Motion) -> Motion:
        """Convert a motion of this frame to the world: apply the offset."""
        if motion.offset_world is None:
            return motion
        covariance = motion.covariance.copy()
        covariance[:3, :3] -= np.outer(motion.offset_world, motion.offset_world)
        body = replace(motion.world_from_body, translation=self.point(motion.world_from_body.translation))
        cams = tuple(replace(c, translation=self.point(c.translation)) for c in motion.world_from_cams)
        return replace(motion, world_from_body=body, world_from_cams=cams, covariance=covariance, offset_world=None)

    def point(self, position: F64) -> F64:
        """Convert a point of this frame to the world, (3,) metres."""
        return np.asarray(position + self.offset_world)

    def grid(self, grid: Grid) -> Grid:
        """Convert a grid of this frame to the world."""
        east, north = float(self.offset_world[0]), float(self.offset_world[1])
        return replace(grid, east=grid.east + east, north=grid.north + north)

    def elevation(self, elevation: ElevationMap) -> ElevationMap:
        """Convert a map of this frame to the world, and give it the frame's map number and covariance.

        The applied offset is removed from the datum's covariance.
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
        """Convert sites and candidates of this frame to the world, and give them the frame's map number."""
        return replace(sites.moved(self.offset_world), frame_id=self.frame_id)


def in_world(motions: Iterable[Motion]) -> list[Motion]:
    """Convert motions to the world: each map frame gets the offset of its newest motion."""
    motions = list(motions)
    newest = {m.frame_id: MapFrame.of(m) for m in motions}
    return [newest[m.frame_id].motion(m) for m in motions]
