"""Rows of the recordings beside the project: the rendered flight with its truth, the photos with their reference."""

from __future__ import annotations

import math
import os
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from heights_matchers import mapped
from heights_points import BAD, LEAST, OPEN, Answer, Mask, percent
from heights_table import KEPT, Row, kept
from heights_unflagged import DEEP, OF_GIVEN, WITH_TERRAIN, Ground, mapped_by_all, through
from matchers import by_pair, inside
from scipy.spatial import cKDTree
from subjects import Subject, flight, photos

from alight.arrays import F64
from alight.evaluation.photos import interpolated, plane_of
from alight.records import ElevationMap, Flag, View
from alight.settings import Settings
from alight.spread import nmad

DATA = Path(os.environ.get("ALIGHT_DATA", Path(__file__).parents[2] / "shared" / "data"))
OWN_NOISE = 0.028  # metres, of the reference's points
BESIDE = 0.05, 0.2  # metres between points that are compared with one another: not one feature twice
PAIR = 5.0  # metres between photos that follow each other, at most: a strip ends
LEAST_GAP = 0.02  # of the height between exposures that the lane is given
Numbers = dict[str, float]


def sample_rows() -> list[Row]:
    """Rows of the rendered flight with true poses."""
    if not (DATA / "sample").is_dir():
        return [Row("sample flight: no ../shared/data/sample", math.nan, 0.0)]
    out = []
    for method, found in kept("sample", _sample).items():
        out += [
            Row(f"sample, {method}: ground NMAD, % of height", found["nmad"], 0.15, 0.10),
            Row(f"sample, {method}: ground P95, m", found["p95"], 0.12, 0.08),
            Row(f"sample, {method}: ground accepted of seen, %", found["accepted"], (80, math.inf), (90, math.inf)),
            Row(f"sample, {method}: ground within 1.96 sigma, %", found["95 %"]),
            Row(f"sample, {method}: off > 0.5 m on the pond, % of given out", found["pond"]),
            Row("... after the terrain stage", found["pond after"], 1.0, 0.1),
            Row(f"sample, {method}: pond given out, %", found["pond given"]),
        ]
    return out


def _spread(views: list[list[View]], above: float) -> list[list[View]]:
    """Exposures far enough apart to be keyframes."""
    out = views[:1]
    for shot in views[1:]:
        if np.linalg.norm(shot[0].centre - out[-1][0].centre) >= LEAST_GAP * above:
            out.append(shot)
    return out


def _sample() -> dict[str, Numbers]:
    subject = flight("sample", DATA / "sample")
    assert subject.truth is not None
    truth = subject.truth
    shots = subject.exposures()
    above = subject.above([s[0] for s in shots])
    ground = Ground(subject.surface(), truth.label, truth.grid)
    shots = _spread(shots, above)
    return {m: _against(mapped_by_all(shots, m), ground, above) for m in ("batch", "ring")}


def _against(found: ElevationMap, ground: Ground, above: float) -> Numbers:
    height, label = ground.at(found.grid)
    seen = np.isfinite(height) & ((found.flags & np.uint16(Flag.UNSEEN)) == 0) & np.isin(label, OPEN)
    given = seen & found.trusted
    e = found.height[given] - height[given]
    water = through(found, ground, DEEP, water=True)
    return {
        "nmad": 100 * nmad(e) / above,
        "p95": float(np.percentile(np.abs(e), 95)),
        "accepted": 100 * float(given.sum() / seen.sum()),
        "95 %": percent(np.abs(e - np.median(e)) < 1.96 * found.sigma[given]),
        "pond": water[OF_GIVEN],
        "pond after": water[WITH_TERRAIN],
        "pond given": water["given out"],
    }


def photo_rows() -> list[Row]:
    """Rows of the photos with the poses and the lens of their reference, less a plane."""
    if not (DATA / "mirafiori").is_dir():
        return [Row("photos: no ../shared/data/mirafiori", math.nan, 0.0)]
    found = kept("photos", _photos)
    theirs = found["rough SGBM"]
    out = [
        Row("photos, batch: NMAD on accepted cells, m", found["nmad"], 0.045, 0.035),
        Row("photos, batch: P95, m", found["p95"], 0.16, 0.12),
        Row("photos, batch: accepted of cells seen by three, %", found["accepted"], (60, math.inf), (70, math.inf)),
        Row("photos, batch: off > 1 % of height and given out, % of all points", found["wrong"], 0.8, 0.3),
        Row("photos: NMAD of the ring over the batch's, points that both give out", found["ring/batch"], 1.15),
        Row("photos: the same, cells that both have, given out or not", found["ring/batch, all"]),
        Row("photos: rough points off > 0.5 m where SGBM's pair has a height, batch, %", found["rough"], theirs),
        Row("... SGBM", theirs),
        Row("... where SGBM is sure, batch", found["rough sure"], found["rough SGBM sure"]),
        Row("... SGBM", found["rough SGBM sure"]),
    ]
    for n in (2, 8, 12):
        name = f"photos: within 1.96 sigma (0.028 m added), {n} views a cell, %"
        out.append(Row(name, found[f"within {n}"], (93, 97), (93, 97)))
    near, far = BESIDE
    name = f"... points of open ground {near} to {far} m apart, as near to one another as 0.028 m each allows, %"
    return [*out, Row(name, found["points alone"])]


@cache
def _subject() -> Subject:
    return photos("mirafiori", DATA / "mirafiori", KEPT / "reference")


def _matched(views: list[View], method: str, most: int | None = None) -> ElevationMap:
    parallax = {} if most is None else {"parallax": {"views": most}}
    found = mapped([[v] for v in views], method, len(views), Settings.model_validate(parallax))
    assert found is not None
    return found


def _at(found: ElevationMap, xyz: F64) -> Answer:
    """Heights and sigma at the reference's points; the error less a plane stands in for the height."""
    e, n = xyz[:, 0], xyz[:, 1]
    given = interpolated(np.where(found.trusted, found.height, np.nan), found.grid, e, n)
    height = interpolated(found.height, found.grid, e, n)
    error = height - xyz[:, 2]
    use = np.flatnonzero(np.isfinite(given))
    plane, _ = plane_of(xyz[use], error[use])
    sigma = interpolated(found.sigma, found.grid, e, n)
    return Answer(error - np.c_[xyz[:, :2], np.ones(len(xyz))] @ plane, sigma, np.isfinite(given))


def _photos() -> Numbers:
    subject = _subject()
    views = subject.views()
    above = subject.above(views)
    points = subject.points(views, above)
    batch, ring = (_matched(views, m) for m in ("batch", "ring"))
    one, two = _at(batch, points.xyz), _at(ring, points.xyz)
    seen = (batch.flags & np.uint16(Flag.UNSEEN | Flag.FEW)) == 0
    off, both = one.height[one.given], one.given & two.given
    have = np.isfinite(one.height) & np.isfinite(two.height)
    out = {
        "nmad": nmad(off),
        "p95": float(np.percentile(np.abs(off), 95)),
        "accepted": 100 * float(batch.trusted[seen].mean()),
        "wrong": 100 * float((np.abs(off) > 0.01 * above).sum() / len(points.xyz)),
        "ring/batch": nmad(two.height[both]) / nmad(one.height[both]),
        "ring/batch, all": nmad(two.height[have]) / nmad(one.height[have]),
    }
    out |= _rough(views, points.xyz, ~points.open, one)
    out["points alone"] = _alike(points.xyz[points.open])
    return out | {f"within {n}": _within(_at(_matched(views, "batch", n), points.xyz)) for n in (2, 8, 12)}


def _within(a: Answer) -> float:
    total = np.hypot(a.sigma[a.given], OWN_NOISE)
    return percent(np.abs(a.height[a.given]) < 1.96 * total)


def _alike(xyz: F64) -> float:
    """Percent of neighbouring points whose heights differ by no more than their own noise allows."""
    pairs = cKDTree(xyz[:, :2]).query_pairs(BESIDE[1], output_type="ndarray")
    apart = xyz[pairs[:, 0]] - xyz[pairs[:, 1]]
    some = np.linalg.norm(apart[:, :2], axis=1) > BESIDE[0]
    return percent(np.abs(apart[some, 2]) < 1.96 * OWN_NOISE * math.sqrt(2))


def _rough(views: list[View], xyz: F64, rough: Mask, ours: Answer) -> Numbers:
    """Share of rough points off by more than `BAD`, on photos that follow each other where StereoSGBM has a height.

    `sure`: where it passes its own checks.
    """
    mine, theirs, passed = [], [], []
    for a, b in pairwise(views):
        if np.linalg.norm(a.centre - b.centre) > PAIR:
            continue
        k = np.flatnonzero(rough & inside(a, xyz) & inside(b, xyz) & np.isfinite(ours.height))
        if len(k) < LEAST:
            continue
        height, sure = by_pair(a, b, xyz[k])
        use = np.isfinite(height)
        mine.append(np.abs(ours.height[k][use]) > BAD)
        theirs.append(np.abs(height[use] - xyz[k, 2][use]) > BAD)
        passed.append(sure[use])
    m, t, s = np.concatenate(mine), np.concatenate(theirs), np.concatenate(passed)
    return {
        "rough": percent(m), "rough SGBM": percent(t), "rough sure": percent(m[s]), "rough SGBM sure": percent(t[s]),
    }  # fmt: skip
