"""Cameras of a vehicle that another program flies: pictures of a scene at the poses that it reports."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from alight.arrays import F64
from alight.geometry import Pose, slerp
from alight.records import Frame
from alight_sim.course import ground_at
from alight_sim.flight import START_NS
from alight_sim.oracle import OracleLander, Touchdown, judge_touchdown
from alight_sim.scene_world import build
from alight_sim.steered.cameras import SteeredCameras
from alight_sim.steered.flight import sized_rig
from alight_sim.world import World

KEPT_NS = 60_000_000_000  # length of the track that is kept
LEAD_NS = 200_000_000  # from the first pose to the first exposure
LATEST_NS = 1_000_000_000  # exposures with a larger delay are left out
FEET_OFF = 0.15  # m above its position on the ground: a higher vehicle flies
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class ReportedPlace:
    """A reported position and velocity, in any level frame with axes east, north, up."""

    t_ns: int
    position: F64  # (3,) metres east, north, up
    velocity: F64  # (3,) m/s


class ReportedTrack:
    """Motion between reports: slerp of attitudes and cubic Hermite interpolation of positions, in ns of one clock."""

    def __init__(self) -> None:
        self._turns = deque[tuple[int, F64]]()
        self.places = deque[ReportedPlace]()

    def add_attitude(self, t_ns: int, world_from_body: F64) -> None:
        """Append an attitude (3, 3) if it is later than the last one."""
        if not self._turns or t_ns > self._turns[-1][0]:
            self._turns.append((t_ns, world_from_body))
            _drop(self._turns, t_ns - KEPT_NS, lambda turn: turn[0])

    def add_place(self, place: ReportedPlace) -> None:
        """Append a position if it is later than the last one."""
        if not self.places or place.t_ns > self.places[-1].t_ns:
            self.places.append(place)
            _drop(self.places, place.t_ns - KEPT_NS, lambda p: p.t_ns)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Start and end of the time with known motion, ns; None: no motion is known."""
        if len(self._turns) < 2 or len(self.places) < 2:
            return None
        begin = max(self._turns[0][0], self.places[0].t_ns)
        end = min(self._turns[-1][0], self.places[-1].t_ns)
        return (begin, end) if begin < end else None

    def at(self, t_ns: float) -> tuple[F64, F64]:
        """Return the attitude `world_from_body` (3, 3) and position (3,) at a time within `span_ns`."""
        (t0, a), (t1, b) = _about(self._turns, t_ns, lambda turn: turn[0])
        p, q = _about(self.places, t_ns, lambda place: place.t_ns)
        return np.asarray(slerp(a, b, _share(t_ns, t0, t1))), _cubic(p, q, t_ns)


class FollowedCameras:
    """The cameras of a scene on a vehicle whose track is reported.

    The first reported position is placed over `start` in the scene, at the reported height above the home. The ground
    at `start` is the home's ground.

    Args:
        scene: a built-in scene's name, or a scene file.
        seed: seed of all random draws.
        size: width and height of the pictures, pixels.
        rate_hz: exposures per second.
        start: east and north in the scene, metres.
        standing: height of the body's origin above the plane of the feet, metres.

    Raises:
        InputError: the scene does not exist, or `size` has another aspect ratio than the rig's pictures.
    """

    def __init__(
        self, scene: str | Path, seed: int = 0, *, size: tuple[int, int] = (320, 240), rate_hz: float = 5.0,
        start: tuple[float, float] = (0.0, 0.0), standing: float = 0.35,
    ) -> None:  # fmt: skip
        self.world: World = build(scene, seed)
        self.rate_hz, self.track = rate_hz, ReportedTrack()
        faults, true_rig = self.world.faults, sized_rig(self.world.rig, size, stereo=True)
        self.rig = faults.claimed(true_rig)
        self._seed = seed
        self._cameras = SteeredCameras(self.world, true_rig, faults, rate_hz, self._seeds)
        ground = ground_at(self.world, np.array([*start, 0.0]))
        self._home = np.array([*start, ground + standing])
        self._offset: F64 | None = None  # (3,) metres from the reported frame to the scene
        self._shift_ns: int | None = None  # from the flight's time to the reported clock
        self.left_out = 0  # number of exposures left out because drawing took too long

    def _seeds(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._seed, spawn_key=key)

    def restart(self) -> None:
        """Forget the track, because later reports are in another frame."""
        self.track, self._offset, self._shift_ns, self._cameras.next = ReportedTrack(), None, None, 0

    def place(self, position: F64, above_home: float) -> None:
        """Set the offset from the reported frame to the scene; only the first call has an effect.

        `position`: (3,) metres, reported. `above_home`: its height above the home, metres.
        """
        if self._offset is None:
            self._offset = self._home + np.array([0.0, 0.0, above_home]) - position

    def take(self) -> list[tuple[int, Frame]]:
        """Draw the exposures whose motion is known by now; return their stamps (ns, reported clock) and frames."""
        span = self.track.span_ns
        if self._offset is None or span is None:
            return []
        if self._shift_ns is None:
            self._shift_ns = span[1] + LEAD_NS
        out = []
        while (done := self._ns(self._cameras.done_at())) <= span[1]:
            if done < max(span[0] + LEAD_NS, span[1] - LATEST_NS):
                self._cameras.next += 1
                self.left_out += 1
                continue
            exposed = self._cameras.expose(self._poses)
            if exposed is not None:
                out.append((exposed[1].t_ns - START_NS + self._shift_ns, exposed[1]))
        return out

    def touchdown(self) -> Touchdown | None:
        """Judge the touchdown where the vehicle stands, with its last velocity in flight; None: it has not flown."""
        span = self.track.span_ns
        if self._offset is None or span is None or self._shift_ns is None:
            return None
        R, here = self.track.at(span[1])
        flying = [p for p in self.track.places if p.position[2] - here[2] > FEET_OFF]
        if not flying:
            return None
        pose = Pose(R, here + self._offset)
        seconds = (flying[-1].t_ns - self._shift_ns) * 1e-9
        return judge_touchdown(self.world, OracleLander(), pose, flying[-1].velocity, seconds)

    def _ns(self, seconds: float) -> int:
        assert self._shift_ns is not None
        return self._shift_ns + math.ceil(seconds * 1e9)

    def _poses(self, seconds: F64) -> tuple[F64, F64]:
        assert self._shift_ns is not None
        assert self._offset is not None
        at = [self.track.at(self._shift_ns + float(s) * 1e9) for s in seconds]
        return np.stack([R for R, _ in at]), np.stack([p + self._offset for _, p in at])


def _drop(kept: deque[T], before_ns: int, time_of: Callable[[T], int]) -> None:
    while time_of(kept[0]) < before_ns:
        kept.popleft()


def _about(kept: deque[T], t_ns: float, time_of: Callable[[T], int]) -> tuple[T, T]:
    """Return the last item of `kept` before a time, and the first after it; `time_of`: returns an item's time, ns."""
    k = min(max(bisect_right(kept, t_ns, key=time_of), 1), len(kept) - 1)
    return kept[k - 1], kept[k]


def _share(t_ns: float, begin_ns: int, end_ns: int) -> float:
    return min(max((t_ns - begin_ns) / (end_ns - begin_ns), 0.0), 1.0)


def _cubic(a: ReportedPlace, b: ReportedPlace, t_ns: float) -> F64:
    whole, s = (b.t_ns - a.t_ns) * 1e-9, _share(t_ns, a.t_ns, b.t_ns)
    bend = s * (1.0 - s)
    along = a.position + s * s * (3.0 - 2.0 * s) * (b.position - a.position)
    return np.asarray(along + whole * bend * ((1.0 - s) * a.velocity - s * b.velocity))
