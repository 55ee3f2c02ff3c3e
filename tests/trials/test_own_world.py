"""A world of another package: a landing in it, worker processes, and what a wrong one gets."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from plane_world import PlaneWorld

from alight.cli import call
from alight.records import Frame, OutputError
from alight.records.executive import FlightState
from alight.settings import load_settings
from alight.trials.campaign.folder import CampaignFolder
from alight.trials.campaign.run import Campaign, again, continued, fly_campaign
from alight.trials.landing import Landing
from alight_sim import SceneWorld, World, build
from alight_sim.oracle import OracleLander, judge_touchdown
from alight_sim.steered import SteeredFlight, Wanted

PLANE = "plane_world:PlaneWorld"
BROKEN = """
import alight_sim
thing = 4
def few(seed): return {}
def half(seed): return Half()
def raising(seed): raise ValueError("no mesh\\nof this seed")
class Half(alight_sim.World):
    name = "half"
"""


def gives_up(vehicle: SteeredFlight, *_: object) -> Landing:
    """A landing that takes no time."""
    assert isinstance(vehicle.world, PlaneWorld)
    return Landing(FlightState.RETURN)


@pytest.mark.usefixtures("small_pictures")
def test_a_landing_is_flown_in_a_world_that_is_not_the_simulators(tmp_path: Path) -> None:
    """The whole way: searched, found between the boxes, landed on, and judged by the world's own truth."""
    quick = ["--no-look-again", "--set", "executive.search_side=30", "--set", "parallax.cell=0.15", "--seed", "1"]
    assert call(["campaign", "--world", PLANE, "--landings", "1", *quick, "--out", str(tmp_path / "out")]) == 0
    line = json.loads((tmp_path / "out" / "landings.jsonl").read_text())
    assert (line["conditions"]["scene"], line["conditions"]["light"]) == (PLANE, None)
    assert (line["outcome"], line["error"]) == ("landed safely", None)
    assert line["touchdown"]["sink"] > 0.2


def test_a_campaign_goes_on_in_worker_processes_and_repeats(tmp_path: Path) -> None:
    out, settings = tmp_path / "out", load_settings("", ["executive.search_side=12"])
    fly_campaign(Campaign([PLANE], 1, 3, settings), out, fly=gives_up)
    fly_campaign(continued(out, 2), out, jobs=2, fly=gives_up)
    records = CampaignFolder(out).read()
    assert {r.outcome for r in records.values()} == {"wrongly refused"}
    assert all(0.1 < (r.safe_share or 0.0) < 0.9 for r in records.values())  # the boxes take the rest
    assert len({r.conditions.world_seed for r in records.values()}) == 2
    assert again(continued(out), out, 1, gives_up).differing == []
    head = json.loads((out / "campaign.json").read_text())
    (module,) = head["files"]
    assert Path(module).name == "plane_world.py"
    (out / "campaign.json").write_text(json.dumps({**head, "files": {module: "0"}}))
    with pytest.raises(OutputError, match=r"another content of .*plane_world\.py"):
        fly_campaign(Campaign([PLANE], 2, 3, settings), out, fly=gives_up)


def test_a_car_on_command_is_in_its_pictures_in_the_way_and_in_the_truth() -> None:
    flight = SteeredFlight(PlaneWorld(1), 1, start=(0.0, 0.0, 5.0), size=(64, 48), radius=0.5, gusts=0.0)
    before, gap, pose = _picture(flight), flight.gap, flight.true_pose
    assert judge_touchdown(flight.world, OracleLander(radius=0.8), pose, seconds=flight.seconds).safe
    flight.park(0.0, 0.0)
    assert (np.abs(_picture(flight) - before).max(axis=2) > 25).mean() > 0.1
    assert flight.gap == pytest.approx(gap - 1.5, abs=0.1)
    found = judge_touchdown(flight.world, OracleLander(radius=0.8), pose, seconds=flight.seconds, bodies=flight.bodies)
    assert not found.safe


def _picture(flight: SteeredFlight) -> np.ndarray:
    wanted = Wanted(position=flight.true_pose.translation)
    return [e for e in flight.step(0.8, wanted) if isinstance(e, Frame)][-1].images[0].astype(float)  # type: ignore[union-attr]


def test_heights_between_cells_follow_from_the_truth() -> None:
    world = PlaneWorld(2)
    for east, north, _, _, _, along, _, up in world.boxes[:, :8]:
        assert world.height_at(east, north) == pytest.approx(up, rel=1e-6)
        assert world.height_at(east + along + 0.11, north) == 0.0
    edge = [world.height_at(world.boxes[0, 0] + x, world.boxes[0, 1]) for x in np.linspace(0.0, 1.2, 121)]
    assert np.all(np.diff(edge) <= 1e-9)
    assert any(0.1 < height < 0.2 for height in edge)


def test_the_simulators_world_has_all_that_a_trial_needs() -> None:
    world: World = build("concrete")
    assert isinstance(world, SceneWorld)
    assert isinstance(world, World)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("somewhere", "--world somewhere: give package.module:factory"),
        ("nowhere.at_all:world", "there is no module 'nowhere' in the working directory"),
        ("broken_worlds:gone", "broken_worlds has no function 'gone'"),
        ("broken_worlds:thing", "broken_worlds has no function 'thing'"),
        ("broken_worlds:few", "few returns a dict without cell, description, faults"),
        ("broken_worlds:half", "raised TypeError: Can't instantiate abstract class Half"),
        ("broken_worlds:raising", "raised ValueError: no mesh of this seed (broken_worlds.py:6)"),
        ("torn_worlds:world", "importing torn_worlds raised ModuleNotFoundError: No module named 'not_installed'"),
    ],
)
def test_a_wrong_world_gets_one_clear_line(
    name: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken_worlds.py").write_text(BROKEN)
    (tmp_path / "torn_worlds.py").write_text("import not_installed\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert call(["campaign", "--world", name, "--out", "out"]) == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()


def test_a_picture_of_another_shape_fails_with_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PlaneWorld, "radiance", lambda *_: np.zeros((4, 6)))
    assert call(["campaign", "--world", PLANE, "--landings", "1", "--out", str(tmp_path / "out")]) == 3
    line = json.loads((tmp_path / "out" / "landings.jsonl").read_text())
    assert line["outcome"] == "failed"
    assert "radiance gives an array (4, 6), not (240, 320, 3)" in line["error"]
