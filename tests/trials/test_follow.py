"""Pictures drawn for another autopilot: they show the view of the vehicle's cameras at its reported position."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from autopilot_rig import LOCAL, Rig
from length import EITHER
from refusal import Refused

from alight.cli import call
from alight.flight.autopilot import Setpoint
from alight.geometry import Pose, so3_exp
from alight.records import FlightMode
from alight.settings import Settings
from alight.sources.growing import GrowingLog
from alight.trials import rehearse
from alight.trials.rehearse import VehicleFollower
from alight_sim import rehearsal, steered
from alight_sim.cameras import Eye
from alight_sim.followed import FollowedCameras, ReportedPlace, ReportedTrack
from alight_sim.rehearsal import CameraFolder
from alight_sim.steered import touchdown

SIZE, RATE = (80, 60), 4.0


def reported(t: float) -> ReportedPlace:
    """Position reported on a curved flight."""
    place = np.array([4.0 * t, 3.0 * np.sin(t), 0.5 * t * t])
    return ReportedPlace(round(t * 1e9), place, np.array([4.0, 3.0 * np.cos(t), t]))


def test_a_track_goes_through_its_reports_and_bends_between_them() -> None:
    track = ReportedTrack()
    assert track.span_ns is None
    for t in np.arange(0.0, 2.0, 0.1):
        track.add_place(reported(t))
        track.add_attitude(round(t * 1e9) + 7_000_000, so3_exp([0.0, 0.3 * (t + 0.007), 0.0]))
    track.add_place(reported(0.5))  # late: left out
    assert track.span_ns == (7_000_000, 1_900_000_000)
    for t in (0.3, 0.333, 0.9, 1.25):
        R, place = track.at(t * 1e9)
        np.testing.assert_allclose(place, reported(t).position, atol=1e-5)
        np.testing.assert_allclose(R, so3_exp([0.0, 0.3 * t, 0.0]), atol=1e-9)


def test_the_printed_commands_can_be_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, said = tmp_path / "my pictures", list[str]()
    monkeypatch.setattr(rehearse, "open_link", lambda *_, **__: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(rehearse, "_follow", lambda *_: None)
    cameras = FollowedCameras("concrete", 3, size=SIZE, rate_hz=RATE, start=(-20.0, -12.0))
    rehearse.follow_vehicle("link", cameras, folder, 1.0, said.append)
    assert said == [f"ready: alight fly --link LINK --camera '{folder}' --out OUT --take-off 30"]
    quick = SimpleNamespace(wait=lambda *_: None, server=SimpleNamespace(behind=0.0))
    monkeypatch.setattr(rehearsal, "Rehearsal", lambda *_: nullcontext(quick))
    monkeypatch.setattr(steered, "SteeredFlight", lambda *_, **__: None)
    monkeypatch.setattr(touchdown, "judge_flight", lambda *_: None)
    assert call(["rehearse", "concrete", "--folder", str(folder)]) == 0
    assert f"--camera '{folder}' --out OUT\n" in capsys.readouterr().out


@EITHER
def test_the_pictures_are_those_of_the_flight(tmp_path: Path, dialect: str) -> None:
    """Pictures drawn from telemetry agree with the view of a camera at the true pose."""
    cameras = FollowedCameras("concrete", 3, size=SIZE, rate_hz=RATE, start=(-20.0, -12.0))
    folder = CameraFolder(tmp_path, cameras.rig, RATE)
    follower = VehicleFollower(cameras, folder)
    written, write, truth = list[tuple[int, np.ndarray]](), folder.write, dict[int, Pose]()

    def keep(frame, t_ns: int) -> None:  # type: ignore[no-untyped-def]
        written.append((t_ns, frame.images[0]))
        write(frame, t_ns)

    folder.write = keep  # type: ignore[method-assign]
    r = Rig(dialect, step=0.01)  # the clocks are tied to half a step: half a pixel at 5 m/s

    def follow() -> None:
        truth[r.now_ns] = Pose(r.sim.vehicle.world_from_body.rotation, r.truth())
        follower.tick(r.now_ns)
        for data in follower.autopilot.pending():
            r.up.put(data, r.t)

    get = r.down.get

    def heard(t: float) -> list[bytes]:
        out = list(get(t))
        for data in out:
            follower.autopilot.receive(data, r.now_ns)
        return out

    r.down.get, r.each_step = heard, follow  # type: ignore[method-assign]
    r.up_and_flying(8.0)
    r.vehicle.guide(Setpoint(r.truth() + np.array([6.0, 3.0, 2.0])), r.vehicle.tie(LOCAL, r.truth(), r.now_ns))
    r.run(6.0)
    assert follower.touchdown is None
    assert len(written) > 30
    assert max(np.diff([t for t, _ in written])) <= 1.01e9 / RATE
    flown = [(t, image) for t, image in written if t > r.now_ns - 8e9]
    poses = [truth[min(truth, key=lambda known: abs(known - t))] for t, _ in flown]
    heights = [p.translation[2] for p in poses]
    assert max(heights) > 8.0
    # drawn anew at the true poses, by the same cameras
    home = np.array([-20.0, -12.0, cameras.home[2]])
    for (t_ns, image), pose in list(zip(flown, poses, strict=True))[::6]:
        there = Pose(pose.rotation, home + pose.translation)
        body_from_cam = cameras.rig.cameras[0].body_from_cam
        light = Eye(cameras.rig.cameras[0].camera).radiance(cameras.world, there @ body_from_cam, 0.0)
        seen, drawn = (a.astype(np.float32).reshape(*light.shape[:2], -1).mean(axis=2) for a in (light, image))
        shift, sure = cv2.phaseCorrelate(seen, drawn, cv2.createHanningWindow(SIZE, cv2.CV_32F))
        assert sure > 0.7, t_ns
        assert np.hypot(*shift) < 0.5, t_ns
    r.dt = 0.05
    r.answered(r.vehicle.set_mode(FlightMode.LAND))
    assert r.run(60.0, lambda: follower.touchdown is not None)
    found = follower.touchdown
    assert found is not None
    np.testing.assert_allclose([found.east, found.north], home[:2] + r.truth()[:2], atol=0.1)
    assert 0.1 < found.sink < 1.5
    folder.close()
    log = GrowingLog(tmp_path, Settings())
    assert [c.name for c in log.rig.cameras] == [c.name for c in cameras.rig.cameras]
    assert len(list((tmp_path / "mav0" / "cam0" / "data").glob("*.png"))) == follower.exposures == len(written)


def test_a_vehicle_that_is_not_there_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("alight.trials.rehearse.NO_VEHICLE", 0.2)
    words = ["rehearse", "concrete", "--folder", str(tmp_path / "f"), "--follow", "udp:127.0.0.1:0", "--width", "80"]
    assert call(words) == 2
    said = capsys.readouterr().err
    assert "no message of a vehicle" in said
    assert "Traceback" not in said


def test_what_the_other_autopilot_decides_is_not_asked_for(refused: Refused) -> None:
    words = ["rehearse", "concrete", "--folder", "x", "--follow", "udp:127.0.0.1:0", "--height", "20", "--wind", "3"]
    refused(words, "--height and --wind: the autopilot that is followed")
