"""Faults between cameras and log: lost, late or wrongly stamped pictures, wrong calibration, covered lenses.

The pictures are drawn with the true rig; a wrong calibration or mounting appears only in the log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from alight.arrays import F64, I64
from alight.geometry import Pose, so3_exp
from alight.records import Rig, RigCamera
from alight_sim.section import Section


class Span(Section):
    """An interval of the flight."""

    at: float = Field(description="s after the first exposure")
    seconds: float = Field(gt=0, description="s that it lasts")

    def holds(self, seconds: F64) -> NDArray[np.bool_]:
        """Return the (N,) mask of times within the interval, including its start but not its end."""
        return np.asarray((seconds >= self.at) & (seconds < self.at + self.seconds))


class Cover(Span):
    """A cover over a lens for an interval of the flight."""

    camera: int | None = Field(None, ge=0, description="its number in the rig; all without it")
    share: float = Field(0.98, ge=0, le=1, description="share of the light that is kept out")


class Calibration(Section):
    """Errors of the claimed rig against the true one."""

    focal: float = Field(0.0, gt=-0.5, lt=0.5, description="share by which the claimed focal length is too long")
    principal: tuple[float, float] = Field((0.0, 0.0), description="pixels right, down, of the claimed principal point")
    distortion: float = Field(0.0, description="share by which the claimed distortion is too strong")
    toe_deg: float = Field(
        0.0, description="degrees that every camera but the first is claimed to be turned about its image's vertical"
    )
    baseline: float = Field(0.0, gt=-0.9, lt=0.9, description="share by which the cameras are claimed too far apart")

    def claim(self, cam: RigCamera, first: RigCamera) -> RigCamera:
        """Return camera `cam` as the calibration describes it; a baseline error changes its offset from `first`."""
        lens = cam.camera
        claimed = replace(
            lens,
            fu=lens.fu * (1.0 + self.focal),
            fv=lens.fv * (1.0 + self.focal),
            cu=lens.cu + self.principal[0],
            cv=lens.cv + self.principal[1],
            distortion=tuple(k * (1.0 + self.distortion) for k in lens.distortion),
        )
        if cam is first:
            return replace(cam, camera=claimed)
        turn = so3_exp([0.0, math.radians(self.toe_deg), 0.0])
        start = first.body_from_cam.translation
        place = start + (1.0 + self.baseline) * (cam.body_from_cam.translation - start)
        return RigCamera(cam.name, claimed, Pose(cam.body_from_cam.rotation @ turn, place))


class Faults(Section):
    """Faults between the shutter and the log; all are off by default."""

    dropped: float = Field(0.0, ge=0, lt=1, description="share of exposures that are lost, all cameras together")
    dropped_one: float = Field(0.0, ge=0, lt=1, description="share of exposures of which one camera's picture is lost")
    bursts: tuple[Span, ...] = Field((), description="times in which every exposure is lost")
    jitter: float = Field(
        0.0, ge=0, description="s, standard deviation of the time between the even beat and the exposure, truly stamped"
    )
    late: float = Field(0.0, ge=0, le=1, description="share of exposures that arrive late, rightly stamped")
    late_by: float = Field(0.3, ge=0, description="s, on average (exponential)")
    repeated: float = Field(0.0, ge=0, le=1, description="share of exposures stamped like the one before")
    time_offset: float = Field(0.0, description="s that the cameras' stamps are ahead of the clock of GPS/INS and IMU")
    calibration: Calibration = Field(Calibration(), description="of the claimed rig")
    mounting_deg: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="degrees about the body's x, y, z that the cameras are claimed to be turned"
    )
    covered: tuple[Cover, ...] = Field((), description="lenses that see nothing")

    def claimed(self, true: Rig) -> Rig:
        """Return a rig as its faulty calibration describes it."""
        if self.calibration == Calibration() and not any(self.mounting_deg):
            return true
        turn = Pose(so3_exp(np.radians(self.mounting_deg)), np.zeros(3))
        cams = (self.calibration.claim(c, true.cameras[0]) for c in true.cameras)
        return Rig(tuple(replace(c, body_from_cam=turn @ c.body_from_cam) for c in cams))

    def cover(self, seconds: float, cam: int) -> float:
        """Return the share of the light that a cover keeps out of the camera of index `cam` at a time (s)."""
        over = [c.share for c in self.covered if c.camera in (None, cam) and bool(c.holds(np.array([seconds])).item())]
        return max(over, default=0.0)


@dataclass(frozen=True, eq=False)
class Exposures:
    """True time, stamp and arrival of each exposure (N,), and its lost pictures, in order of true time."""

    true_ns: I64
    stamp_ns: I64
    arrival_ns: I64
    seen: NDArray[np.bool_]  # (N, cameras), False for a lost picture

    @property
    def order(self) -> NDArray[np.intp]:
        """(M,) indices of the exposures with at least one picture, in order of arrival."""
        there = np.flatnonzero(self.seen.any(axis=1))
        return np.asarray(there[np.argsort(self.arrival_ns[there], kind="stable")])


def exposures(faults: Faults, beat_ns: I64, cameras: int, seeds: np.random.SeedSequence) -> Exposures:
    """Return the exposures planned at `beat_ns` (N,), with faults of timing and loss; `cameras`: their number."""
    rngs = [np.random.default_rng(s) for s in seeds.spawn(6)]
    n, start = len(beat_ns), int(beat_ns[0])
    period = float(np.diff(beat_ns).min(initial=10**12))
    jitter = np.clip(faults.jitter * 1e9 * rngs[0].standard_normal(n), -0.4 * period, 0.4 * period)
    jitter[0] = 0.0
    true_ns = beat_ns + np.round(jitter).astype(np.int64)
    seconds = np.asarray((true_ns - start) * 1e-9, dtype=np.float64)
    seen = np.repeat((rngs[1].uniform(size=n) >= faults.dropped)[:, None], cameras, axis=1)
    one, which = rngs[2].uniform(size=n) < faults.dropped_one, rngs[2].integers(0, cameras, n)
    seen[one, which[one]] = False
    for span in faults.bursts:
        seen[span.holds(seconds)] = False
    delay = np.where(rngs[3].uniform(size=n) < faults.late, faults.late_by * rngs[4].exponential(size=n), 0.0)
    stamp_ns = true_ns + round(faults.time_offset * 1e9)
    again = rngs[5].uniform(size=n) < faults.repeated
    again[0] = False
    stamp_ns = stamp_ns[np.maximum.accumulate(np.where(again, 0, np.arange(n)))]
    return Exposures(true_ns, stamp_ns, stamp_ns + np.round(delay * 1e9).astype(np.int64), seen)
