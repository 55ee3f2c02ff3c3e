"""Checks of rates and stamps: gaps, missing partners, repeated times, sigmas, and clocks that do not overlap."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from alight.arrays import I64
from alight.checks.evidence import RigEvidence
from alight.checks.result import Check, CheckResult, bad, unknown

FEW = 0.05  # share of exposures, partners or rows that may be missing or out of order


class Sampling(NamedTuple):
    """Statistics of the sample times of a stream."""

    rate: float  # Hz, from the median interval
    missing: float  # share of the samples, between the first and the last
    repeated: int  # number of times that an earlier sample has
    backwards: int  # number of times before the time of the previous sample

    @property
    def disorder(self) -> str:
        """Text with the numbers of times that are repeated or go backwards."""
        return f"{self.repeated} times repeated, {self.backwards} backwards"


def sampling_of(t_ns: I64) -> Sampling:
    """Return statistics of the sample times (N,) ns of a stream."""
    unique = np.unique(t_ns)
    repeated, backwards = len(t_ns) - len(unique), int((np.diff(t_ns) < 0).sum())
    steps = np.diff(unique).astype(np.float64) * 1e-9
    if not len(steps):
        return Sampling(float("nan"), 0.0, repeated, backwards)
    usual = float(np.median(steps))
    lost = float((np.round(steps / usual) - 1.0).clip(0.0).sum())
    return Sampling(1.0 / usual, lost / (lost + len(steps) + 1), repeated, backwards)


def check_frames(evidence: RigEvidence) -> CheckResult:
    """Check the rate of the exposures, gaps, and exposures in which a camera's picture is missing."""
    found, count = Check("pictures in time", separator=", "), len(evidence.frames_ns)
    if count < 3:
        return unknown(found.name, f"{count} exposures")
    s = sampling_of(evidence.frames_ns)
    alone = 1.0 - evidence.present.mean(axis=0)
    apart = _milliseconds_apart(evidence)
    found.measured = [f"{count} exposures", f"{s.rate:.1f} Hz", f"{100 * s.missing:.1f} % missing"]
    found.measured += [
        f"{c.name} without picture in {100 * a:.1f} %" for c, a in zip(evidence.rig.cameras, alone, strict=True)
    ]
    found.judge(
        (s.missing > FEW, "find what drops exposures: cable, bus, disk or processor"),
        (bool((alone > FEW).any()), "trigger the cameras together, and find what drops the pictures of one"),
        (apart > 5.0, "trigger the cameras together", f"paired pictures are up to {apart:.1f} ms apart"),
        (
            s.repeated > 0 or s.backwards / (count - 1) > FEW,
            "give every exposure its own time, in order", s.disorder,
        ),
        (s.rate < 1.0, "record at least 5 exposures a second"),
    )  # fmt: skip
    return found.result


def _milliseconds_apart(evidence: RigEvidence) -> float:
    """Return the milliseconds between paired pictures, from the source's warnings; 0 if there is no such warning."""
    for warning in evidence.warnings:
        if "do not expose together" in warning and (found := re.search(r"([\d.]+) ms", warning)):
            return float(found.group(1))
    return 0.0


def check_rows(evidence: RigEvidence) -> list[CheckResult]:
    """Check rates, order and time span of GPS/INS and IMU against the pictures, and the sigmas of GPS/INS."""
    return [
        _check_stream("GPS/INS", evidence.nav.t_ns, 2.0, evidence),
        _check_stream("IMU", evidence.imu.t_ns, 50.0, evidence),
        _check_sigmas(evidence),
    ]


def _check_stream(what: str, t_ns: I64, least_rate: float, evidence: RigEvidence) -> CheckResult:
    found, count = Check(f"{what} in time", separator=", "), len(t_ns)
    if count < 3:
        if what in evidence.promised:
            return bad(
                found.name, f"the recording has {what}, but no row at the time of the pictures",
                f"put pictures and {what} on one clock (ns), as in docs/your-data.md",
            )  # fmt: skip
        return unknown(found.name, f"no {what}")
    s = sampling_of(t_ns)
    first, last = (int(t) for t in (evidence.frames_ns.min(), evidence.frames_ns.max()))
    uncovered = max(int(t_ns.min()) - first, 0) + max(last - int(t_ns.max()), 0)
    found.measured = [f"{count} rows", f"{s.rate:.0f} Hz", f"{100 * s.missing:.1f} % missing"]
    found.judge(
        (
            uncovered > 0.2 * max(last - first, 1),
            f"put pictures and {what} on one clock, or record both for as long",
            f"{1e-9 * uncovered:.1f} s of the pictures are without it",
        ),
        (s.missing > 4 * FEW, f"find what drops the rows of {what}"),
        (
            max(s.repeated, s.backwards) > FEW * count,
            "give every row its own time of validity, in order", s.disorder,
        ),
        (s.rate < least_rate, f"record {what} with at least {least_rate:g} Hz"),
    )  # fmt: skip
    return found.result


def _check_sigmas(evidence: RigEvidence) -> CheckResult:
    found, nav = Check("sigmas of GPS/INS", separator=", "), evidence.nav
    if len(nav.t_ns) < 3:
        return unknown(found.name, "no GPS/INS")
    for what, values, sigma, unit, least, most in (
        ("position", nav.position_world, nav.sigma_position, "m", 1e-3, 100.0),
        ("attitude", nav.world_from_body.reshape(-1, 9), nav.sigma_attitude, "rad", 1e-5, 1.0),
        ("velocity", nav.velocity_world, nav.sigma_velocity, "m/s", 1e-4, 20.0),
    ):
        there = np.isfinite(values).all(axis=1)
        if not there.any():
            continue
        stated = np.isfinite(sigma[there]).all(axis=1)
        middle = float(np.median(sigma[there][stated])) if stated.any() else float("nan")
        found.measured.append(f"{what} {middle:.3g} {unit}" if stated.any() else f"{what} without sigma")
        mostly = stated.mean() >= 0.5
        found.judge(
            (not mostly, f"write the sigma of the {what}"),
            (
                bool(mostly) and not least < middle < most,
                f"write the sigma of the {what} in {unit}, 1-sigma, as the receiver states it",
            ),
        )
    return found.result
