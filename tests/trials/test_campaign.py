"""Campaigns with made-up landings: the plan, no landing flown twice, outcomes, workers, the report."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import BROWSER, open_tab
from length import EITHER, first, in_turn, long
from refusal import Refused

import alight
from alight.cli import call, simulated
from alight.cluster import do_alike
from alight.geometry import Pose
from alight.records import InputError, OutputError
from alight.records.campaign import Conditions, FaultRecord, LandingRecord, LightRecord, TouchdownLine
from alight.records.executive import FlightDiary, FlightEvent, FlightState, LookPicture, LookRecord, Transition
from alight.settings import Settings, load_settings
from alight.trials.campaign import run as runner
from alight.trials.campaign.faults import FAULTS, LINK_FAULTS, Happenings
from alight.trials.campaign.flying import fly_conditions
from alight.trials.campaign.folder import CampaignFolder
from alight.trials.campaign.numbers import campaign_numbers, unsafe_bound
from alight.trials.campaign.plan import MOST_WIND, SUN, conditions_of
from alight.trials.campaign.run import Campaign, again, continued, fly_campaign, wanted_landings
from alight.trials.campaign.worlds import scenes_of
from alight.trials.landing import Landing
from alight_sim.flight import START_NS
from alight_sim.point_mass import Wanted
from alight_sim.steered import SteeredFlight, TrueContact

S, E = FlightState, FlightEvent
FLAT = "cover: {cover}\n  size: [60, 60]\n  cell: 0.2\n  relief: []"
SMALL = ["executive.search_side=12"]
COARSE = ["executive.search_side=40", "parallax.cell=0.5"]


def scene(folder: Path, name: str = "flat", cover: str = "short_grass") -> str:
    """Write a scene file with level ground of one class."""
    path = folder / f"{name}.yaml"
    path.write_text(f"ground:\n  {FLAT.format(cover=cover)}\n")
    return str(path)


def small(names: list[str], landings: int = 4, seed: int = 3) -> Campaign:
    """A campaign that takes no time."""
    return Campaign(names, landings, seed, load_settings("", SMALL))


def diary(*steps: tuple[S, E, S]) -> FlightDiary:
    """Diary of transitions a second apart, with a look that raised P(safe)."""
    out = FlightDiary([Transition(float(k), a, e, b, e.value, None, 0.97) for k, (a, e, b) in enumerate(steps, 1)])
    out.looks.append(LookRecord(1.5, (0.0, 0.0, 0.0), 15.0, "candidate", 0.6, "relief"))
    out.looks.append(LookRecord(1.8, (0.0, 0.0, 0.0), 6.0, "site", 0.97))
    return out


def touch(vehicle: SteeredFlight, sink: float = 0.4, at: tuple[float, float] = (0.0, 0.0)) -> None:
    """Add a contact of the vehicle with the ground."""
    place = np.array([*at, vehicle.world.height_at(*at)])
    speed = np.array([0.0, 0.0, -sink])
    vehicle.contacts.append(TrueContact(START_NS + 10**10, Pose(np.eye(3), place), speed, 0.35))


def moment(t: float, state: S) -> Any:
    """A landing at one moment, as the faults are given it."""
    return SimpleNamespace(t=t, state=state)


def lands(
    vehicle: SteeredFlight, settings: Settings, appearance: object, happening: Callable[..., None], *_: object
) -> Landing:
    """A landing that takes two orders."""
    for t, state in ((0.0, S.SEARCH), (20.0, S.COMMIT)):
        happening(moment(t, state))
    touch(vehicle, sink=0.4 + 1e-3 * (vehicle.seed % 7))
    found = (S.SEARCH, E.FOUND, S.APPROACH), (S.LOOK, E.CONFIRMED, S.COMMIT), (S.COMMIT, E.TOUCHED_DOWN, S.LANDED)
    parts = {"simulator": 3.0, "navigation": 0.5, "mapping": 2.0, "judging": 1.0}
    return Landing(S.LANDED, diary(*found), 30.0, 0.97, cpu_of=parts)


def gives_up(event: E, after: S = S.RETURN) -> Callable[..., Landing]:
    """A landing that ends without a touchdown."""

    def fly(vehicle: SteeredFlight, *_: object) -> Landing:
        return Landing(after, diary((S.SEARCH, event, after)), 60.0)

    return fly


def raises(vehicle: SteeredFlight, *_: object) -> Landing:
    raise ArithmeticError("the world\nended")


def tell_to_die(path: Path, seed: int, times: int) -> None:
    """Write the file of `dies_once` as a whole: another process may be reading it."""
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    fresh.write_text(f"{seed} {times}")
    os.replace(fresh, path)


def dies_once(vehicle: SteeredFlight, *others: object) -> Landing:
    """Kill the process that flies the landing of one seed, as often as a file states; fly the other landings."""
    told = Path(os.environ["ALIGHT_TEST_DIES"])
    seed, times = (int(v) for v in told.read_text().split())
    if vehicle.seed == seed and times:
        tell_to_die(told, seed, times - 1)
        os.kill(os.getpid(), signal.SIGKILL)
    return lands(vehicle, *others)  # type: ignore[arg-type]


def lines(out: Path) -> list[str]:
    return (out / "landings.jsonl").read_text().splitlines()


def repeatable(out: Path) -> dict[int, dict]:  # type: ignore[type-arg]
    return {k: r.repeatable() for k, r in CampaignFolder(out).read().items()}


# -- the plan


def test_a_landing_is_drawn_from_the_seed_and_its_number_alone() -> None:
    some = [conditions_of(("lake", "desert"), 5, k) for k in (7, 3)]
    assert some == [conditions_of(("lake", "desert"), 5, k) for k in (7, 3)]
    assert some[0].world_seed != some[1].world_seed
    assert conditions_of(("lake", "desert"), 6, 7).world_seed != some[0].world_seed


def test_scenes_take_turns_wind_is_bounded_and_a_third_has_a_fault() -> None:
    drawn = [conditions_of(("lake", "desert", "snow"), 1, k) for k in range(600)]
    assert {s: sum(c.scene == s for c in drawn) for s in ("lake", "desert", "snow")} == dict.fromkeys(
        ("lake", "desert", "snow"), 200
    )
    wind = np.array([c.wind_speed for c in drawn])
    assert wind.max() < MOST_WIND
    assert wind.max() > 0.95 * MOST_WIND
    assert 0.28 < np.mean([bool(c.faults) for c in drawn]) < 0.39
    assert {f.what for c in drawn for f in c.faults} == set(FAULTS)
    assert all(f.state for c in drawn for f in c.faults if FAULTS[f.what].is_body)


def test_the_light_is_that_of_any_time_of_the_day() -> None:
    """The light has a random stream of its own, so that older campaigns are drawn as before."""
    lights = [c.light for c in (conditions_of(("lake",), 1, k) for k in range(600)) if c.light is not None]
    assert len(lights) == 600
    heights = np.array([light.elevation_deg for light in lights])
    assert SUN[0] <= heights.min() < SUN[0] + 2.0
    assert SUN[1] - 2.0 < heights.max() <= SUN[1]
    assert np.ptp([light.azimuth_deg for light in lights]) > 350.0
    assert 0.2 < np.mean([light.sun < 0.5 for light in lights]) < 0.3
    assert 0.2 < np.mean([light.clouds > 0.0 for light in lights]) < 0.3


def test_the_vehicle_flies_in_that_light_with_cameras_that_adapt(tmp_path: Path) -> None:
    seen: list[SteeredFlight] = []

    def looks(vehicle: SteeredFlight, *_: object) -> Landing:
        seen.append(vehicle)
        return Landing(S.SEARCH)

    drawn = LightRecord(azimuth_deg=10.0, elevation_deg=70.0, sun=0.9, sky=0.6, clouds=0.3)
    for light in (drawn, None):
        flown(scene(tmp_path), looks, light=light)
    lit, own = (v.world.light for v in seen)
    assert (lit.elevation_deg, lit.azimuth_deg, lit.clouds.share) == (70.0, 10.0, 0.3)
    assert own == seen[1].world.scene.light
    assert [v.world.imaging.auto for v in seen] == [True, False]


def test_all_stands_for_every_kind_and_a_wrong_name_is_refused(tmp_path: Path) -> None:
    assert {"lake", "car_park", "rubble"} < set(scenes_of(["all"]))
    assert scenes_of(["demo", "all", "demo"])[0] == "demo"
    with pytest.raises(InputError, match="no scene is called 'medow'"):
        scenes_of(["medow"])
    with pytest.raises(InputError, match=r"gone\.yaml: cannot be read"):
        scenes_of([str(tmp_path / "gone.yaml")])


def done_to(vehicle: SteeredFlight) -> str:
    """Text of everything that a fault may change."""
    sensors = vehicle.sensors.imu_lost, vehicle.sensors.nav.errors, vehicle.cameras.commanded
    return repr((vehicle.battery, vehicle.air, len(vehicle.bodies), *sensors))


@pytest.mark.parametrize("what", FAULTS)
def test_every_fault_happens_once_at_its_state(what: str, tmp_path: Path) -> None:
    vehicle = SteeredFlight(scene(tmp_path), size=(64, 48), stereo=False)
    fault = FaultRecord(what=what, after=1.0, state="look", numbers=FAULTS[what].draw(np.random.default_rng(0)))
    happenings = Happenings(vehicle, (fault, fault.model_copy(update={"state": "commit"})))
    before = done_to(vehicle)
    happenings(moment(50.0, S.SEARCH))
    happenings(moment(51.0, S.LOOK))
    assert before == done_to(vehicle)
    happenings(moment(52.5, S.DESCEND))
    assert before != done_to(vehicle)
    happenings(moment(53.0, S.LOOK))
    assert [f.happened for f in happenings.faults] == [52.5, None]


@pytest.mark.parametrize("what", ["car", "person"])
@pytest.mark.parametrize(("height", "seconds", "touched"), [
    (5.5, 12, "could have been stopped"), (0.8, 12, "could not be stopped"), (5.5, 0, None),
])  # fmt: skip
def test_whoever_comes_at_any_height_is_touched_where_the_landing_goes_on(
    what: str, height: float, seconds: int, touched: str | None, tmp_path: Path
) -> None:
    numbers = {"direction": 1.0, "from": 3.0, "speed": 2.0}
    fault = FaultRecord(what=what, after=0.0, state="commit", numbers=numbers)
    vehicle = SteeredFlight(scene(tmp_path), size=(64, 48), stereo=False, start=(0.0, 0.0, height), radius=0.4)
    happenings, place = Happenings(vehicle, (fault,)), vehicle.true_pose.translation
    happenings(moment(1.0, S.COMMIT))
    (body,) = vehicle.bodies
    assert body.goal == pytest.approx((0.0, 0.0), abs=0.01)
    assert math.dist(body.start, body.goal) == pytest.approx(3.0, abs=0.01)
    for k in range(20 * seconds):  # it hovers until the body stands below it, then comes down
        vehicle.step(0.05, Wanted(place - [0.0, 0.0, 0.05 * k if k > 80 else 0.0], np.zeros(3)))
        happenings(moment(1.0 + 0.05 * k, S.COMMIT))
    assert happenings.touched(0.4) == touched


# -- the folder


def test_it_is_a_function_too(tmp_path: Path) -> None:
    name, out = scene(tmp_path), tmp_path / "out"
    fly_campaign(small([name], 2), out, fly=lands)
    assert alight.campaign([name], out, landings=2, seed=3, settings={"executive.search_side": 12}).landings == 2


def test_what_is_done_is_not_flown_again(tmp_path: Path) -> None:
    names, flown = [scene(tmp_path)], []

    def counted(vehicle: SteeredFlight, *others: object) -> Landing:
        flown.append(vehicle.seed)
        return lands(vehicle, *others)  # type: ignore[arg-type]

    fly_campaign(small(names, 3), tmp_path / "out", fly=counted)
    told: list[runner.Ended] = []
    numbers = fly_campaign(small(names, 5), tmp_path / "out", on_ended=told.append, fly=counted)
    assert len(flown) == len(set(flown)) == 5
    assert numbers.outcomes["landed safely"] == 5
    assert [(e.done, e.of) for e in told] == [(4, 5), (5, 5)]
    assert told[-1].left_s == 0
    assert continued(tmp_path / "out").landings == 5
    assert wanted_landings(tmp_path / "out", None) == 5  # named scenes again: no campaign shrinks by that
    assert wanted_landings(tmp_path / "out", 7) == 7
    assert wanted_landings(tmp_path / "other", None) == 20


def test_a_campaign_does_not_shrink(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused) -> None:
    name, out = scene(tmp_path), tmp_path / "out"
    fly_campaign(small([name], 3), out, fly=lands)
    for more in ([name], []):
        refused(["campaign", *more, "--landings", "2", "--out", out], "its campaign has 3 landings")
    planned = list[Campaign]()
    monkeypatch.setattr(runner, "fly_campaign", lambda campaign, *_: planned.append(campaign))
    for folder in (out, tmp_path / "new"):
        alight.campaign([name], folder)
    assert [c.landings for c in planned] == [3, 20]


def test_a_campaign_needs_a_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without scenes"):
        alight.campaign([], tmp_path / "out")


def test_a_campaign_that_cannot_be_written_on_reports_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, append = tmp_path / "out", CampaignFolder.append

    def full(self: CampaignFolder, record: LandingRecord, picture: bytes | None = None) -> None:
        if record.number == 2:
            raise OutputError("the disk is full")
        append(self, record, picture)

    monkeypatch.setattr(CampaignFolder, "append", full)
    with pytest.raises(OutputError, match="the disk is full"):
        fly_campaign(small([scene(tmp_path)]), out, fly=lands)
    assert "Two landings" in (out / "campaign.html").read_text()


def test_an_interrupted_campaign_reports_what_there_is(tmp_path: Path) -> None:
    def stops(ended: runner.Ended) -> None:
        if ended.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fly_campaign(small([scene(tmp_path)]), tmp_path / "out", on_ended=stops, fly=lands)
    assert len(lines(tmp_path / "out")) == 2
    head = json.loads((tmp_path / "out" / "campaign.json").read_text())
    assert head["numbers"]["landings"] == 2
    assert (tmp_path / "out" / "campaign.html").exists()


def test_a_torn_last_line_is_mended_and_its_landing_flown_again(tmp_path: Path) -> None:
    campaign, out = small([scene(tmp_path)], 3), tmp_path / "out"
    fly_campaign(campaign, out, fly=lands)
    whole, path = repeatable(out), out / "landings.jsonl"
    path.write_bytes(path.read_bytes()[:-40])
    assert set(CampaignFolder(out).read()) == {0, 1}
    fly_campaign(campaign, out, fly=lands)
    assert repeatable(out) == whole
    assert len(lines(out)) == 3
    path.write_bytes(path.read_bytes() + b"\0\0\0\n")  # as a loss of power leaves it
    fly_campaign(campaign, out, fly=raises)
    assert repeatable(out) == whole
    assert len(lines(out)) == 3


def test_a_line_that_is_damaged_in_the_middle_is_told(tmp_path: Path) -> None:
    campaign, out = small([scene(tmp_path)], 3), tmp_path / "out"
    fly_campaign(campaign, out, fly=lands)
    first, *others = lines(out)
    (out / "landings.jsonl").write_text("\n".join([first[:50], *others]) + "\n")
    with pytest.raises(InputError, match="line 1 is damaged"):
        fly_campaign(campaign, out, fly=lands)


def test_another_campaign_or_other_files_are_refused(tmp_path: Path) -> None:
    names, out = [scene(tmp_path)], tmp_path / "out"
    fly_campaign(small(names, 1), out, fly=lands)
    with pytest.raises(OutputError, match="holds a campaign with seed 3"):
        fly_campaign(small(names, 1, seed=4), out, fly=lands)
    other = replace(small(names, 1), settings=load_settings("", ["lander.radius=2"]))
    with pytest.raises(OutputError, match="other settings"):
        fly_campaign(other, out, fly=lands)
    with pytest.raises(OutputError, match="not a campaign's"):
        fly_campaign(small(names, 1), tmp_path, fly=lands)


# -- outcomes


def conditions(name: str, **more: object) -> Conditions:
    """Conditions of a calm landing without faults."""
    return conditions_of((name,), 0, 0).model_copy(update={"faults": (), "wind": (0.0, 0.0), **more})


def flown(name: str, fly: Callable[..., Landing], **more: object) -> LandingRecord:
    return fly_conditions(conditions(name, **more), load_settings("", SMALL), fly).record


def test_a_touchdown_is_judged_by_the_oracle_and_the_nearest_before_is_noted(tmp_path: Path) -> None:
    grass, water = scene(tmp_path), scene(tmp_path, "wet", "water")
    good = flown(grass, lands)
    assert (good.outcome, good.state) == ("landed safely", "landed")
    assert good.p_at_commit == good.p_found == 0.97
    assert good.nearest == pytest.approx(40.0, abs=0.5)  # in the search; `happening` is called in the landing as well
    assert [x.verdict for x in good.looks] == ["candidate", "site"]
    assert good.touchdown is not None
    assert good.touchdown.tilt == pytest.approx(0.0, abs=1e-6)
    bad = fly_conditions(conditions(water), Settings(), lands)
    assert bad.record.outcome == "landed unsafely"
    assert bad.record.why == "ground"
    assert bad.record.touchdown is not None
    assert bad.record.touchdown.bad_ground
    assert bad.picture is not None
    assert bad.picture[8:12] == b"WEBP"


def test_a_hard_touchdown_is_unsafe_but_not_by_the_ground(tmp_path: Path) -> None:
    def hard(vehicle: SteeredFlight, *_: object) -> Landing:
        touch(vehicle, sink=1.4)
        return Landing(S.LANDED)

    record = flown(scene(tmp_path), hard)
    assert (record.outcome, record.why) == ("landed unsafely", "sink")
    assert record.touchdown is not None
    assert not record.touchdown.bad_ground


def test_what_is_struck_in_flight_is_unsafe_however_it_touched_down(tmp_path: Path) -> None:
    def strikes(vehicle: SteeredFlight, *_: object) -> Landing:
        touch(vehicle)
        vehicle.contacts.append(replace(vehicle.contacts[0], struck=2.3))
        return Landing(S.LANDED)

    record = flown(scene(tmp_path), strikes)
    assert record.outcome == "landed unsafely"
    assert "2.3 m above its feet" in record.why
    assert record.touchdown is not None
    assert record.touchdown.safe
    assert record.strike is not None
    assert record.strike.above == 2.3
    numbers = campaign_numbers([record, flown(scene(tmp_path), lands)])
    assert (numbers.struck, numbers.unsafe_ground) == (1, 0)
    assert numbers.bound > numbers.ground_bound
    assert numbers.nearest == pytest.approx(40.0, abs=0.5)


def test_a_strike_does_not_hide_the_ground_below_and_counts_against_p_safe(tmp_path: Path) -> None:
    def strikes(vehicle: SteeredFlight, *_: object) -> Landing:
        touch(vehicle)
        vehicle.contacts.insert(0, replace(vehicle.contacts[0], struck=0.4))
        return Landing(
            S.LANDED, diary((S.LOOK, E.CONFIRMED, S.COMMIT), (S.COMMIT, E.TOUCHED_DOWN, S.LANDED)), 30.0, 0.97
        )

    wet, dry = flown(scene(tmp_path, "wet", "water"), strikes), flown(scene(tmp_path), strikes)
    numbers = campaign_numbers([wet, dry])
    assert (numbers.struck, numbers.unsafe_ground) == (2, 1)
    assert [(b.safe, b.unsafe) for b in numbers.p_at_commit] == [(0, 2)]


def test_ground_touched_before_the_landing_was_begun_is_unsafe(tmp_path: Path) -> None:
    def bumps(vehicle: SteeredFlight, *others: object) -> Landing:
        touch(vehicle)
        vehicle.contacts[0] = replace(vehicle.contacts[0], t_ns=START_NS + 10**9)
        return lands(vehicle, *others)  # type: ignore[arg-type]

    record = fly_conditions(conditions(scene(tmp_path)), load_settings("", SMALL), bumps)
    assert record.record.outcome == "landed unsafely"
    assert "touched the ground at 1.0 s" in record.record.why
    assert record.picture is not None


def test_ground_touched_outside_a_landing_is_unsafe(tmp_path: Path) -> None:
    def crash(vehicle: SteeredFlight, *_: object) -> Landing:
        touch(vehicle)
        return Landing(S.SEARCH)

    assert flown(scene(tmp_path), crash).outcome == "landed unsafely"


def test_a_refusal_is_right_only_where_there_is_no_place(tmp_path: Path) -> None:
    grass, water = scene(tmp_path), scene(tmp_path, "wet", "water")
    for event in (E.SEARCHED, E.TIME):
        no, yes = flown(grass, gives_up(event)), flown(water, gives_up(event))
        assert (no.outcome, yes.outcome) == ("wrongly refused", "rightly refused")
        assert no.safe_share is not None
        assert no.safe_share > 0.5
        assert yes.safe_share == 0.0


@pytest.mark.parametrize("off", [0.0, 0.2, 0.3, 0.4])
def test_a_strip_that_is_just_wide_enough_makes_a_refusal_wrong(tmp_path: Path, off: float) -> None:
    """Bare ground between tall grass is 4.3 m wide: only centres within 0.3 m keep a radius of 1.5 m and 0.5 m more."""
    ground = "  cover: tall_vegetation\n  size: [60, 60]\n  cell: 0.1\n  relief: []\n  layers:\n"
    path = f"[[{off - 20}, -30], [{off - 20}, 30]]"
    strip = f"  - {{thing: road, path: {path}, width: 4.3, ragged: 0, look: sand, kind: bare}}\n"
    (tmp_path / "strip.yaml").write_text(f"ground:\n{ground}{strip}")
    assert flown(str(tmp_path / "strip.yaml"), gives_up(E.SEARCHED)).outcome == "wrongly refused"


def test_wind_and_battery_are_believed_only_where_they_are_true(tmp_path: Path) -> None:
    name = scene(tmp_path)

    def drained(vehicle: SteeredFlight, *_: object) -> Landing:
        vehicle.drain(0.9)
        return gives_up(E.BATTERY)(vehicle)

    assert flown(name, drained).outcome == "rightly refused"
    assert flown(name, gives_up(E.BATTERY)).outcome == "wrongly refused"
    assert flown(name, gives_up(E.WIND), wind=(9.0, 0.0)).outcome == "rightly refused"
    assert flown(name, gives_up(E.WIND), wind=(7.0, 0.0)).outcome == "wrongly refused"
    assert flown(name, gives_up(E.WAITED, S.HANDED_OVER)).outcome == "handed over"


def test_a_landing_that_raises_is_failed_and_the_campaign_goes_on(tmp_path: Path) -> None:
    def sometimes(vehicle: SteeredFlight, *others: object) -> Landing:
        return (raises if vehicle.seed == second else lands)(vehicle, *others)  # type: ignore[operator]

    campaign = small([scene(tmp_path)], 3)
    second = conditions_of(campaign.scenes, campaign.seed, 1).flight_seed
    numbers = fly_campaign(campaign, tmp_path / "out", fly=sometimes)
    record = CampaignFolder(tmp_path / "out").read()[1]
    assert (numbers.outcomes["landed safely"], numbers.outcomes["failed"]) == (2, 1)
    assert record.error is not None
    assert record.error.startswith("ArithmeticError: the world ended (test_campaign.py:")


@pytest.mark.parametrize(("cover", "outcome"), [("short_grass", "failed"), ("water", "landed unsafely")])
def test_what_was_touched_before_it_raised_counts(tmp_path: Path, cover: str, outcome: str) -> None:
    def touches_and_raises(vehicle: SteeredFlight, *_: object) -> Landing:
        touch(vehicle)
        raise ArithmeticError("after the contact")

    record = flown(scene(tmp_path, "ground", cover), touches_and_raises)
    assert (record.outcome, record.error is None) == (outcome, False)
    assert record.touchdown is not None


def test_failed_landings_are_no_evidence_of_safety(tmp_path: Path) -> None:
    numbers = fly_campaign(small([scene(tmp_path)], 2), tmp_path / "out", fly=raises)
    assert numbers.bound == numbers.ground_bound == 1.0
    page = (tmp_path / "out" / "campaign.html").read_text()
    assert "Two landings, no unsafe touchdowns, 2 failed" in page
    assert 'class="answer good"' not in page


def test_what_cannot_begin_is_told_before_anything_is_written(tmp_path: Path) -> None:
    names, out = [scene(tmp_path)], tmp_path / "out"
    wide = tmp_path / "wide.yaml"
    wide.write_text(f"ground:\n  {FLAT.format(cover='bare')}\nrig: {{cameras: [{{resolution: [640, 360]}}]}}\n")
    for campaign, said in (
        (replace(small(names), settings=load_settings("", ["lander.radius=0.15"])), "lander.radius 0.15 m"),
        (replace(small(names), settings=load_settings("", ["terrain.model=nope.npz"])), "nope.npz"),
        (small([*names, str(wide)]), "rig"),
    ):
        with pytest.raises(InputError, match=said):
            fly_campaign(campaign, out, fly=lands)
        assert not out.exists()
    for seed in (-1, 2**63):
        with pytest.raises(InputError, match="seed"):
            small(names, seed=seed)


def test_a_scene_or_a_program_that_has_changed_is_another_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names, out = [scene(tmp_path)], tmp_path / "out"
    fly_campaign(small(names, 1), out, fly=lands)
    scene(tmp_path, cover="water")
    with pytest.raises(OutputError, match=r"another content of .*flat\.yaml"):
        fly_campaign(small(names, 2), out, fly=lands)
    found = again(small(names, 2), out, 0, lands)
    assert found.not_compared is not None
    assert "another content of" in found.not_compared
    scene(tmp_path)
    monkeypatch.setattr(runner, "sources_digest", lambda: "0123456789abcdef")
    with pytest.raises(OutputError, match="another state of Alight's sources"):
        fly_campaign(small(names, 2), out, fly=lands)
    assert len(lines(out)) == 1


def test_two_campaigns_do_not_write_one_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fly_campaign(small([scene(tmp_path)], 1), out, fly=lands)
    other = "import sys; from pathlib import Path; from alight.outputs.folder_lock import lock_folder\n"
    command = [sys.executable, "-c", f"{other}lock_folder(Path({str(out)!r})); print(flush=True); sys.stdin.read()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(OutputError, match="another run writes there"):
            fly_campaign(small([scene(tmp_path)], 2), out, fly=lands)
        holder.communicate()
    assert fly_campaign(small([scene(tmp_path)], 2), out, fly=lands).landings == 2


# -- again, bit for bit


def test_a_landing_flown_again_is_compared_with_its_line(tmp_path: Path) -> None:
    campaign, out = small([scene(tmp_path)], 2), tmp_path / "out"
    fly_campaign(campaign, out, fly=lands)
    before = lines(out)
    assert again(campaign, out, 1, lands)[1] == []
    assert again(campaign, out, 1, gives_up(E.TIME))[1][:2] == ["outcome", "why"]
    assert lines(out) == before
    assert again(campaign, out, 7, lands).not_compared == f"{out}: holds no line of landing 7"


@pytest.mark.usefixtures("small_pictures")
@EITHER
def test_a_real_flight_outlasts_short_faults_and_is_the_same_again(dialect: str, tmp_path: Path) -> None:
    """A flight of six seconds, without a landing and with frozen cameras, has the same record again."""
    faults = (
        FaultRecord(what="link interrupted", after=1.0, state="search", numbers={"seconds": 0.5}),
        FaultRecord(what="cameras frozen", after=2.5, numbers={"seconds": 1.0}),
        FaultRecord(what="modes refused", after=4.0, state="search", numbers={"seconds": 2.0}),
    )
    given = conditions_of((scene(tmp_path),), 1, 0).model_copy(update={"faults": faults, "firmware": dialect})
    one, two = (fly_conditions(given, load_settings("", [*COARSE, "executive.time_budget=6"])).record for _ in range(2))
    assert one.repeatable() == two.repeatable()
    assert (one.outcome, one.state, one.error) == ("wrongly refused", "return", None)
    assert one.verdicts > 0
    assert one.distance > 2.0
    assert [f.happened for f in one.conditions.faults] == pytest.approx([1.0, 2.5, 4.0], abs=0.11)


def test_link_faults_are_drawn_beside_what_is_drawn_without_them() -> None:
    plain = [conditions_of(("lake", "desert"), 5, k) for k in range(200)]
    with_faults = [conditions_of(("lake", "desert"), 5, k, 0.5, "px4") for k in range(200)]
    added = [c.faults[len(p.faults) :] for c, p in zip(with_faults, plain, strict=True)]
    same = {"faults": (), "firmware": "ardupilot"}
    assert [c.model_copy(update=same) for c in with_faults] == [c.model_copy(update=same) for c in plain]
    assert 0.4 < sum(map(len, added)) / 200 < 0.6
    assert {f.what for extra in added for f in extra} == set(LINK_FAULTS)
    assert any(f.takes_control for extra in added for f in extra)


TAKERS = [[name] for name, fault in LINK_FAULTS.items() if fault.takes_control]


@pytest.mark.usefixtures("small_pictures")
@pytest.mark.parametrize(("firmware", "what"), in_turn(len(TAKERS), TAKERS))
def test_whoever_takes_control_keeps_it(firmware: str, what: str, tmp_path: Path) -> None:
    """The pilot that flies vehicles is given each fault in the search, over the protocol."""
    numbers = {name: low for name, (low, _) in LINK_FAULTS[what].ranges.items()}
    fault = FaultRecord(what=what, after=2.0, state="search", numbers=numbers, takes_control=True)
    given = conditions_of((scene(tmp_path),), 1, 0).model_copy(update={"faults": (fault,), "firmware": firmware})
    record = fly_conditions(given, load_settings("", [*COARSE, "executive.time_budget=7"])).record
    assert record.error is None
    assert record.conditions.faults[0].happened == pytest.approx(2.0, abs=0.1)
    assert (record.outcome, record.is_right) == ("handed over", True)
    assert record.seconds < 6.0


@long
def test_a_real_landing_on_concrete() -> None:
    """In a whole landing, cameras that freeze for 20 s are reported and waited for; then come looks and touchdown."""
    fault = FaultRecord(what="cameras frozen", after=5.0, numbers={"seconds": 20.0})
    given = conditions_of(("concrete",), 1, 0).model_copy(update={"faults": (fault,)})
    record = fly_conditions(given, Settings()).record
    assert record.outcome == "landed safely", record
    lost = next(x for x in record.transitions if x.event == "no pictures come")
    assert "the cameras have frozen" in lost.reason
    back = next(x for x in record.transitions if x.before == "hold" and x.t > lost.t)
    assert back.after == "search"
    assert 18.0 < back.t - lost.t < 22.0
    assert set(record.cpu_of) == {"simulator", "link", "navigation", "mapping", "judging"}
    assert 0.5 * record.cpu_s < sum(record.cpu_of.values()) < record.cpu_s
    assert record.p_at_commit is not None
    assert record.p_at_commit > 0.95
    assert record.looks[-1].verdict == "site"
    assert [x.after for x in record.transitions][-2:] == ["commit", "landed"]


@long
def test_a_real_car_on_the_place_breaks_the_landing_off() -> None:
    """It is seen in the pictures alone: the vehicle climbs at once, and lands safely elsewhere or later."""
    fault = FaultRecord(what="car", after=0.5, state="commit", numbers={"direction": 1.0, "from": 28.0, "speed": 7.0})
    given = conditions_of(("concrete",), 1, 0).model_copy(update={"faults": (fault,)})
    record = fly_conditions(given, Settings()).record
    came = record.conditions.faults[0].happened
    assert came is not None
    broken_off = next(x for x in record.transitions if x.t > came)
    assert (broken_off.before, broken_off.after) == ("commit", "abort")
    assert "somebody moves" in broken_off.reason
    assert broken_off.t - came < 6.0
    assert record.outcome == "landed safely", record


# -- workers


@pytest.fixture
def deadly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int, int], object]:
    """Return a function that lets the process that flies a seed die so many times."""
    monkeypatch.setenv("ALIGHT_TEST_DIES", str(tmp_path / "dies"))
    return lambda seed, times: tell_to_die(tmp_path / "dies", seed, times)


@pytest.mark.parametrize("times", first(1, [1, 9]))
def test_a_killed_process_loses_nothing(deadly: Callable[[int, int], object], tmp_path: Path, times: int) -> None:
    campaign = small([scene(tmp_path)], 3)
    second = conditions_of(campaign.scenes, campaign.seed, 1).flight_seed
    fly_campaign(campaign, tmp_path / "one", fly=lands)
    deadly(second, times)
    fly_campaign(campaign, tmp_path / "two", jobs=2, fly=dies_once)
    one, two = repeatable(tmp_path / "one"), repeatable(tmp_path / "two")
    if times > 1:
        assert two[1]["outcome"] == "failed"
        fly_campaign(campaign, tmp_path / "two", fly=lands)  # goes on: lost landings are flown again
        two = repeatable(tmp_path / "two")
    assert one == two


@pytest.mark.filterwarnings("ignore")  # the cluster's own
def test_a_cluster_gives_the_same_and_a_killed_worker_loses_nothing(
    deadly: Callable[[int, int], object], tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    campaign = small([scene(tmp_path)], 4)
    fly_campaign(campaign, tmp_path / "one", fly=lands)
    deadly(conditions_of(campaign.scenes, campaign.seed, 2).flight_seed, 1)
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        fly_campaign(campaign, tmp_path / "two", scheduler=cluster.scheduler_address, fly=dies_once)
    assert (tmp_path / "dies").read_text().endswith(" 0")
    assert repeatable(tmp_path / "one") == repeatable(tmp_path / "two")


@pytest.mark.filterwarnings("ignore")  # the cluster's own
def test_a_cluster_that_loses_a_landing_time_and_again_is_told_and_keeps_what_there_is(
    deadly: Callable[[int, int], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    import dask

    campaign, out = small([scene(tmp_path)], 3), tmp_path / "out"
    deadly(conditions_of(campaign.scenes, campaign.seed, 1).flight_seed, 99)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        with pytest.raises(InputError, match="landing 1: the workers that had it were lost"):
            fly_campaign(campaign, out, scheduler=cluster.scheduler_address, fly=dies_once)
        assert (out / "campaign.html").exists()
    fly_campaign(campaign, out, fly=lands)
    assert [r.outcome for r in CampaignFolder(out).read().values()] == ["landed safely"] * 3


@pytest.mark.filterwarnings("ignore")  # the cluster's own
def test_a_worker_with_another_program_flies_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    with distributed.LocalCluster(1, threads_per_worker=1, dashboard_address=None) as cluster:
        monkeypatch.setattr("alight.cluster.sources_digest", lambda: "0123456789abcdef")  # in this process alone
        with pytest.raises(InputError, match="has another Alight than this program"):
            fly_campaign(small([scene(tmp_path)], 1), tmp_path / "out", scheduler=cluster.scheduler_address, fly=lands)


def test_a_worker_that_comes_later_is_compared_as_well() -> None:
    with pytest.raises(InputError, match="install the same everywhere"):
        do_alike("0123456789abcdef", lambda c: pytest.fail("flown"), conditions("demo"))


# -- the report


def test_the_bound_is_where_so_few_are_one_in_twenty_and_about_three_over_their_number_without_one() -> None:
    from scipy.stats import binom

    assert unsafe_bound(0, 200) == pytest.approx(1 - 0.05 ** (1 / 200))
    assert unsafe_bound(0, 1000) == pytest.approx(3 / 1000, rel=0.01)
    assert unsafe_bound(0, 0) == unsafe_bound(3, 3) == 1.0
    for unsafe, landings in ((0, 200), (1, 200), (5, 37)):
        assert binom.cdf(unsafe, landings, unsafe_bound(unsafe, landings)) == pytest.approx(0.05)


def test_faults_that_never_happened_stand_in_a_row_of_their_own() -> None:
    wind = FaultRecord(what="strong wind", after=5.0, numbers={"speed": 10.0}, happened=5.0)
    late = FaultRecord(what="gust", after=50.0)
    records = [made(k, "rightly refused", None, None) for k in range(2)]
    records = [
        r.model_copy(update={"conditions": r.conditions.model_copy(update={"faults": (f,)})})
        for r, f in zip(records, (wind, late), strict=True)
    ]
    n = campaign_numbers(records)
    assert set(n.by_fault) == {"strong wind", "planned, and never happened"}
    assert set(n.by_wind) == {"2 to 4 m/s", "more than 6 m/s"}
    assert "strong wind" in FAULTS


def made(number: int, outcome: str, p: float | None, reasons: tuple[str, ...] | None) -> LandingRecord:
    down = None if reasons is None else TouchdownLine(
        t=40.0, east=0, north=0, safe=not reasons, reasons=reasons, tilt=0.1, roughness=0.1, sink=0.4, drift=0.1
    )  # fmt: skip
    c = conditions("demo", landing=number, scene="demo" if number % 2 else "lake", wind=(3.0, 0.0))
    return LandingRecord(conditions=c, outcome=outcome, why="so", p_at_commit=p, touchdown=down, seconds=10.0 * number)


def test_the_numbers_hold_p_safe_against_what_happened() -> None:
    records = [
        made(0, "landed safely", 0.96, ()), made(1, "landed unsafely", 0.97, ("ground",)),
        made(2, "landed unsafely", 1.0, ("drift",)), made(3, "rightly refused", None, None),
    ]  # fmt: skip
    n = campaign_numbers(records)
    assert [(b.low, b.safe, b.unsafe) for b in n.p_at_commit] == [(0.95, 1, 1), (0.99, 1, 0)]
    assert (n.touchdowns, n.unsafe_ground, n.right) == (3, 1, 0.5)
    assert n.bound == unsafe_bound(2, 4)
    assert n.ground_bound == unsafe_bound(1, 4)
    assert n.by_scene["demo"]["landed unsafely"] == 1
    assert n.by_wind == {"2 to 4 m/s": n.outcomes}
    assert n.seconds.median == 10.0


def test_the_dearest_landing_and_the_share_that_is_cheap_are_told() -> None:
    cost = [20.0, 59.0, 61.0, 300.0]
    n = campaign_numbers([made(k, "landed safely", None, None).model_copy(update={"cpu_s": c})
                          for k, c in enumerate(cost)])  # fmt: skip
    assert (n.cpu_most, n.cpu_within) == (300.0, 0.5)
    none = campaign_numbers([])
    assert none.cpu_most is None
    assert none.cpu_within is None


def test_each_landing_has_its_row_and_the_film_of_its_looks(tmp_path: Path) -> None:
    def looks(*given: Any) -> Landing:
        landing = lands(*given)
        photo, p_safe = np.full((200, 200, 3), 90, np.uint8), np.ones((200, 200), np.float32)
        landing.diary.pictures += [LookPicture(look, photo, p_safe, 5.0) for look in landing.diary.looks]
        return landing

    fly_campaign(small([scene(tmp_path)], landings=2), tmp_path / "out", fly=looks)
    record = CampaignFolder(tmp_path / "out").read()[1]
    assert record.film == "looks-00001.webp"
    assert (tmp_path / "out" / record.film).read_bytes()[8:12] == b"WEBP"
    page = (tmp_path / "out" / "campaign.html").read_text()
    assert page.count("data:image/webp;base64,") == 2
    assert page.count("<tbody data-world=") == 2
    assert 'data-outcome="landed safely"' in page


@pytest.mark.skipif(BROWSER is None, reason="needs Chromium: apt-get install chromium")
def test_landings_are_filtered_by_what_a_count_or_a_choice_names(tmp_path: Path) -> None:
    names = [scene(tmp_path), scene(tmp_path, "wet", "water")]
    fly_campaign(small(names), tmp_path / "out", fly=lands)
    shown = "[...document.querySelectorAll('.landings tbody')].filter((r) => !r.hidden).map((r) => r.dataset.outcome)"
    with open_tab(tmp_path / "profile") as tab:
        tab.open(tmp_path / "out" / "campaign.html")
        assert len(tab.run(shown)) == 4
        tab.run("document.querySelector('a[data-outcome=\"landed unsafely\"]').click()")
        assert tab.run(shown) == ["landed unsafely"] * 2
        assert tab.run("document.querySelector('.filters output').textContent") == "2 of 4 landings"
        choose = "(s => { s.value = 'landed safely'; s.dispatchEvent(new Event('input', {bubbles: true})) })"
        tab.run(f"{choose}(document.querySelector('select[name=outcome]'))")
        assert tab.run(shown) == []  # none of the water's
        assert not [url for url in tab.requests if not url.startswith(("data:", "file:"))]


def test_the_page_tells_outcomes_pictures_looks_and_another_campaign(tmp_path: Path) -> None:
    names = [scene(tmp_path), scene(tmp_path, "wet", "water")]
    fly_campaign(small(names), tmp_path / "first", fly=lands)
    numbers = fly_campaign(small(names), tmp_path / "second", beside=tmp_path / "first", fly=lands)
    page = (tmp_path / "second" / "campaign.html").read_text()
    assert "Four landings, two unsafe touchdowns" in page
    assert page.count("data:image/webp;base64,") == 2
    assert len(list((tmp_path / "second").glob("landing-*.webp"))) == 2
    for title in ("Outcomes by world", "What the looks changed", "P(safe) at commit", "Beside another campaign",
                  "of it simulator, s", "100 % took no more than 60 s of it, the dearest",
                  "CPU time, most s"):  # fmt: skip
        assert title in page
    assert "http" not in page.replace("http://www.w3.org", "")
    told = json.loads((tmp_path / "second" / "campaign.json").read_text())
    assert told["numbers"]["outcomes"] == numbers.outcomes
    assert told["numbers"]["looks"] == [
        {"first": "candidate", "last": "site", "places": 4, "first_p": 0.6, "last_p": 0.97}
    ]


# -- the command line


@pytest.fixture
def faked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command line fly made-up landings."""
    real, once_more = runner.fly_campaign, runner.again
    monkeypatch.setattr(runner, "fly_campaign", lambda *a: real(*a, fly=lands))
    monkeypatch.setattr(runner, "again", lambda *a: once_more(*a, fly=lands))


@pytest.mark.usefixtures("faked")
def test_the_command_flies_goes_on_and_compares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, one, two = scene(tmp_path), str(tmp_path / "one"), str(tmp_path / "two")
    assert call(["campaign", name, "--landings", "2", "--seed", "4", "--out", one]) == 0
    out, err = capsys.readouterr()
    assert "landed safely    2\n" in out
    assert "at most 78 % with 95 % confidence" in out
    assert err.startswith("1/2, #0 ")
    assert call(["campaign", "--out", one, "--landings", "3"]) == 0
    assert "landed safely    3\n" in capsys.readouterr().out
    more = ["--no-look-again", "--compare", one]
    assert call(["campaign", name, "--landings", "2", "--seed", "4", "--out", two, *more]) == 0
    assert [r.split() for r in capsys.readouterr().out.splitlines() if r.startswith("landings")] == [
        ["landings", "2", "3"]
    ]
    assert json.loads((tmp_path / "two" / "campaign.json").read_text())["settings"]["executive"]["look_again"] is False
    assert call(["campaign", "--out", one, "--only", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["conditions"]["landing"] == 2


@pytest.mark.usefixtures("faked")
def test_a_landing_that_is_not_repeated_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, out = scene(tmp_path), tmp_path / "out"
    assert call(["campaign", name, "--landings", "1", "--out", str(out)]) == 0
    path = out / "landings.jsonl"
    path.write_text(path.read_text().replace('"verdicts":0', '"verdicts":5'))
    assert call(["campaign", "--out", str(out), "--only", "0"]) == 3
    assert capsys.readouterr().err.endswith(f"landing 0 is not as in {out}: verdicts\n")
    assert call(["campaign", "--out", str(out), "--only", "5"]) == 3
    assert "was not compared" in capsys.readouterr().err
    assert call(["campaign", name, "--out", str(tmp_path / "typo"), "--only", "0"]) == 3
    assert capsys.readouterr().err.endswith(f"was not compared: {tmp_path / 'typo'}: holds no campaign\n")


def test_a_line_of_a_landing_is_never_certain(capsys: pytest.CaptureFixture[str]) -> None:
    simulated.print_landing(runner.Ended(made(0, "landed safely", 0.9999, ()), 1, 1, 0.0))
    assert "P(safe) > 0.999" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["medow"], "no scene is called 'medow'"),
        ([], "holds no campaign; name scenes"),
        (["--seed", "0"], "name SCENES or --world beside"),
        (["--look-again"], "name SCENES or --world beside"),
        (["demo", "--compare", "nowhere"], "nowhere: holds no campaign"),
        (["demo", "--scheduler", "tcp://127.0.0.1:9"], "distributed (Dask) is not installed"),
    ],
)
def test_what_cannot_be_flown_is_one_line(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    refused: Refused,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as where it is not installed
    refused(["campaign", *arguments, "--out", tmp_path / "out"], complaint)
