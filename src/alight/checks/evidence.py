"""Ten seconds of a recording, read once: streams as arrays, flow of the pictures, matches between the cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from alight.arrays import F64, I64, U8, Mask
from alight.checks.flow import PictureFlow, downscaled, picture_flow
from alight.checks.looks import Brightness, StaticMap, brightness_of, edge_widths
from alight.checks.matches import match_pictures
from alight.geometry import Camera
from alight.records import Event, Frame, ImuSample, InputError, NavSample, Rig

APART = 0.08  # s, least time between two pictures whose flow is measured
MATCHED_EVERY = 1.0  # s between exposures that are matched across the rig
SHARP_EVERY = 0.5  # s between pictures whose edges are measured
AROUND = 1.0  # s of GPS/INS and IMU that are used before and after the pictures


@dataclass(frozen=True, eq=False)
class NavTable:
    """Rows of GPS/INS, NaN where not measured."""

    t_ns: I64  # (N,)
    position_world: F64  # (N, 3) m
    world_from_body: F64  # (N, 3, 3)
    velocity_world: F64  # (N, 3) m/s
    angular_velocity_body: F64  # (N, 3) rad/s
    sigma_position: F64  # (N, 3) m
    sigma_attitude: F64  # (N, 3) rad
    sigma_velocity: F64  # (N, 3) m/s

    @classmethod
    def of(cls, rows: Sequence[NavSample]) -> NavTable:
        """Gather samples."""

        def column(name: str, shape: tuple[int, ...] = (3,)) -> F64:
            nothing = np.full(shape, np.nan)
            values = [v if (v := getattr(r, name)) is not None else nothing for r in rows]
            return np.array(values, dtype=np.float64).reshape(-1, *shape)

        return cls(
            np.array([r.t_ns for r in rows], dtype=np.int64), column("position_world"),
            column("world_from_body", (3, 3)), column("velocity_world"), column("angular_velocity_body"),
            column("sigma_position"), column("sigma_attitude"), column("sigma_velocity"),
        )  # fmt: skip

    def known(self, *names: str) -> NavTable:
        """Return the rows in which all of these columns are measured."""
        keep = np.ones(len(self.t_ns), bool)
        for name in names:
            values = getattr(self, name)
            keep &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        return self.where(keep)

    def where(self, keep: Mask) -> NavTable:
        """Return the rows that `keep` (N,) marks."""
        return NavTable(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class ImuTable:
    """Inertial samples, body frame."""

    t_ns: I64  # (N,)
    angular_velocity_body: F64  # (N, 3) rad/s
    specific_force_body: F64  # (N, 3) m/s^2

    @classmethod
    def of(cls, rows: Sequence[ImuSample]) -> ImuTable:
        """Gather samples."""

        def column(values: ArrayLike) -> F64:
            return np.array(values, dtype=np.float64).reshape(-1, 3)

        times = np.array([r.t_ns for r in rows], dtype=np.int64)
        return cls(
            times, column([r.angular_velocity_body for r in rows]), column([r.specific_force_body for r in rows])
        )


@dataclass(frozen=True, eq=False)
class RigMatches:
    """Matches between camera 0 and another one, all exposures together."""

    camera: int
    t_ns: I64  # (N,) of the exposure
    first: F64  # (N, 2) px in camera 0
    other: F64  # (N, 2) px in the other one
    pairs: int  # exposures that were matched


@dataclass(eq=False)
class CameraEvidence:
    """Measurements from the pictures of one camera."""

    lens: Camera
    seconds: list[float] = field(default_factory=list)  # of each brightness, from the first exposure
    brightness: list[Brightness] = field(default_factory=list)
    flows: list[PictureFlow] = field(default_factory=list)
    edges: list[tuple[int, F64]] = field(default_factory=list)  # time ns, (2,) px across x and across y
    static: StaticMap = field(default_factory=StaticMap)
    _last: tuple[int, U8] | None = None

    def take(self, t_ns: int, image: U8, seconds: float) -> None:
        """Measure one picture."""
        if self._last is not None and t_ns - self._last[0] < APART * 1e9:
            return
        small, factor = downscaled(image)
        self.seconds.append(seconds)
        self.brightness.append(brightness_of(image))
        if not self.edges or t_ns - self.edges[-1][0] > SHARP_EVERY * 1e9:
            self.edges.append((t_ns, edge_widths(image)))
        shift = np.zeros(2)
        if self._last is not None:
            flow = picture_flow(self._last[1], small, factor, self.lens, self._last[0], t_ns)
            if flow is not None:
                self.flows.append(flow)
            shift = flow.shift / max(self.lens.width, self.lens.height) if flow is not None else np.ones(2)
        self.static.take(small, shift)
        self._last = t_ns, small


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """Input of all checks."""

    rig: Rig
    frames_ns: I64  # (N,) stamps of the exposures, as they came
    present: Mask  # (N, cameras) whether the picture of a camera arrived
    nav: NavTable
    imu: ImuTable
    cameras: tuple[CameraEvidence, ...]
    matches: tuple[RigMatches, ...]
    warnings: tuple[str, ...] = ()  # of the source
    promised: tuple[str, ...] = ()  # streams that the source's notes list


def gather_evidence(
    rig: Rig,
    events: Iterable[Event],
    seconds: float,
    start: float = 0.0,
    progress: Callable[[float], None] = lambda share: None,
) -> RigEvidence:
    """Read the part of a recording from `start` for `seconds`, both from its first exposure.

    Raises:
        InputError: there is no exposure in it.
    """
    cameras = tuple(CameraEvidence(c.camera) for c in rig.cameras)
    nav, imu, stamps, present = list[NavSample](), list[ImuSample](), list[int](), list[list[bool]]()
    first, matcher = None, _Matcher(len(rig.cameras))
    for event in events:
        if isinstance(event, NavSample):
            nav.append(event)
        elif isinstance(event, ImuSample):
            imu.append(event)
        else:
            first = event.t_ns if first is None else first
            since = 1e-9 * (event.t_ns - first)
            if since > start + seconds:
                break
            progress(min(since / (start + seconds), 1.0))
            if since >= start:
                stamps.append(event.t_ns)
                present.append([image is not None for image in event.images])
                for camera, image in zip(cameras, event.images, strict=True):
                    if image is not None:
                        camera.take(event.t_ns, np.asarray(image), since)
                matcher.take(event)
    if not stamps:
        raise InputError(
            f"no exposure between {start:g} and {start + seconds:g} s; choose another part or a longer one"
        )
    low, high = min(stamps) - AROUND * 1e9, max(stamps) + AROUND * 1e9
    return RigEvidence(
        rig, np.array(stamps, dtype=np.int64), np.array(present, dtype=bool),
        NavTable.of([r for r in nav if low <= r.t_ns <= high]), ImuTable.of([r for r in imu if low <= r.t_ns <= high]),
        cameras, matcher.found(),
    )  # fmt: skip


class _Matcher:
    """Matches camera 0 with each other camera, once a second."""

    def __init__(self, cameras: int) -> None:
        self._last: dict[int, int] = {}
        self._parts: dict[int, list[tuple[int, F64, F64]]] = {k: [] for k in range(1, cameras)}

    def take(self, frame: Frame) -> None:
        first = frame.images[0]
        for k, parts in self._parts.items():
            other = frame.images[k]
            if first is None or other is None or frame.t_ns - self._last.get(k, -(2**62)) < MATCHED_EVERY * 1e9:
                continue
            self._last[k] = frame.t_ns
            parts.append((frame.t_ns, *match_pictures(np.asarray(first), np.asarray(other))))

    def found(self) -> tuple[RigMatches, ...]:
        out = []
        for k, parts in self._parts.items():
            times = [np.full(len(a), t, dtype=np.int64) for t, a, _ in parts]
            a, b = ([p[i] for p in parts] for i in (1, 2))
            times.append(np.empty(0, np.int64))
            first, other = (np.concatenate([np.empty((0, 2)), *x]) for x in (a, b))
            out.append(RigMatches(k, np.concatenate(times), first, other, len(parts)))
        return tuple(out)
