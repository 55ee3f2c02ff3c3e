"""Settings: unknown keys and bad values are refused by name, assignments win, YAML goes out and comes back."""

from __future__ import annotations

import pytest
import yaml
from pydantic import ValidationError

from alight.settings import IMU_MARGIN, Settings, load_settings, with_imu


def test_nothing_needs_to_be_set() -> None:
    assert load_settings() == load_settings("") == load_settings("# only a remark\n") == Settings()


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("parallax: {cel: 0.1}", "parallax.cel"),
        ("paralax: {cell: 0.1}", "paralax"),
        ("motion: {filter: {pixelsigma: 1}}", "motion.filter.pixelsigma"),
    ],
)
def test_an_unknown_key_is_refused_by_name(text: str, key: str) -> None:
    with pytest.raises(ValueError, match=rf"^{key}: unknown key; 'alight settings' lists every key$"):
        load_settings(text)


@pytest.mark.parametrize(
    ("text", "key", "got"),
    [
        ("parallax: {cell: -1}", "parallax.cell", "-1"),
        ("parallax: {cell: 0}", "parallax.cell", "0"),
        ("parallax: {cell: .nan}", "parallax.cell", "nan"),
        ("parallax: {cell: .inf}", "parallax.cell", "inf"),
        ("parallax: {views: 1}", "parallax.views", "1"),
        ("parallax: {views: 2.5}", "parallax.views", "2.5"),
        ("parallax: {method: sgbm}", "parallax.method", "sgbm"),
        ("parallax: {height_range: [1]}", "parallax.height_range.1", ""),
        ("hazards: {p_safe: 1.2}", "hazards.p_safe", "1.2"),
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
    text = "parallax: {cell: 0.5, views: 9}"
    s = load_settings(text, ["parallax.cell=0.2", "parallax.cell=0.3", "lander.radius=2"])
    assert (s.parallax.cell, s.parallax.views, s.lander.radius) == (0.3, 9, 2.0)
    assert s.parallax.method == "auto"  # and what nobody names keeps its default


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


def test_yaml_goes_out_and_comes_back() -> None:
    s = load_settings("", ["parallax.cell=0.07", "lander.skids=[1.2, 0.8]", "sources.calibration=rig.yaml"])
    text = s.to_yaml()
    assert load_settings(text) == s
    assert load_settings(Settings().to_yaml()) == Settings()
    tree = yaml.safe_load(text)
    assert tree["parallax"]["cell"] == 0.07
    assert set(tree) == set(Settings.model_fields)  # every group, defaults included


def test_settings_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Settings().parallax.cell = 3.0  # type: ignore[misc]


def test_every_key_says_what_it_means() -> None:
    def bare(model: type, path: str = "") -> list[str]:
        out = []
        for name, f in model.model_fields.items():  # type: ignore[attr-defined]
            inner = f.annotation
            if hasattr(inner, "model_fields"):
                out += bare(inner, f"{path}{name}.")
            elif not f.description:
                out.append(path + name)
        return out

    assert not bare(Settings)


def test_the_imu_of_a_recording_is_as_noisy_as_it_says() -> None:
    """Its numbers replace defaults, with a margin; what the user has set, and what is no noise, stays."""
    noise = {"gyroscope_noise_density": 2e-3, "accelerometer_noise_density": 8e-3, "gyroscope_random_walk": 0.0}
    found = with_imu(load_settings("", ["motion.filter.accelerometer_noise=0.02"]), noise).motion.filter
    assert found.gyro_noise == pytest.approx(IMU_MARGIN * 2e-3)
    assert found.accelerometer_noise == 0.02
    assert found.gyro_walk == load_settings().motion.filter.gyro_walk
    assert with_imu(load_settings(), {}) == load_settings()
