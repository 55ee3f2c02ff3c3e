"""Rates and stamps: gaps, missing partners, repeated times, sigmas, and clocks that do not overlap."""

from __future__ import annotations

import re

import numpy as np

from alight.arrays import F64, I64
from alight.checks.evidence import RigEvidence
from alight.checks.result import CheckResult, bad, good, unknown

MISSING = 0.05  # share of exposures or partners that may be missing
SLOW_FRAMES, SLOW_NAV, SLOW_IMU = 1.0, 2.0, 50.0  # Hz
LATE = 0.05  # share of rows that may be out of order
APART_MS = 5.0


def sampling_rate(t_ns: I64) -> tuple[float, float]:
    """Rate by the median interval, Hz, and share of the samples that are missing between the first and the last."""
    steps = np.diff(np.unique(t_ns)).astype(np.float64) * 1e-9
    if not len(steps):
        return float("nan"), 0.0
    usual = float(np.median(steps))
    lost = float((np.round(steps / usual) - 1.0).clip(0.0).sum())
    return 1.0 / usual, lost / (lost + len(steps) + 1)


def check_frames(evidence: RigEvidence) -> CheckResult:
    """Rate of the exposures, gaps, and cameras without partner."""
    name = "pictures in time"
    t = evidence.frames_ns
    if len(t) < 3:
        return unknown(name, f"{len(t)} exposures")
    rate, lost = sampling_rate(t)
    alone = 1.0 - evidence.present.mean(axis=0)
    names = [c.name for c in evidence.rig.cameras]
    evidence_words = f"{len(t)} exposures, {rate:.1f} Hz, {100 * lost:.1f} % missing"
    evidence_words += "".join(f", {n} without picture in {100 * a:.1f} %" for n, a in zip(names, alone, strict=True))
    faults = []
    if lost > MISSING:
        faults.append("find what drops exposures: cable, bus, disk or processor")
    if (alone > MISSING).any():
        faults.append("trigger the cameras together, and find what drops the pictures of one")
    if (apart := _apart(evidence)) > APART_MS:
        evidence_words += f", paired pictures are up to {apart:.1f} ms apart"
        faults.append("trigger the cameras together")
    if len(np.unique(t)) < len(t) or (np.diff(t) < 0).mean() > LATE:
        evidence_words += f", {len(t) - len(np.unique(t))} times repeated, {(np.diff(t) < 0).sum()} backwards"
        faults.append("give every exposure its own time, in order")
    if rate < SLOW_FRAMES:
        faults.append("record at least 5 exposures a second")
    return bad(name, evidence_words, "; ".join(faults)) if faults else good(name, evidence_words)


def _apart(evidence: RigEvidence) -> float:
    """Milliseconds between paired pictures, from the source's warnings; 0: no such warning."""
    for warning in evidence.warnings:
        if "do not expose together" in warning and (found := re.search(r"([\d.]+) ms", warning)):
            return float(found.group(1))
    return 0.0


def check_rows(evidence: RigEvidence) -> list[CheckResult]:
    """Rates, order and span of GPS/INS and IMU against the pictures, and the sigmas of GPS/INS."""
    return [
        _stream("GPS/INS in time", evidence.nav.t_ns, SLOW_NAV, evidence, "GPS/INS"),
        _stream("IMU in time", evidence.imu.t_ns, SLOW_IMU, evidence, "IMU"),
        _sigmas(evidence),
    ]


def _stream(name: str, t_ns: I64, slow: float, evidence: RigEvidence, what: str) -> CheckResult:
    if len(t_ns) < 3:
        if what in evidence.promised:
            return bad(
                name, f"the recording has {what}, but no row at the time of the pictures",
                f"put pictures and {what} on one clock (ns), as docs/your-camera.md says",
            )  # fmt: skip
        return unknown(name, f"no {what}")
    rate, lost = sampling_rate(t_ns)
    words = f"{len(t_ns)} rows, {rate:.0f} Hz, {100 * lost:.1f} % missing"
    first, last = (int(t) for t in (evidence.frames_ns.min(), evidence.frames_ns.max()))
    uncovered = max(int(t_ns.min()) - first, 0) + max(last - int(t_ns.max()), 0)
    repeated, back = len(t_ns) - len(np.unique(t_ns)), int((np.diff(t_ns) < 0).sum())
    faults = []
    if uncovered > 0.2 * max(last - first, 1):
        words += f", {1e-9 * uncovered:.1f} s of the pictures are without it"
        faults.append(f"put pictures and {what} on one clock, or record both for as long")
    if lost > 4 * MISSING:
        faults.append(f"find what drops the rows of {what}")
    if repeated > LATE * len(t_ns) or back > LATE * len(t_ns):
        words += f", {repeated} times repeated, {back} backwards"
        faults.append("give every row its own time of validity, in order")
    if rate < slow:
        faults.append(f"record {what} with at least {slow:g} Hz")
    return bad(name, words, "; ".join(faults)) if faults else good(name, words)


def _sigmas(evidence: RigEvidence) -> CheckResult:
    name = "sigmas of GPS/INS"
    nav = evidence.nav
    if len(nav.t_ns) < 3:
        return unknown(name, "no GPS/INS")
    words, faults = list[str](), list[str]()
    table: tuple[tuple[str, F64, F64, str, float, float], ...] = (
        ("position", nav.position_world, nav.sigma_position, "m", 1e-3, 100.0),
        ("attitude", nav.world_from_body.reshape(-1, 9), nav.sigma_attitude, "rad", 1e-5, 1.0),
        ("velocity", nav.velocity_world, nav.sigma_velocity, "m/s", 1e-4, 20.0),
    )
    for what, values, sigma, unit, least, most in table:
        there = np.isfinite(values).all(axis=1)
        if not there.any():
            continue
        stated = np.isfinite(sigma[there]).all(axis=1)
        middle = float(np.median(sigma[there][stated])) if stated.any() else float("nan")
        words.append(f"{what} {middle:.3g} {unit}" if stated.any() else f"{what} without sigma")
        if stated.mean() < 0.5:
            faults.append(f"write the sigma of the {what}")
        elif not least < middle < most:
            faults.append(f"write the sigma of the {what} in {unit}, 1-sigma, as the receiver states it")
    return bad(name, ", ".join(words), "; ".join(faults)) if faults else good(name, ", ".join(words))
