"""`alight check`: a good rig passes, and each fault that is put into its events is named, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest
from length import first
from scipy.spatial.transform import Rotation

import alight
from alight.arrays import F64, U8
from alight.checks.checking import check_evidence
from alight.checks.evidence import ImuTable, NavTable, RigEvidence, gather_evidence
from alight.checks.result import CheckResult, Judged
from alight.cli import call
from alight.geometry import Camera, Pose, so3_exp
from alight.records import Event, Frame, InputError, NavSample, Rig, RigCamera
from alight_sim import SimulatedFlight, default_rig, fly
from alight_sim.patterns import FlightPlan

LENSES = (Camera(240, 180, 180.0, 180.0, 119.8, 89.6), Camera(240, 180, 181.0, 180.8, 120.9, 88.4))
SECONDS, BRIEF = 6.0, 3.5  # of the flight, and of it where little is enough
FRD = np.diag([1.0, -1.0, -1.0])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@cache
def flight() -> SimulatedFlight:
    """A flight along parallel lines, 15 m above the demo's meadow, two cameras of 240 x 180, wind and gusts."""
    rig = Rig(tuple(RigCamera(c.name, m, c.body_from_cam) for c, m in zip(default_rig().cameras, LENSES, strict=True)))
    plan = FlightPlan(pattern="lawn_mower", length=12.0, lines=3, spacing=8.0, height=15.0)
    return fly("demo", 1, plan=plan, rig=rig, rate_hz=8.0)


@cache
def events() -> tuple[Event, ...]:
    """Events of the first seconds of the flight."""
    out = list[Event]()
    for event in flight().events():
        if isinstance(event, Frame) and event.t_ns > 1_700_000_000_000_000_000 + SECONDS * 1e9:
            break
        out.append(event)
    return tuple(out)


@cache
def evidence() -> RigEvidence:
    """Evidence of the checks from these events."""
    return gather_evidence(flight().rig, events(), SECONDS)


def frames(change: Callable[[int, Frame], Frame]) -> list[Event]:
    """Return the events with changed frames."""
    out, count = list[Event](), 0
    for event in events():
        out.append(change(count, event) if isinstance(event, Frame) else event)
        count += isinstance(event, Frame)
    return out


def pictures(change: Callable[[int, U8], U8 | None], camera: int | None = None) -> list[Event]:
    """Return the events with every picture changed, or with those of one camera."""

    def changed(count: int, frame: Frame) -> Frame:
        images = (
            image if image is None or camera not in (None, k) else change(count, image)
            for k, image in enumerate(frame.images)
        )
        return replace(frame, images=tuple(images))

    return frames(changed)


def one_camera(change: Callable[[int, U8], U8 | None], seconds: float = BRIEF) -> list[CheckResult]:
    """Check camera 0 alone, with changed pictures."""
    alone = [replace(e, images=e.images[:1]) if isinstance(e, Frame) else e for e in pictures(change, 0)]
    return check_evidence(gather_evidence(Rig(flight().rig.cameras[:1]), alone, seconds))


def rig_with(*turns: tuple[int, Sequence[float]], swap: str = "") -> Rig:
    """Return the rig with the calibration of cameras turned by rotation vectors about their own axes, rad."""
    cameras = list(flight().rig.cameras)
    for k, turn in turns:
        pose = cameras[k].body_from_cam
        cameras[k] = replace(cameras[k], body_from_cam=Pose(pose.rotation @ so3_exp(turn), pose.translation))
    if swap == "places":
        a, b = cameras
        cameras = [
            replace(a, body_from_cam=Pose(a.body_from_cam.rotation, b.body_from_cam.translation)),
            replace(b, body_from_cam=Pose(b.body_from_cam.rotation, a.body_from_cam.translation)),
        ]
    return Rig(tuple(cameras))


def wrong(results: Sequence[CheckResult]) -> dict[str, CheckResult]:
    """Return the checks that found a fault, by name."""
    return {r.name: r for r in results if r.verdict is Judged.BAD}


def only(results: Sequence[CheckResult], name: str) -> CheckResult:
    """Assert that one check alone found a fault, and names a remedy; return its result."""
    assert list(wrong(results)) == [name], [r.line for r in wrong(results).values()]
    assert wrong(results)[name].mend
    return wrong(results)[name]


def with_imu(rates: F64 | float = 1.0, forces: F64 | float = 1.0, axes: F64 | None = None) -> RigEvidence:
    """Return the evidence with another IMU."""
    imu, axes = evidence().imu, np.eye(3) if axes is None else axes
    return replace(
        evidence(),
        imu=ImuTable(
            imu.t_ns, imu.angular_velocity_body * rates @ axes.T, imu.specific_force_body * forces @ axes.T
        ),
    )  # fmt: skip


def with_nav(**columns: Any) -> RigEvidence:
    """Return the evidence with other columns of GPS/INS."""
    return replace(evidence(), nav=replace(evidence().nav, **columns))


# -- a good rig


def test_a_good_rig_passes_every_check() -> None:
    found = {r.name: r for r in check_evidence(evidence())}
    assert {r.verdict for r in found.values()} == {Judged.GOOD}, [r.line for r in found.values() if r.verdict != "good"]
    assert {"stereo cam0 cam1", "time offset", "mounting", "focal length", "lens and view", "IMU axes"} <= set(found)


def test_one_camera_without_imu_and_gps_cannot_tell_and_accuses_nobody() -> None:
    rig = Rig(flight().rig.cameras[:1])
    alone = [replace(e, images=e.images[:1]) for e in events() if isinstance(e, Frame)]
    found = {r.name: r for r in check_evidence(gather_evidence(rig, alone, SECONDS))}
    assert not wrong(list(found.values()))
    for name in ("stereo", "time offset", "mounting", "focal length", "IMU axes", "GPS/INS in time"):
        assert found[name].verdict is Judged.UNKNOWN
        assert found[name].evidence


def test_a_rig_without_imu_passes() -> None:
    nothing = ImuTable.of([])
    found = check_evidence(replace(evidence(), imu=nothing))
    assert not wrong(found)
    assert {r.name: r for r in found}["time offset"].verdict is Judged.GOOD


def test_a_flight_straight_on_does_not_claim_to_know_the_time_offset() -> None:
    """Without turns the pictures move alike at all times, so that the time offset is not observable."""
    nav, imu = evidence().nav, evidence().imu
    calm = NavTable.of(
        [
            NavSample(
                int(t), np.array([4.0 * 1e-9 * float(t - nav.t_ns[0]), 0.0, 15.0]), np.eye(3), np.array([4.0, 0, 0])
            )
            for t in nav.t_ns
        ]
    )
    still = replace(
        imu, angular_velocity_body=np.zeros_like(imu.angular_velocity_body),
        specific_force_body=np.tile([0.0, 0.0, 9.81], (len(imu.t_ns), 1)),
    )  # fmt: skip
    steady = evidence().cameras[0]
    step = 4.0 * 0.125 / 15.0
    H = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, step], [0.0, 0.0, 1.0]])
    steady = replace(steady, flows=[replace(f, homography=H) for f in steady.flows])
    rig = Rig((replace(flight().rig.cameras[0], body_from_cam=Pose(NADIR)),))
    present = evidence().present[:, :1]
    one = replace(evidence(), rig=rig, cameras=(steady,), present=present, nav=calm, imu=still)
    found = {r.name: r for r in check_evidence(one)}
    assert found["mounting"].verdict is Judged.GOOD, found["mounting"]
    assert found["time offset"].verdict is Judged.UNKNOWN, found["time offset"]
    assert found["gyroscope unit"].verdict is Judged.UNKNOWN


NADIR = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


# -- cameras against each other


def test_exchanged_cameras_are_named() -> None:
    swapped = gather_evidence(flight().rig, frames(lambda _, f: replace(f, images=f.images[::-1])), BRIEF)
    found = only(check_evidence(swapped), "stereo cam0 cam1")
    assert "exchange the folders" in found.mend
    assert "sign" not in found.mend


def test_a_baseline_of_the_wrong_sign_is_named() -> None:
    found = only(check_evidence(replace(evidence(), rig=rig_with(swap="places"))), "stereo cam0 cam1")
    assert "sign of the translation" in found.mend
    assert "exchange" not in found.mend


@pytest.mark.parametrize(("axis", "word"), [(0, "pitch +15"), (2, "roll +15")])
def test_a_turned_second_camera_is_measured(axis: int, word: str) -> None:
    turn = np.zeros(3)
    turn[axis] = -0.015  # of the calibration: the camera itself stands turned by +15 mrad against it
    found = only(check_evidence(replace(evidence(), rig=rig_with((1, turn)))), "stereo cam0 cam1")
    numbers = dict(part.split()[-2:] for part in found.evidence.split("turned by ")[1].split(" mrad")[0].split(", "))
    assert float(numbers[word.split()[0]]) == pytest.approx(15.0, abs=1.0)


def test_cameras_that_look_past_each_other_are_found_by_their_depths() -> None:
    """A turn about the vertical moves the matches along their epipolar lines: it shows in their depths only."""
    found = only(check_evidence(replace(evidence(), rig=rig_with((1, (0.0, 0.015, 0.0))))), "stereo cam0 cam1")
    assert "turned towards each other" in found.evidence


# -- clocks


@pytest.mark.parametrize("offset", [0.06, -0.12])
def test_a_time_offset_is_measured(offset: float) -> None:
    late = int(offset * 1e9)  # camera stamps ahead: GPS/INS and IMU behind
    e = evidence()
    moved = replace(e, nav=replace(e.nav, t_ns=e.nav.t_ns - late), imu=replace(e.imu, t_ns=e.imu.t_ns - late))
    found = only(check_evidence(moved), "time offset")
    told = float(found.mend.split("time_offset=")[1].split(",")[0])
    assert told == pytest.approx(offset, abs=0.006)


def test_rows_of_gps_that_come_late_are_measured() -> None:
    e = evidence()
    found = {r.name: r for r in check_evidence(replace(e, nav=replace(e.nav, t_ns=e.nav.t_ns + 100_000_000)))}
    clock = wrong(list(found.values()))["clock of GPS/INS against IMU"]
    assert float(clock.evidence.split("are ")[1].split()[0]) == pytest.approx(100.0, abs=8.0)
    assert found["time offset"].verdict is Judged.UNKNOWN


def test_clocks_that_do_not_meet_are_named() -> None:
    nothing = NavTable.of([])
    found = wrong(check_evidence(replace(evidence(), nav=nothing, promised=("GPS/INS",))))
    assert list(found) == ["GPS/INS in time"]


# -- mounting and lens


@pytest.mark.parametrize(("turn", "words"), [((0, 0, np.pi / 2), "-90 degrees"), ((0, 0, np.pi), "180 degrees")])
def test_a_rig_that_is_mounted_turned_is_named(turn: tuple[float, float, float], words: str) -> None:
    turned = replace(evidence(), rig=rig_with((0, turn), (1, turn)))
    found = only(check_evidence(turned), "mounting")
    assert found.evidence.count(f"{words} about its optical axis") == 2


def test_one_camera_that_is_mounted_turned_is_named() -> None:
    found = only(check_evidence(replace(evidence(), rig=rig_with((1, (0, 0, np.pi))))), "mounting")
    assert "cam1 is turned by 180 degrees about its optical axis" in found.evidence
    assert "cam0 is turned" not in found.evidence


def test_a_mounting_that_is_off_by_ten_degrees_is_measured() -> None:
    turn = (0.0, 0.0, np.radians(10.0))
    found = only(check_evidence(replace(evidence(), rig=rig_with((0, turn), (1, turn)))), "mounting")
    assert "roll -10." in found.evidence or "roll -9." in found.evidence


@cache
def long_lens() -> RigEvidence:
    cameras = tuple(
        replace(c, camera=replace(c.camera, fu=c.camera.fu * 1.08, fv=c.camera.fv * 1.08)) for c in flight().rig.cameras
    )
    return gather_evidence(Rig(cameras), events(), SECONDS)


def test_a_focal_length_that_is_off_is_measured() -> None:
    found = only(check_evidence(long_lens()), "focal length")
    assert "-7." in found.evidence or "-8." in found.evidence


def test_one_focal_length_that_is_off_shows_in_the_matches() -> None:
    """The second camera alone is wrong; its flow and the matches between the cameras show this."""
    e = evidence()
    rig = Rig((e.rig.cameras[0], long_lens().rig.cameras[1]))
    half = replace(e, rig=rig, cameras=(e.cameras[0], long_lens().cameras[1]))
    found = wrong(check_evidence(half))
    assert set(found) <= {"focal length", "stereo cam0 cam1"}
    assert "focal length -7" in found["stereo cam0 cam1"].evidence


def test_a_principal_point_far_from_the_middle_is_named() -> None:
    cameras = list(evidence().rig.cameras)
    cameras[0] = replace(cameras[0], camera=replace(cameras[0].camera, cu=70.0))
    found = wrong(check_evidence(replace(evidence(), rig=Rig(tuple(cameras)))))
    assert "intrinsics" in found


# -- IMU and GPS/INS


@pytest.mark.parametrize(
    ("changed", "name", "word"),
    [
        (lambda: with_imu(rates=57.2958), "gyroscope unit", "0.01745"),
        (lambda: with_imu(forces=1 / 9.80665), "accelerometer unit", "9.80665"),
        (lambda: with_imu(axes=FRD), "IMU axes", "T_BS of imu0"),
        (lambda: with_imu(axes=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])), "IMU axes", "T_BS of imu0"),
        (lambda: with_nav(world_from_body=read_as_xyzw()), "attitude convention", "q_w first"),
        (
            lambda: with_nav(world_from_body=NED @ evidence().nav.world_from_body @ FRD),
            "attitude convention",
            "enu_from",
        ),
        (
            lambda: with_nav(velocity_world=evidence().nav.velocity_world @ NED.T),
            "velocity of GPS/INS",
            "v_e, v_n, v_u",
        ),
        (lambda: with_nav(velocity_world=evidence().nav.velocity_world * 3.6), "velocity of GPS/INS", "m/s"),
        (lambda: with_nav(sigma_position=evidence().nav.sigma_position * np.nan), "sigmas of GPS/INS", "position"),
    ],
    ids=["deg/s", "g", "FRD", "yawed", "x y z w", "NED", "velocity NED", "km/h", "no sigma"],
)
def test_wrong_units_and_axes_are_named(changed: Callable[[], RigEvidence], name: str, word: str) -> None:
    assert word in only(check_evidence(changed()), name).mend


def read_as_xyzw() -> F64:
    """Attitudes from a log that has the real part of the quaternion last, read as if it were first."""
    x, y, z, w = Rotation.from_matrix(evidence().nav.world_from_body).as_quat().T
    return Rotation.from_quat(np.stack([y, z, w, x], axis=-1)).as_matrix()  # read as w = x, x = y, y = z, z = w


# -- pictures


def brighter(_: int, image: U8) -> U8:
    return np.clip(image.astype(np.float64) * 3.5, 0, 255).astype(np.uint8)


def spotted(_: int, image: U8) -> U8:
    """Draw a crumb, 20 px wide, and a thumb in the corner."""
    out = image.copy()
    cv2.circle(out, (150, 60), 10, (60, 55, 50), -1)
    cv2.rectangle(out, (0, 150), (40, 180), (20, 20, 25), -1)
    return out


def wet(_: int, image: U8) -> U8:
    """Blur a part of the picture, as a drop of water does."""
    out = image.copy()
    out[40:75, 160:200] = cv2.GaussianBlur(image, (0, 0), 6.0)[40:75, 160:200]
    return out


def test_over_exposure_is_named() -> None:
    found = wrong(one_camera(brighter))
    assert "over-exposed" in found["exposure"].mend
    assert list(found) == ["exposure"]


def test_dirt_is_named_with_its_place() -> None:
    found = only(check_evidence(gather_evidence(flight().rig, pictures(spotted, 0), BRIEF)), "lens and view")
    assert "cam1: nothing stands still" in found.evidence
    boxes = [[int(n) for n in part.replace(",", "").split() if n.isdigit()] for part in found.evidence.split("u ")[1:]]
    assert any(130 <= (a + b) / 2 <= 170 and 40 <= (c + d) / 2 <= 80 for a, b, c, d, *_ in boxes), found.evidence


def test_a_drop_on_the_lens_is_named() -> None:
    found = only(one_camera(wet, SECONDS), "lens and view")
    assert "blurred" in found.evidence


def test_lost_focus_is_named() -> None:
    found = wrong(one_camera(lambda _, image: cv2.GaussianBlur(image, (0, 0), 3.0)))
    assert list(found) == ["sharpness"]
    assert "cam0 is out of focus" in found["sharpness"].mend


def test_missing_partners_are_named() -> None:
    gone = pictures(lambda count, image: None if count % 3 == 0 else image, 1)
    found = only(check_evidence(gather_evidence(flight().rig, gone, BRIEF)), "pictures in time")
    assert "cam1 without picture in 3" in found.evidence


def test_missing_exposures_and_repeated_stamps_are_named() -> None:
    t = evidence().frames_ns
    keep = np.arange(len(t)) % 4 > 0
    gaps = replace(evidence(), frames_ns=t[keep], present=evidence().present[keep])
    assert "drops exposures" in only(check_evidence(gaps), "pictures in time").mend
    same = t.copy()
    same[5] = same[4]
    assert "own time" in only(check_evidence(replace(evidence(), frames_ns=same)), "pictures in time").mend


# -- the function and the command


@dataclass
class Cut:
    """A source that gives the events above."""

    rig: Rig
    events_: list[Event]
    kind: Literal["flight", "photos"] = "flight"
    notes: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def events(self) -> Iterator[Event]:
        return iter(self.events_)


def test_the_function_takes_a_source_and_a_part_of_it() -> None:
    late = int(0.06e9)
    ahead = frames(lambda _, f: replace(f, t_ns=f.t_ns + late))
    found = alight.check(Cut(flight().rig, sorted(ahead, key=lambda e: e.t_ns)), seconds=6.0, start=0.5)  # type: ignore[arg-type]
    assert only(found, "time offset").mend.startswith("set motion.filter.time_offset=0.0")
    with pytest.raises(InputError, match="no exposure between"):
        alight.check(Cut(flight().rig, list(events()[:400])), start=500.0)  # type: ignore[arg-type]


def test_the_command_prints_a_line_each_and_returns_3(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tiny log of the tests is no flight: its pictures are noise."""
    code = call(["check", str(flight), "--seconds", "5"])
    lines = capsys.readouterr().out.splitlines()
    assert code == (3 if any(line.startswith("BAD") for line in lines) else 0)
    assert len(lines) >= 17
    assert all(line.startswith(("GOOD", "BAD", "CANNOT TELL")) for line in lines)
    assert call(["check", str(flight), "--json"]) == code
    records = json.loads(capsys.readouterr().out)
    assert {frozenset(r) for r in records} == {frozenset(("name", "verdict", "evidence", "mend"))}
    assert {r["verdict"] for r in records} <= {"good", "bad", "cannot tell"}
    assert call(["check", str(flight / "nowhere")]) == 2
    with pytest.raises(InputError, match=r"none\.yaml"):
        alight.check(flight, settings={"sources.calibration": "none.yaml"})


# -- recordings of others


@pytest.mark.parametrize(
    "name", first(2, ["sample", "euroc-excerpt", "rendered/gravelpit", "rendered/scree", "rendered/shore"])
)
def test_recordings_that_are_good_accuse_nobody(shared_data: Path, name: str) -> None:
    assert not wrong(alight.check(shared_data / name, seconds=4.0))
