"""Settings: unknown keys and bad values are refused by name, assignments win, YAML is written and read back."""

from __future__ import annotations

import math
import re
from operator import attrgetter
from pathlib import Path

import hypothesis
import pytest
import yaml
from hypothesis import strategies as st
from pydantic import ValidationError

import alight
from alight.settings import ImuNoise, Settings, load_settings, settings_of_keys, settings_of_run
from alight.settings.loading import all_keys, user_keys
from alight.settings.page import effects, settings_page
from alight.settings.units import unit_of


def test_nothing_needs_to_be_set() -> None:
    assert load_settings() == load_settings("") == load_settings("# only a remark\n") == Settings()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("parallax: {cel: 0.1}", "parallax.cel: unknown key, did you mean parallax.cell?"),
        ("paralax: {cell: 0.1}", "paralax: unknown key, did you mean parallax?"),
        (
            "motion: {filter: {timeofset: 1}}",
            "motion.filter.timeofset: unknown key, did you mean motion.filter.time_offset?",
        ),
        ("motion: {filter: {gates: 1}}", "motion.filter.gates: unknown key, did you mean tuning.filter.gate?"),
        ("tuning: {filter: {gat: 1}}", "tuning.filter.gat: unknown key, did you mean tuning.filter.gate?"),
        ("wings: 2", "wings: unknown key"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_one(text: str, said: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(f"{said}; 'alight settings' lists every key") + "$"):
        load_settings(text)


def test_every_unknown_key_is_named() -> None:
    with pytest.raises(
        ValueError, match=r"^parallax\.cel: unknown key, did you mean parallax\.cell\?; wings: unknown key; "
    ):
        load_settings("{wings: 2, parallax: {cel: 9}}")


@pytest.mark.parametrize(
    ("text", "key", "got"),
    [
        ("parallax: {cell: -1}", "parallax.cell", "-1"),
        ("parallax: {cell: 0}", "parallax.cell", "0"),
        ("parallax: {cell: .nan}", "parallax.cell", "nan"),
        ("parallax: {cell: .inf}", "parallax.cell", "inf"),
        ("tuning: {parallax: {views: 1}}", "tuning.parallax.views", "1"),
        ("tuning: {parallax: {views: 2.5}}", "tuning.parallax.views", "2.5"),
        ("parallax: {method: sgbm}", "parallax.method", "sgbm"),
        ("parallax: {height_range: [1]}", "parallax.height_range.1", ""),
        ("hazards: {p_safe: 1.2}", "hazards.p_safe", "1.2"),
        ("tuning: {hazards: {even_length: 1e9}}", "tuning.hazards.even_length", "1e9"),  # a window beyond OpenCV
        ("tuning: {hazards: {broad_length: 1e9}}", "tuning.hazards.broad_length", "1e9"),
        ("tuning: {hazards: {noise_length: 1e9}}", "tuning.hazards.noise_length", "1e9"),
        ("tuning: {hazards: {bridge: 1e5}}", "tuning.hazards.bridge", "1e5"),  # an ellipse of 10^12 cells
        ("tuning: {hazards: {bridge_plain: 1e5}}", "tuning.hazards.bridge_plain", "1e5"),
        ("lander: {radius: wide}", "lander.radius", "wide"),
        ("lander: 3", "lander", "3"),
        ("motion: {bundle: {focal: free-ish}}", "motion.bundle.focal", "free-ish"),
    ],
)
def test_a_bad_value_is_refused_with_its_key(text: str, key: str, got: str) -> None:
    with pytest.raises(ValueError, match=rf"^{key}: .*{got}") as e:
        load_settings(text)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("lander: {feet: [[0, 0], [1, 0], [2, 0]]}", "not in one line"),
        ("lander: {feet: [[0, 0], [1, 0]]}", "three or more"),
        ("lander: {feet: [[0, 0], [1, 0], [0, 1]], skids: [1.0, 0.5]}", "not both"),
        ("lander: {skids: [0.0, 0.5]}", "above 0"),
    ],
)
def test_gear_that_cannot_stand_is_refused(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=f"^lander: .*{why}"):
        load_settings(text)


def test_all_mistakes_are_told_at_once() -> None:
    with pytest.raises(ValueError, match=r"parallax\.cell: .*; sites\.cuont: unknown key"):
        load_settings("parallax: {cell: -1}\nsites: {cuont: 3}")


@pytest.mark.parametrize("text", ["- a\n- b", "just words", "3"])
def test_text_that_is_no_mapping_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="mapping of keys"):
        load_settings(text)


def test_text_that_is_no_yaml_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match="not valid YAML") as e:
        load_settings("parallax: {cell: 0.1\nlander: [")
    assert "\n" not in str(e.value)


def test_assignments_win_over_the_file_and_the_last_over_the_first() -> None:
    text = "parallax: {cell: 0.5, store_mb: 90}"
    s = load_settings(text, ["parallax.cell=0.2", "parallax.cell=0.3", "lander.radius=2"])
    assert (s.parallax.cell, s.parallax.store_mb, s.lander.radius) == (0.3, 90, 2.0)
    assert s.parallax.method == "batch"  # keys that are not named keep their defaults


def test_a_group_leaves_its_other_keys_as_they_are() -> None:
    s = load_settings("lander: {radius: 0.8}", ["lander={max_roughness: 0.1}"])
    assert (s.lander.radius, s.lander.max_roughness) == (0.8, 0.1)
    for given in (
        {"parallax.quality": "fine", "parallax": {"cell": 0.1}},
        {"parallax": {"cell": 0.1}, "parallax.quality": "fine"},
    ):
        s = settings_of_keys(given)
        assert (s.parallax.quality, s.parallax.cell) == ("fine", 0.1)
    s = settings_of_keys({"motion.filter.time_offset": 0.1, "motion": {"filter": {"time_offset_sigma": 0.2}}})
    assert (s.motion.filter.time_offset, s.motion.filter.time_offset_sigma) == (0.1, 0.2)
    assert settings_of_keys({"lander": {"radius": 2.0}, "lander.radius": 3.0}).lander.radius == 3.0  # the last wins


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("parallax.height_range=[-1, 4]", (-1.0, 4.0)),
        ("parallax.height_range=null", None),
        (" parallax.height_range = [0, 2]", (0.0, 2.0)),
    ],
)
def test_an_assignment_takes_any_yaml(assignment: str, value: object) -> None:
    assert load_settings("", [assignment]).parallax.height_range == value


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ("parallax.cell", "takes key=value, got 'parallax.cell'"),
        ("=3", "takes key=value"),
        ("parallax.cell.deep=3", "cell is not a group of settings"),
        ("parallax.cel=3", r"parallax\.cel: unknown key"),
        ("parallax.cell=[", "not valid YAML"),
        ("nonsense=1", "nonsense: unknown key"),
    ],
)
def test_a_bad_assignment_is_refused_by_name(assignment: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        load_settings("parallax: {cell: 0.5}", [assignment])


@pytest.mark.parametrize("tuning", [False, True])
def test_yaml_goes_out_and_comes_back(tuning: bool) -> None:
    """A changed constant of the tuning is never lost, whether the others are written or not."""
    s = load_settings("", ["parallax.cell=0.07", "lander.skids=[1.2, 0.8]", "tuning.filter.gate=0.9"])
    text = s.to_yaml(tuning)
    assert load_settings(text) == s
    assert load_settings(Settings().to_yaml(tuning)) == Settings()
    tree = yaml.safe_load(text)
    assert tree["parallax"]["cell"] == 0.07
    assert set(tree) == set(Settings.model_fields)  # every group, defaults included
    assert tree["tuning"]["filter"]["gate"] == 0.9
    assert len(tree["tuning"]["filter"]) == (len(Settings().tuning.filter.model_dump()) if tuning else 1)


def test_tuning_is_hidden_until_it_is_changed() -> None:
    assert "tuning" not in yaml.safe_load(Settings().to_yaml())


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("lander.max_slope=5deg", math.radians(5)), ("lander.max_slope=7.5 deg", math.radians(7.5)),
        ("lander.max_slope=5°", math.radians(5)), ("lander.max_slope=0.1rad", 0.1), ("lander.max_slope=0.12", 0.12),
        ("lander.max_slope=1.2rad", 1.2), ("lander.radius=35cm", 0.35), ("lander.radius=2m", 2.0),
        ("lander.max_roughness=1e2mm", 0.1), ("route.cruise_speed=18km/h", 5.0), ("executive.time_budget=2min", 120.0),
        ("motion.filter.time_offset=-12ms", -0.012), ("parallax.height_range=[-1m, 400cm]", (-1.0, 4.0)),
        ("lander.skids={skids}", (0.3, 0.2)), ("sites.separation=null", None), ("lander.radius=2", 2.0),
    ],
)  # fmt: skip
def test_a_value_may_have_its_unit(assignment: str, value: object) -> None:
    assignment = assignment.format(skids="[30cm, 200mm]")
    s = load_settings("", [assignment])
    assert attrgetter(assignment.partition("=")[0])(s) == value
    assert load_settings(s.to_yaml()) == s
    assert settings_of_run(s.model_dump(mode="json")) == s


@pytest.mark.parametrize(
    ("assignment", "line"),
    [
        ("lander.max_slope=5", "lander.max_slope: 5 may be degrees or radians; write 5deg or 5rad"),
        ("lander.max_slope=1.5", "lander.max_slope: 1.5 may be degrees or radians; write 1.5deg or 1.5rad"),
        ("lander.max_slope='2'", "lander.max_slope: 2 may be degrees or radians; write 2deg or 2rad"),
        (
            "motion.given_attitude_sigma=3",
            "motion.given_attitude_sigma: 3 may be degrees or radians; write 3deg or 3rad",
        ),
        ("lander.max_slope=95deg", "lander.max_slope: must be at most 90deg (got 95deg)"),
        ("lander.radius=5kg", "lander.radius: give it in m, cm, mm or km (got '5kg')"),
        ("route.wind=[1m/s, 2s]", "route.wind: give it in m/s, cm/s or km/h (got ['1m/s', '2s'])"),
        ("lander.radius=-30cm", "lander.radius: must be at least 0.001 (got -0.3)"),
        ("sites.count=3m", "sites.count: must be a whole number"),
    ],
)
def test_a_unit_that_does_not_fit_is_refused(assignment: str, line: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(line)):
        load_settings("", [assignment])


def test_models_take_units_and_radians() -> None:
    assert alight.Lander(radius="30cm", max_slope="5deg") == alight.Lander(radius=0.3, max_slope=math.radians(5))
    assert alight.Lander(max_slope=1.2).max_slope == 1.2
    assert settings_of_keys({"lander.max_slope": "5deg"}).lander.max_slope == math.radians(5)


def test_settings_are_printed_with_their_units() -> None:
    lines = load_settings("", ["lander.max_slope=0.123456789", "route.wind=[1, 2]"]).to_yaml(tuning=True).splitlines()
    for line in (
        "  radius: 1.5  # m",
        "  wind: [1.0, 2.0]  # m/s",
        "  cell: null  # m",
        "  count: 8",
        "  model: default",
    ):
        assert line in lines
    assert "  max_slope: 10deg" in Settings().to_yaml().splitlines()
    assert "    acceleration_sigma: 2.0" in lines  # of a unit that cannot be written
    assert "| `lander.max_slope` | 10deg | Steepest slope of the ground, rad |" in settings_page()


@hypothesis.given(st.floats(1e-9, 1.5707))
def test_an_angle_is_printed_as_what_it_is(angle: float) -> None:
    s = Settings(lander=alight.Lander(max_slope=angle))
    assert load_settings(s.to_yaml()) == s


def test_every_length_angle_speed_and_time_of_the_vehicle_has_its_unit() -> None:
    """A unit is read from the description; a number whose description declares none is a share, a weight or a count."""
    bare = {key for key, info in user_keys().items() if "float" in str(info.annotation) and not unit_of(info)}
    assert bare == {
        "sources.rate", "hazards.p_safe", "hazards.alpha", "hazards.beta", "sites.distance_weight",
        "executive.least_battery",
    }  # fmt: skip


def test_settings_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Settings().parallax.cell = 3.0  # type: ignore[misc]


def test_a_user_sets_few_keys() -> None:
    in_flight = [k for k in user_keys() if k.startswith("executive.")]
    assert len(in_flight) <= 8
    assert len(user_keys()) - len(in_flight) <= 50


def test_every_key_has_a_description() -> None:
    bare = [key for key, info in all_keys().items() if len(info.description or "") < 10]
    assert not bare


def test_no_bound_is_overruled_by_another() -> None:
    """Of two bounds of one kind the last wins silently: `Field(0.0, le=100)` of a type with its own bound."""
    for key, info in all_keys().items():
        kinds = [type(bound) for bound in info.metadata]
        assert len(kinds) == len(set(kinds)), key


def test_every_tuned_constant_is_used() -> None:
    """A constant that no stage reads would have no effect."""
    folder = Path(alight.__file__).parent
    sources = [p for p in folder.rglob("*.py") if folder / "settings" not in p.parents]
    read = set(re.findall(r"\.([a-z][a-z0-9_]*)\b", "\n".join(p.read_text(encoding="utf-8") for p in sources)))
    names = {key.rpartition(".")[2] for key in all_keys() if key.startswith("tuning.")}
    assert not names - read - {"imu_margin"}


@pytest.mark.parametrize(
    ("assignment", "stage"),
    [
        ("tuning.tracks.count=99", "tracks"),
        ("motion.filter.time_offset=0.5", "motion.filter"),
        ("tuning.filter.gate=0.5", "motion.filter"),
        ("motion.bundle.focal=free", "motion.bundle"),
        ("tuning.bundle.features=900", "motion.bundle"),
        ("motion.given_position_sigma=0.5", "motion"),
        ("parallax.cell=0.5", "parallax"),
        ("tuning.parallax.views=5", "parallax"),
        ("elevation.max_sigma=0.5", "elevation"),
        ("tuning.elevation.tile=99", "elevation"),
        ("terrain.enabled=false", "terrain"),
        ("tuning.terrain.raised=0.7", "terrain"),
        ("lander.radius=0.7", "lander"),
        ("hazards.p_safe=0.7", "hazards"),
        ("tuning.hazards.noise_length=0.7", "hazards"),
        ("sites.margin=0.7", "sites"),
        ("tuning.sites.roomy=0.7", "sites"),
        ("route.clearance=0.7", "route"),
        ("tuning.route.look_share=0.7", "route"),
        ("executive.search_height=17", "executive"),
        ("tuning.executive.beside=0.7", "executive"),
    ],
)
def test_a_stage_gets_what_is_set_for_it(assignment: str, stage: str) -> None:
    key, _, value = assignment.partition("=")
    records = attrgetter(stage)
    found, plain = (
        getattr(records(s.stages()), key.rpartition(".")[2]) for s in (load_settings("", [assignment]), Settings())
    )
    assert found == yaml.safe_load(value) != plain


def test_the_imu_of_a_recording_is_as_noisy_as_it_states() -> None:
    """A recording's noise replaces defaults, with a margin; zero is ignored. Settings stay."""
    imu = ImuNoise(gyroscope_noise_density=2e-3, accelerometer_noise_density=8e-3, gyroscope_random_walk=0.0)
    settings = Settings()
    found, plain = settings.stages(imu).motion.filter, settings.stages().motion.filter
    assert found.gyro_noise == 1.25 * 2e-3
    assert (found.accelerometer_noise, plain.accelerometer_noise) == (1.25 * 8e-3, 3e-3)
    assert (found.gyro_walk, found.accelerometer_walk) == (plain.gyro_walk, plain.accelerometer_walk) == (3e-5, 3e-4)
    assert plain.gyro_noise == 5e-4
    assert settings == Settings()


def test_stored_settings_read_back_the_same_recording_alike() -> None:
    """The noise that a recording states still counts when a run is repeated with its stored settings."""
    imu = ImuNoise(gyroscope_noise_density=2e-3)
    stored = load_settings(Settings().to_yaml(tuning=True))
    assert stored.stages(imu) == Settings().stages(imu)


def test_settings_of_an_earlier_run_are_read() -> None:
    """Unknown keys are left out."""
    stored = {
        "lander": {"radius": 2.0, "wings": 2},
        "motion": {"filter": {"time_offset": 0.02}},
        "tuning": {"filter": {"gate": 0.9, "wings": 2}},
        "parallax": {"method": "recursive"},
        "weather": {"wind": 3.0},
    }
    s = settings_of_run(stored)
    assert (s.lander.radius, s.motion.filter.time_offset, s.parallax.method) == (2.0, 0.02, "recursive")
    assert s.tuning.filter.gate == 0.9
    assert settings_of_run(s.model_dump(mode="json")) == s


def test_an_impossible_value_of_an_earlier_run_is_named() -> None:
    with pytest.raises(ValueError, match=r"^lander\.radius: "):
        settings_of_run({"lander": {"radius": -1.0}})


def test_the_page_of_settings_has_every_key() -> None:
    page = settings_page()
    assert page.startswith("# Settings\n")
    assert all(f"| `{key}` |" in page for key in all_keys())


def test_the_effects_are_of_constants_that_there_are() -> None:
    keys = {key.removeprefix("tuning.") for key in all_keys() if key.startswith("tuning.")}
    assert not effects().keys() - keys


def test_a_key_without_its_group_is_completed() -> None:
    with pytest.raises(ValueError, match=r"^radius: unknown key, did you mean lander\.radius\?"):
        load_settings("", ["radius=1"])
