"""Films and scenes of a flight: what a recording holds, and what a run without one gives."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from some_run import LOCAL, elevation, hazards, some_run

from alight import cli
from alight.geometry import Camera, Pose, so3_exp
from alight.outputs import write_run
from alight.outputs.recorder import Recorder
from alight.records import Frame, Rig, RigCamera
from alight.records.codec import FlightHead
from alight.records.executive import FlightEvent, FlightState, Transition
from alight.settings import ImuNoise, Settings
from alight.viewing.film import write_film
from alight.viewing.flight import ShownFlight

DOWN = RigCamera(
    "cam0", Camera(64, 48, 50.0, 50.0, 31.5, 23.5), Pose(so3_exp(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
)
FOUND = Transition(1.5, FlightState.SEARCH, FlightEvent.FOUND, FlightState.APPROACH, "candidate, P(safe) 0.926")


@pytest.fixture
def flown(tmp_path: Path) -> ShownFlight:
    """A run with a recording of all its motions, a picture for each, its verdict and one decision."""
    run = some_run()
    write_run(run, tmp_path / "out", False)
    head = FlightHead("some", Rig((DOWN,)), LOCAL, True, ImuNoise(), Settings())
    recorder = Recorder(tmp_path / "flight.mcap", head, map_share=1000.0)
    for k, motion in enumerate(run.motions):
        recorder.event(Frame(motion.t_ns, (np.full((48, 64), 10 * k, np.uint8),), f"{k}"))
        recorder.motion(motion)
    recorder.landing(run.motions[-1].t_ns, FOUND)
    recorder.decision(run)
    recorder.motion(run.motions[-1])
    recorder.close()
    return ShownFlight(tmp_path / "out", tmp_path / "flight.mcap")


def test_a_recording_gives_what_was_known_at_each_motion(flown: ShownFlight) -> None:
    run, moments = some_run(), list(flown.moments())
    assert len(moments) == len(run.motions) + 1
    for k, (moment, motion) in enumerate(zip(moments, run.motions, strict=False)):
        offset = 0.0 if motion.offset_world is None else motion.offset_world
        np.testing.assert_allclose(moment.pose.translation, motion.world_from_body.translation + offset, atol=1e-9)
        np.testing.assert_allclose(moment.pose.rotation, motion.world_from_body.rotation, atol=1e-9)
        np.testing.assert_allclose(moment.covariance, motion.covariance)
        assert moment.picture is not None
        assert (moment.picture == 10 * k).all()
        assert not moment.places
    end = moments[-1]
    assert [p.label.split(":")[0] for p in end.places] == [f"{s.kind} {s.rank}" for s in run.sites.listed]
    np.testing.assert_allclose([p.position for p in end.places], [s.position_world for s in run.sites.listed])
    assert end.lines == (FOUND.line.strip(),)
    assert len(end.route) == len(run.route.waypoints)  # type: ignore[union-attr]


def test_a_map_comes_back_as_it_was_judged(flown: ShownFlight) -> None:
    shown, mapped = list(flown.moments())[-1].map, elevation()
    assert shown is not None
    assert shown.grid.shape == mapped.grid.shape
    np.testing.assert_allclose([shown.grid.east, shown.grid.north], [mapped.grid.east, mapped.grid.north])
    np.testing.assert_allclose(shown.layers["elevation"], np.where(mapped.trusted, mapped.height, np.nan))
    np.testing.assert_allclose(shown.layers["p_safe"], hazards().on(mapped.grid).p_safe)


def test_a_run_without_a_recording_is_shown_from_its_folder(tmp_path: Path) -> None:
    run = some_run()
    write_run(run, tmp_path, False)
    flown = ShownFlight(tmp_path)
    moments = list(flown.moments())
    assert flown.rig is None
    assert len(moments) == len(run.motions)
    np.testing.assert_allclose(moments[-1].pose.translation, run.motions[-1].world_from_body.translation, atol=1e-5)


@pytest.mark.parametrize("name", ["film.mp4", "film.webp", "film.gif"])
def test_a_film_has_the_length_of_the_flight(flown: ShownFlight, tmp_path: Path, name: str) -> None:
    moments, path = list(flown.moments()), tmp_path / name
    seconds = (moments[-1].t_ns - moments[0].t_ns) * 1e-9
    frames = write_film(flown, path, 10.0, seconds)  # the whole flight in one second
    assert 2 <= frames <= 12
    if name.endswith("mp4"):
        assert int(cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT)) == frames
    else:
        with Image.open(path) as film:
            assert film.n_frames <= frames  # type: ignore[attr-defined]


def test_the_commands_draw_and_refuse_in_one_line(
    flown: ShownFlight, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = ["--recording", str(tmp_path / "flight.mcap")]
    assert cli.call(["film", str(tmp_path / "out"), str(tmp_path / "f.webp"), "--rate", "2", *recording]) == 0
    assert "frames" in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, "rerun", None)
    for arguments, words in (
        (["film", str(tmp_path), str(tmp_path / "f.mp4")], "no finished run here"),
        (["film", str(tmp_path / "out"), "f.avi"], "a film is an .mp4, .webp or .gif file"),
        (["demo", "--film", "f.avi", "--out", str(tmp_path / "d")], "a film is an .mp4, .webp or .gif file"),
        (["view", str(tmp_path / "out")], "rerun-sdk is not installed; mend it with: pip install 'alight[view]'"),
        (["run", "flight", "--view", "--out", str(tmp_path / "r")], "rerun-sdk is not installed"),
    ):
        assert cli.call(arguments) == 2
        told = capsys.readouterr()
        assert words in told.err
        assert told.err.count("\n") == 1


def test_a_run_without_motion_has_nothing_to_show(tmp_path: Path) -> None:
    write_run(some_run(motions=()), tmp_path, False)
    with pytest.raises(Exception, match="neither a recording nor a trajectory"):
        list(ShownFlight(tmp_path).moments())


def test_a_scene_holds_the_flight(flown: ShownFlight, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra `view`")
    from alight.viewing.spatial import show

    show(flown, tmp_path / "flight.rrd")
    assert (tmp_path / "flight.rrd").stat().st_size > 10_000
