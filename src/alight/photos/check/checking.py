"""All checks of a set of photos, and the verdict whether a run can use them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable

import numpy as np

from alight.checks.picture_quality import Brightness
from alight.checks.result import Check, CheckResult, Judged, bad, good, unknown, warning
from alight.hazards.detection import read_detection
from alight.hazards.factors import pixel_that_settles
from alight.photos.check.evidence import PhotoEvidence, coverage, gather_photos
from alight.photos.reading.photos import Photos
from alight.settings import Settings

CPU_A_MEGAPIXEL = 1.0  # s of CPU time per megapixel of a run (docs/lab/photos.md)


def check_photos(
    source: Photos, settings: Settings, progress: Callable[[float], None] = lambda share: None
) -> list[CheckResult]:
    """Check whether photos are suitable, by their tags and a sample of their pictures; the verdict is last.

    Args:
        source: the photos.
        settings: settings of the planned run.
        progress: called with the completed share.
    """
    found, wrong = gather_photos(source, progress), source.findings.contradictions
    reading = [bad("reading", w, "remove the wrong tags") if w in wrong else warning("reading", w, "")
               for w in source.warnings]  # fmt: skip
    results = [
        judge_set(found), judge_focal(found), judge_positions(found), judge_heights(found), judge_attitude(found),
        judge_exposure(found), judge_sharpness(found), judge_overlap(found), judge_resolution(found, settings),
        *reading, estimate(found, settings),
    ]  # fmt: skip
    return [*results, verdict(results)]


def judge_set(found: PhotoEvidence) -> CheckResult:
    """Judge the number, size and kind of the pictures, and report unused pictures."""
    notes, used = found.source.notes, len(found.exposures)
    left_out = [p for p in found.source.photos if p.left_out]
    cameras = notes.get("cameras") or [notes["camera"]]
    check = Check("pictures", [f"{used} of {used + len(left_out)} are used", *(f"{c}" for c in cameras)])
    check.measured += [f"{n} left out: {why}" for why, n in Counter(p.left_out for p in left_out).items()][:3]
    check.measured += [f"levels {notes['levels']}"] if "levels" in notes else []
    check.judge(
        (
            bool(found.unread),
            "copy the damaged ones again",
            f"of a sample, cannot be read: {'; '.join(found.unread[:3])}",
        ),
        (used < 3, "give more photos: a height needs two views, a good one five"),
    )
    return check.result


def judge_focal(found: PhotoEvidence) -> CheckResult:
    """Judge the source of the focal length; `judge_heights` checks whether the pictures confirm it."""
    notes = found.source.notes
    facts = f"{notes['focal_px']:.0f} px, {notes['focal_from']}"
    facts += f"; {notes['focal_note']}" if "focal_note" in notes else ""
    if "guess" in notes["focal_from"]:
        return warning("focal length", facts, "give the camera's calibration")
    return good("focal length", facts)


def judge_positions(found: PhotoEvidence) -> CheckResult:
    """Judge whether all photos have positions; report the kinds of GPS fix and the 1-sigma of the positions."""
    notes, lack = found.source.notes, int((~np.isfinite(found.centres).all(axis=1)).sum())
    kinds = ", ".join(f"{n} {kind}" for kind, n in notes["gps"].items())
    east, north, up = notes["position_sigma"]
    evidence = f"{kinds}; 1-sigma {east:g} m east, {north:g} m north, {up:g} m up; by {notes['positions_from']}"
    if lack:
        return warning("positions", f"{evidence}; {lack} photos have none", "write their places into geo.txt")
    return good("positions", evidence)


def judge_heights(found: PhotoEvidence) -> CheckResult:
    """Compare the height above take-off by tags with the height above ground by focal length and baseline."""
    counted, tagged, seen = found.source.notes["heights_count_from"], found.above, found.measured
    check = Check("heights", [f"altitudes count from: {counted}"], incomplete="not declared" in counted)
    if np.isfinite(tagged).any():
        check.measured.append(f"{np.nanmedian(tagged):.0f} m above take-off by the tags")
    if not np.isfinite(seen):
        check.incomplete = True
        check.measured.append("matched pairs do not give the height above ground")
        return check.result
    check.measured.append(f"{seen:.0f} m above ground by the shift of matched pairs")
    if np.isfinite(tagged).any() and np.nanmedian(tagged) > 0:
        ratio = seen / float(np.nanmedian(tagged))
        check.judge(
            (
                not 1 / 1.5 < ratio < 1.5,
                "give the true focal length, unless take-off was as much above or below the ground of the photos",
                f"that is {ratio:.2f} times as much",
            )
        )
    return check.result


def judge_attitude(found: PhotoEvidence) -> CheckResult:
    """Judge where the cameras looked, and report the source of the attitudes."""
    kinds = ", ".join(f"{n} {kind or 'none'}" for kind, n in found.source.notes["attitude_from"].items())
    if not np.isfinite(found.down).any():
        return unknown("attitude", f"{kinds}: whether the cameras looked down follows from the pictures in a run")
    off = np.degrees(np.arccos(np.clip(found.down[np.isfinite(found.down)], -1, 1)))
    evidence = (
        f"{kinds}; optical axes {np.median(off):.0f} degrees from straight down, one in ten more than "
        f"{np.percentile(off, 90):.0f}"
    )
    if np.median(off) > 30:  # no fault, since a run drops tags that the pictures contradict
        return warning(
            "attitude", evidence, "point the camera down, or up to 30 degrees off, unless the tags are wrong"
        )
    return good("attitude", evidence)


def judge_exposure(found: PhotoEvidence) -> CheckResult:
    """Judge whether the sampled pictures are saturated, black or flat."""
    if not found.brightness:
        return unknown("exposure", "no picture of the sample can be read")
    light = Brightness(*np.median(np.array(found.brightness), axis=0))
    check = Check("exposure", [
        f"mean grey {light.mean:.0f}, contrast {light.contrast:.0f}, {100 * light.saturated:.1f} % saturated, "
        f"{100 * light.black:.1f} % black, of {len(found.brightness)} pictures"
    ])  # fmt: skip
    check.judge(
        (light.saturated > 0.15, "over-exposed: shorten the exposure"),
        (light.black > 0.4, "under-exposed: lengthen the exposure"),
        (light.contrast < 15.0, "hardly any contrast: fog, or a dirty lens"),
    )
    return check.result


def judge_sharpness(found: PhotoEvidence) -> CheckResult:
    """Judge focus and motion blur by the width of the sharpest edges, which is 1.8 to 3 px in good pictures."""
    known = found.edges[np.isfinite(found.edges).all(axis=1)]
    if len(known) < 3:
        return unknown("sharpness", "too few edges in the pictures")
    widths = known.max(axis=1)
    worst = float(np.max(widths))
    evidence = (
        f"the sharpest edges are {np.median(widths):.1f} px wide, {worst:.1f} px in the worst of {len(widths)} pictures"
    )
    if np.median(widths) > 4.5:
        return bad("sharpness", evidence, "focus at the flying height and lock it, shorten the exposure or fly slower")
    if worst > 4.5:
        return warning("sharpness", evidence, "take blurred pictures away")
    return good("sharpness", evidence)


def judge_overlap(found: PhotoEvidence) -> CheckResult:
    """Judge the overlap by matched neighbours or, without matches, by positions, height and field of view."""
    check, matched = Check("overlap"), [p.overlap for p in found.pairs if p.matches]
    along = float(np.nanmedian(matched)) if np.isfinite(matched).any() else float("nan")
    cover = coverage(found, found.height) if found.height > 0 else None
    if cover is not None and len(cover.along):
        by_tags, views = float(np.median(cover.along)), int(np.median(cover.views))
        along = along if np.isfinite(along) else by_tags
        check.measured.append(f"{100 * by_tags:.0f} % with the next photo, ground seen by {views} photos (by the tags)")
        check.judge((views < 3, "fly strips closer to each other: a good height needs five views"))
    share = f", {100 * along:.0f} % overlap" if matched else ""
    check.measured.append(f"{len(matched)} of {len(found.pairs)} pairs of neighbours match{share} (by the pictures)")
    check.incomplete = not found.pairs
    check.judge(
        (along < 0.6, "take photos closer to each other: two thirds of one must be in the next"),
        (
            2 * len(matched) < len(found.pairs),
            "photos that do not match give no heights: more overlap, sharper pictures",
        ),
    )
    return check.result


def judge_resolution(found: PhotoEvidence, settings: Settings) -> CheckResult:
    """Judge whether a pixel on the ground is small enough to exclude obstacles beyond the lander's limits."""
    height, stages = found.height, settings.stages()
    enough = pixel_that_settles(read_detection(), stages.lander, stages.hazards)
    tallest = stages.lander.tallest_obstacle
    if not np.isfinite(height) or height <= 0:
        return unknown("resolution", "the height above ground is not known")
    focal = float(np.median([found.source.rig.cameras[e.camera].camera.fu for e in found.exposures]))
    pixel = height / focal
    evidence = f"a pixel is {100 * pixel:.1f} cm on the ground from {height:.0f} m"
    need = f"obstacles of {100 * tallest:.0f} cm need {100 * enough:.1f} cm"
    if pixel <= enough:
        return good("resolution", f"{evidence}; {need}")
    remedy = f"fly at {enough * focal:.0f} m, or land a vehicle whose limits allow more (lander.max_roughness)"
    return warning("resolution", f"{evidence}; {need}: bare ground alone will not be surely free of them", remedy)


def estimate(found: PhotoEvidence, settings: Settings) -> CheckResult:
    """Estimate the time, memory and disk space of a run from the number of photos and pixels."""
    n, cores = len(found.exposures), os.cpu_count() or 1
    megapixels = sum(e.tags.size[0] * e.tags.size[1] for e in found.exposures) / 1e6
    minutes = CPU_A_MEGAPIXEL * megapixels / 60
    memory = 1e-3 * settings.parallax.store_mb + 1.0 + 2 * 8e-9 * (6 * n) ** 2
    return good(
        "estimate",
        f"a run takes about {max(minutes, 1):.0f} min of CPU time ({max(minutes / cores, 1):.0f} on {cores} cores), "
        f"{memory:.1f} GB of memory and {1e-3 * n:.1f} GB of disk, within a factor of two",
    )


def verdict(results: list[CheckResult]) -> CheckResult:
    """Summarise all checks: whether the photos are suitable."""
    wrong, doubtful = (
        list(dict.fromkeys(r.name for r in results if r.verdict is kind)) for kind in (Judged.BAD, Judged.WARNING)
    )
    if wrong:
        return bad("verdict", f"something is wrong or contradicts: {', '.join(wrong)}", "mend these before a run")
    if doubtful:
        return warning("verdict", f"the photos will do, with warnings about: {', '.join(doubtful)}", "")
    return good("verdict", "the photos will do")
