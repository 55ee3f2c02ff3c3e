"""All checks of one recording, in the order in which they depend on each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from alight.checks.evidence import RigEvidence, gather_evidence
from alight.checks.motion import check_motion
from alight.checks.navigation import check_navigation
from alight.checks.pictures import check_exposure, check_intrinsics, check_lens, check_sharpness
from alight.checks.result import CheckResult, Judged, unknown
from alight.checks.sight import SightCheck
from alight.checks.stamps import check_frames, check_rows
from alight.checks.stereo import check_stereo
from alight.settings import Settings
from alight.sources import Source


def check_source(
    source: Source,
    settings: Settings,
    seconds: float = 10.0,
    start: float = 0.0,
    progress: Callable[[float], None] = lambda share: None,
) -> list[CheckResult]:
    """Check the rig of a flight log or a recording and return the result of each check.

    Args:
        settings: settings of the planned run.
        seconds: length of the part that is read.
        start: begin of that part, s from the first exposure.
        progress: called with the share that is done.

    Raises:
        InputError: there is no exposure in that part of the recording.
    """
    noise = getattr(source, "imu_noise", None)  # events of another program may come without
    sight = SightCheck(source.rig, settings.stages(noise), seconds, start)
    found = gather_evidence(source.rig, sight.watch(source.events()), seconds, start, progress)
    promised = tuple(name for key, name in (("nav", "GPS/INS"), ("imu", "IMU")) if source.notes.get(key))
    ahead = -((source.notes.get("timeshift_cam_imu") or [0.0])[0] or 0.0)
    results = check_evidence(replace(found, warnings=tuple(source.warnings), promised=promised, ahead=ahead))
    return [*results, sight.result]


def check_evidence(evidence: RigEvidence) -> list[CheckResult]:
    """Run every check on the evidence; return one result per check."""
    pictures = [check_exposure(evidence), check_sharpness(evidence), check_lens(evidence), check_intrinsics(evidence)]
    navigation = check_navigation(evidence)
    # a wrong accelerometer does not prevent the comparison of pictures with GPS/INS and IMU, which does not use it
    wrong = (r.name for r in navigation if r.verdict is Judged.BAD and r.name != "accelerometer unit")
    motion, flow = check_motion(evidence, next(wrong, ""))
    (first, _), *others = evidence.by_camera
    if not others:
        rig = [unknown("stereo", "one camera only")]
    elif motion[0].verdict is Judged.BAD:
        rig = [unknown("stereo", "first mend the mounting")]
    else:
        rig = [check_stereo(first, other, seen.matches, flow) for other, seen in others]
    return [check_frames(evidence), *check_rows(evidence), *pictures, *rig, *navigation, *motion]
