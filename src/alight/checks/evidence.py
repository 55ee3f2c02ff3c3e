"""Ten seconds of a recording, read once: streams as arrays, flow of the pictures, and matches between the cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from alight.arrays import F64, I64, U8, Mask
from alight.checks.features import PictureFlow, downscaled, match_pictures, picture_flow
from alight.checks.picture_quality import Brightness, StaticMap, brightness_of, edge_widths
from alight.geometry import Camera
from alight.records import Event, ImuSample, InputError, NavSample, Rig, RigCamera


def seconds_since(t_ns: I64, origin_ns: int) -> F64:
    """Return times (N,) ns in seconds from an origin."""
    return np.asarray((t_ns - origin_ns).astype(np.float64) * 1e-9)


def trimmed_rms(values: F64) -> float:
    """Return the RMS of numbers (N,) or vectors (N, D) without the largest 5 % of them."""
    squares = np.sort(values**2 if values.ndim == 1 else (values**2).sum(axis=1))
    return float(np.sqrt(squares[: max(1, int(0.95 * len(squares)))].mean()))


@dataclass(frozen=True, eq=False)
class StreamTable:
    """Columns of one stream, one row per sample, NaN where not measured."""

    t_ns: I64  # (N,)

    @classmethod
    def of(cls, samples: Sequence[NavSample] | Sequence[ImuSample]) -> Self:
        """Return the table of samples, with one column for each field of the table."""
        columns: list[F64 | I64] = [np.array([s.t_ns for s in samples], dtype=np.int64)]
        for name in (f.name for f in fields(cls)[1:]):
            blank = np.full((3, 3) if name == "world_from_body" else 3, np.nan)
            values = [blank if (v := getattr(s, name)) is None else v for s in samples]
            columns.append(np.array(values, dtype=np.float64).reshape(-1, *blank.shape))
        return cls(*columns)  # type: ignore[arg-type]

    def where(self, keep: Mask) -> Self:
        """Return the rows where the mask `keep` (N,) is true."""
        return type(self)(*(getattr(self, f.name)[keep] for f in fields(self)))

    def measured(self, *names: str) -> Self:
        """Return the rows in which all of the named columns are finite."""
        keep = np.ones(len(self.t_ns), bool)
        for values in (getattr(self, name) for name in names):
            keep &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        return self.where(keep)

    def in_order(self) -> Self:
        """Return the rows whose time is later than all previous rows."""
        latest = np.maximum.accumulate(self.t_ns) if len(self.t_ns) else self.t_ns
        return self.where(np.concatenate([np.ones(min(len(latest), 1), bool), self.t_ns[1:] > latest[:-1]]))


@dataclass(frozen=True, eq=False)
class NavTable(StreamTable):
    """Rows of GPS/INS."""

    position_world: F64  # (N, 3) m
    world_from_body: F64  # (N, 3, 3)
    velocity_world: F64  # (N, 3) m/s
    angular_velocity_body: F64  # (N, 3) rad/s
    sigma_position: F64  # (N, 3) m
    sigma_attitude: F64  # (N, 3) rad
    sigma_velocity: F64  # (N, 3) m/s


@dataclass(frozen=True, eq=False)
class ImuTable(StreamTable):
    """Inertial samples, body frame."""

    angular_velocity_body: F64  # (N, 3) rad/s
    specific_force_body: F64  # (N, 3) m/s^2


def integrated(seconds: F64, rates: F64) -> Rotation:
    """Integrate angular rates (N, 3), rad/s, at ascending times (N,), s, to (N,) orientations relative to the first."""
    turns = 0.5 * (rates[1:] + rates[:-1]) * np.diff(seconds)[:, None]
    path = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), turns]))
    reach = 1
    while reach < len(seconds):  # products of 2, 4, 8, ... steps (Hillis and Steele 1986)
        path = Rotation.concatenate([path[:reach], path[:-reach] * path[reach:]])
        reach *= 2
    return path


@dataclass(eq=False)
class CameraEvidence:
    """Measurements from the pictures of one camera."""

    lens: Camera
    seconds: list[float] = field(default_factory=list)  # times of `brightness`, from the first exposure
    brightness: list[Brightness] = field(default_factory=list)
    flows: list[PictureFlow] = field(default_factory=list)
    edges: list[F64] = field(default_factory=list)  # (2,) px across x and across y
    static: StaticMap = field(default_factory=StaticMap)
    matches: list[tuple[int, F64, F64]] = field(default_factory=list)  # ns, pixels in camera 0, pixels in this camera
    _last: tuple[int, U8] | None = None
    _edges_ns: int = -(2**62)  # time of the last of `edges`

    def add(self, t_ns: int, image: U8, seconds: float) -> None:
        """Measure a picture taken `seconds` after the first exposure; skip it within 0.08 s of the previous picture."""
        if self._last is not None and t_ns - self._last[0] < 0.08 * 1e9:
            return
        small, factor = downscaled(image, 640)
        self.seconds.append(seconds)
        self.brightness.append(brightness_of(image))
        if t_ns - self._edges_ns > 0.5 * 1e9:
            self.edges.append(edge_widths(image))
            self._edges_ns = t_ns
        shift = np.zeros(2)
        if self._last is not None:
            flow = picture_flow(self._last[1], small, factor, self.lens, (self._last[0], t_ns))
            self.flows += [flow] if flow is not None else []
            shift = flow.shift / max(self.lens.width, self.lens.height) if flow is not None else np.ones(2)
        self.static.add(small, shift)
        self._last = t_ns, small

    def match(self, t_ns: int, first: U8, own: U8) -> None:
        """Match a picture `own` of this camera with the picture `first` of camera 0, at most once per second."""
        if not self.matches or t_ns - self.matches[-1][0] >= 1e9:
            self.matches.append((t_ns, *match_pictures(first, own)))


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """Input of all checks."""

    rig: Rig
    frames_ns: I64  # (N,) stamps of the exposures, in order of arrival
    present: Mask  # (N, cameras) whether the picture of a camera arrived
    nav: NavTable
    imu: ImuTable
    cameras: tuple[CameraEvidence, ...]
    warnings: tuple[str, ...] = ()  # of the source
    promised: tuple[str, ...] = ()  # streams that the source's notes list
    ahead: float = 0.0  # s that a calibration has subtracted from the stamps of camera 0

    @property
    def by_camera(self) -> list[tuple[RigCamera, CameraEvidence]]:
        """Pairs of each camera and its measurements."""
        return list(zip(self.rig.cameras, self.cameras, strict=True))


def gather_evidence(
    rig: Rig,
    events: Iterable[Event],
    seconds: float,
    start: float = 0.0,
    progress: Callable[[float], None] = lambda share: None,
) -> RigEvidence:
    """Read the part of a recording from `start` to `start + seconds`, s from its first exposure.

    Raises:
        InputError: there is no exposure in that part.
    """
    cameras = tuple(CameraEvidence(c.camera) for c in rig.cameras)
    nav, imu, stamps, present = list[NavSample](), list[ImuSample](), list[int](), list[list[bool]]()
    first = None
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
            if since < start:
                continue
            stamps.append(event.t_ns)
            images = [None if image is None else np.asarray(image) for image in event.images]
            present.append([image is not None for image in images])
            for k, (camera, image) in enumerate(zip(cameras, images, strict=True)):
                if image is not None:
                    camera.add(event.t_ns, image, since)
                    if k and images[0] is not None:
                        camera.match(event.t_ns, images[0], image)
    if not stamps:
        raise InputError(
            f"no exposure between {start:g} and {start + seconds:g} s; choose another part or a longer one"
        )
    low, high = min(stamps) - 1e9, max(stamps) + 1e9  # GPS/INS and IMU include one second before and after the pictures
    return RigEvidence(
        rig, np.array(stamps, dtype=np.int64), np.array(present, dtype=bool),
        NavTable.of([r for r in nav if low <= r.t_ns <= high]), ImuTable.of([r for r in imu if low <= r.t_ns <= high]),
        cameras,
    )  # fmt: skip
