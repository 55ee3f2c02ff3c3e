"""The model of appearance: its features, its training, unknown ground, and its commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from ground import GREEN, ground, textured
from length import first
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from PIL import Image
from refusal import Refused

import alight
from alight.cli import call
from alight.records import LANDABLE, InputError, Terrain
from alight.settings import TerrainSettings
from alight.sources.appearance import DEFAULT_MODEL, model_bytes, read_model
from alight.sources.library import kind_of, read_labelled, read_library
from alight.terrain import classify, describe
from alight.terrain.model import (
    Model,
    against,
    appearance_features,
    distance,
    frame_of,
    level_of,
    log_probability,
    names,
    standardised,
)
from alight.training.confusion import Confusion
from alight.training.patches import LabelledPatch
from alight.training.train import UNTESTED, elsewhere, judge_patches, judge_pixels, train

LOOKS = {  # colour, contrast, size of the grain in pixels
    Terrain.BARE: ((160, 140, 110), 0.04, 1.0),
    Terrain.TREE: ((60, 90, 50), 0.6, 3.0),
    Terrain.WATER: ((70, 85, 90), 0.01, 6.0),
}


def picture(kind: Terrain, seed: int, side: int = 96, light: float = 1.0) -> NDArray[np.uint8]:
    """Return a made-up picture of this kind of ground."""
    colour, contrast, grain = LOOKS[kind]
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(side, side)), (0, 0), grain)
    shade = 1 + contrast * noise / noise.std()
    return np.clip(np.asarray(colour) * light * shade[..., None], 1, 255).astype(np.uint8)


def patches(sites: tuple[str, ...] = ("a", "b", "c"), each: int = 5) -> list[LabelledPatch]:
    return [
        LabelledPatch(picture(kind, 100 * i + j, light=1.0 - 0.15 * i), 0.05, int(kind), site)
        for i, site in enumerate(sites)
        for kind in LOOKS
        for j in range(each)
    ]


@pytest.fixture(scope="module")
def model() -> Model:
    return train(patches())[0]


def test_features_do_not_know_the_exposure() -> None:
    rgb = picture(Terrain.TREE, 1, light=1.5)
    bright, dark = appearance_features(rgb, 0.05), appearance_features((rgb * 0.6).astype(np.uint8), 0.05)
    assert bright is not None
    assert dark is not None
    octaves = [i for i, n in enumerate(names(0)) if n.startswith("detail") and "frame" not in n]
    assert_allclose(bright.values[..., octaves], dark.values[..., octaves], atol=0.15)


def test_detail_is_measured_in_metres_not_in_pixels() -> None:
    rgb = picture(Terrain.TREE, 2, side=192)
    half = cv2.resize(rgb, (96, 96), interpolation=cv2.INTER_AREA)
    fine, coarse = appearance_features(rgb, 0.05), appearance_features(half, 0.1)
    assert fine is not None
    assert coarse is not None
    assert fine.level == coarse.level == 0
    assert_allclose(fine.values, coarse.values, atol=0.12)


def test_levels_follow_the_sampling() -> None:
    assert [level_of(s) for s in (0.02, 0.1, 0.135, 0.2, 0.3, 0.5, 0.6)] == [0, 0, 0, 1, 2, 2, None]
    assert appearance_features(picture(Terrain.BARE, 0), 1.0) is None
    assert [len(names(level)) for level in range(3)] == [19, 16, 12]


def test_what_was_not_seen_has_no_features_and_changes_none_beside_it() -> None:
    rgb = picture(Terrain.BARE, 3, side=200)
    seen = np.ones((200, 200), bool)
    seen[:, 120:] = False
    spoiled = rgb.copy()
    spoiled[:, 120:] = 255
    a, b = appearance_features(spoiled, 0.1, seen), appearance_features(rgb, 0.1)
    assert a is not None
    assert b is not None
    assert np.isnan(a.values[:, -5:]).all()
    assert np.isfinite(a.values[:, :25]).all()
    assert_allclose(a.values[:, :15], b.values[:, :15], atol=0.1)


def test_a_frame_takes_away_what_all_its_ground_has_in_common() -> None:
    values = np.random.default_rng(0).normal(size=(50, len(names(0)))).astype(np.float32)
    shifted = values.copy()
    shifted[:, :4] += 3.0
    a, b = (against(v, frame_of(v, 0))[:, 4:8] for v in (values, shifted))
    assert_allclose(a, b, atol=1e-5)
    assert (frame_of(np.full((3, len(names(0))), np.nan, np.float32), 0) == 0).all()


def test_it_learns_what_it_is_shown_and_says_so_of_places_left_out(model: Model) -> None:
    left_out = elsewhere(patches())
    assert left_out.accuracy() > 0.9
    assert left_out.hazards_called_safe(0.5) < 0.1
    assert judge_patches(model, patches(("d",))).accuracy() > 0.9
    assert "3 site(s): a, b, c" in model.provenance
    assert all(h is None or 0.4 < h.temperature < 11 for h in model.heads)


def test_far_from_everything_learned_it_says_nothing(model: Model) -> None:
    head = model.heads[0]
    assert head is not None
    near = head.mean[None] + head.spread * head.centres[:1]
    far = near + 100 * head.spread
    assert distance(head, standardised(head, near))[0] < 1
    sure, unsure = (np.exp(log_probability(head, v)).max() for v in (near, far))
    assert sure > 0.6
    assert unsure < 0.5
    assert_allclose(np.exp(log_probability(head, far)).sum(), 1, rtol=1e-5)


def test_a_site_alone_cannot_be_left_out_and_one_class_is_no_model() -> None:
    with pytest.raises(ValueError, match="two sites"):
        elsewhere(patches(("a",)))
    with pytest.raises(ValueError, match="two classes"):
        train([p for p in patches() if p.kind == Terrain.BARE])
    alone, tested = train(patches(("a",), 2))
    assert tested is None
    assert alone.heads[0] is not None


def test_a_model_comes_back_from_its_file_as_it_was(model: Model, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    path.write_bytes(model_bytes(model))
    again = read_model(path)
    assert again.provenance == model.provenance
    x = np.random.default_rng(0).normal(size=(7, len(names(0)))).astype(np.float32)
    a, b = model.heads[0], again.heads[0]
    assert a is not None
    assert b is not None
    assert_allclose(log_probability(a, x), log_probability(b, x), atol=1e-6)


def test_the_default_model_is_small_and_credited() -> None:
    assert DEFAULT_MODEL.stat().st_size < 100_000
    assert "boruszyn" in read_model().provenance
    credits = DEFAULT_MODEL.with_suffix(".md").read_text(encoding="utf-8")
    assert "Andrew Zaborowski" in credits
    assert "CC BY 3.0" in credits


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 cut off"])
def test_a_file_that_is_no_model_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"m\.npz"):
        read_model(path)
    with pytest.raises(InputError, match="nowhere"):
        read_model(tmp_path / "nowhere.npz")


@pytest.mark.parametrize(
    ("name", "kind"),
    [("5_water", 5), ("water", 5), ("5", 5), ("Tall-Grass", 3), ("8_building_vehicle", 8), ("licences", None)],
)
def test_folders_are_named_for_classes(name: str, kind: int | None) -> None:
    assert kind_of(name) == kind


def fill(folder: Path, sites: tuple[str, ...] = ("north", "south")) -> Path:
    """Write a library, with a folder for each class and a folder for each site in it."""
    for p_index, patch in enumerate(patches(sites, 3)):
        place = folder / Terrain(patch.kind).name.lower() / patch.site
        place.mkdir(parents=True, exist_ok=True)
        Image.fromarray(patch.rgb).save(place / f"{p_index}.png")
    return folder


def test_train_and_test_on_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = fill(tmp_path / "own"), tmp_path / "own.npz"
    assert {p.site for p in read_library(folder)} == {"north", "south"}
    assert call(["terrain", "train", str(folder), "--out", str(out)]) == 0
    assert "site north" in capsys.readouterr().out
    assert call(["terrain", "test", str(folder), "--model", str(out)]) == 0
    told = capsys.readouterr().out
    assert "all sites" in told
    assert "hazards called safe 0 %" in told
    assert call(["terrain", "test", str(folder), "--leave-out"]) == 0
    assert "site south" in capsys.readouterr().out
    assert call(["terrain", "test", "--model", str(out)]) == 0
    assert "trained on 18 patches" in capsys.readouterr().out


@pytest.mark.parametrize("damage", ["missing", "no classes", "empty class", "cut off", "grey", "one site", "index"])
def test_a_bad_folder_is_refused_in_one_line(damage: str, tmp_path: Path, refused: Refused) -> None:
    folder = fill(tmp_path / "own")
    first = next((folder / "bare").rglob("*.png"))
    says_ = {"missing": "no such folder", "no classes": "named for a class", "empty class": "no pictures"}
    says_ |= {"cut off": "not a readable", "grey": "grey", "one site": "two sites", "index": "gsd_m"}
    if damage == "missing":
        folder = tmp_path / "nowhere"
    elif damage == "no classes":
        folder = folder / "bare"
    elif damage == "empty class":
        (folder / "rock").mkdir()
    elif damage == "cut off":
        first.write_bytes(first.read_bytes()[:200])
    elif damage == "grey":
        Image.open(first).convert("L").save(first)
    elif damage == "one site":
        folder = fill(tmp_path / "one", ("all",))
    else:
        (folder / "index.csv").write_text(f"file,gsd_m\n{first.relative_to(folder).as_posix()},coarse\n")
    refused(["terrain", "test", folder, "--leave-out"], says_[damage])


def test_pictures_with_a_label_a_pixel_are_judged_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for sub in ("images", "labels"):
        (tmp_path / sub).mkdir()
    rgb = np.hstack([picture(Terrain.BARE, 5, 128), picture(Terrain.TREE, 6, 128)])
    label = np.full(rgb.shape[:2], int(Terrain.BARE), np.uint8)
    label[:, 128:] = Terrain.TREE
    label[:8] = 0
    Image.fromarray(rgb).save(tmp_path / "images" / "x.png")
    Image.fromarray(label).save(tmp_path / "labels" / "x.png")
    assert [n for n, _, _ in read_labelled(tmp_path)] == ["x"]
    assert call(["terrain", "test", str(tmp_path)]) == 0
    assert "tree" in capsys.readouterr().out
    assert set(alight.evaluate_appearance(tmp_path).kinds.tolist()) == {int(Terrain.BARE), int(Terrain.TREE)}
    Image.fromarray(label[:50]).save(tmp_path / "labels" / "x.png")
    with pytest.raises(InputError, match="one grey value a pixel"):
        list(read_labelled(tmp_path))


def test_confusion_counts_what_matters_for_landing() -> None:
    p = np.array([[0.9, 0.1], [0.4, 0.6], [0.2, 0.8], [0.7, 0.3]])
    c = Confusion(np.array([1, 1, 5, 5], np.uint8), np.array(["a"] * 4), np.array([1, 5], np.uint8), np.log(p))
    assert c.accuracy() == c.macro_recall() == c.hazards_called_safe(0.5) == c.safe_refused(0.5) == 0.5
    assert c.hazards_called_safe(c.least_for(0.05)) == 0.0


def test_appearance_takes_and_never_gives() -> None:
    rng = np.random.default_rng(4)
    rgb = textured(GREEN, (160, 160), 0.08, 3)
    rgb[:80] = cv2.resize(picture(Terrain.TREE, 7), (160, 80))
    e = ground(0.02 * rng.normal(size=(160, 160)), sigma=0.03, rgb=rgb)
    plain = classify(e, TerrainSettings())
    judged = classify(e, TerrainSettings(appearance=1.0), read_model())
    assert (judged.landable <= plain.landable + 1e-6).all()
    assert (judged.landable < plain.landable - 0.02).any()
    assert "alone" in describe(e, TerrainSettings(), None)
    assert "appearance" in describe(e, TerrainSettings(), read_model())
    grey = replace(e, rgb=np.repeat(e.rgb[..., :1], 3, axis=2))
    assert "grey" in describe(grey, TerrainSettings(), read_model())


@pytest.mark.parametrize("every", first(1, [6, 3]))
def test_the_library_is_judged_as_well_as_claimed(shared_data: Path, every: int) -> None:
    result = elsewhere([p for i, p in enumerate(read_library(shared_data / "terrain-library")) if i % every == 0])
    assert {int(k) for k in result.classes} >= {int(k) for k in LANDABLE}
    assert result.accuracy() > 0.5
    assert result.hazards_called_safe(0.5) < 0.20
    assert result.safe_refused(0.5) < 0.35


def coarser(site: str, sampling: float) -> list[LabelledPatch]:
    """Return the patches of one site with pixels that cover more ground."""
    return [replace(p, sampling=sampling) for p in patches((site,))]


def test_a_site_too_coarse_for_a_level_is_left_out_of_its_test() -> None:
    one, two = patches(("a",)), patches(("a", "b"))
    assert set(elsewhere([*two, *coarser("c", 0.2)]).sites) == {"a", "b"}
    assert set(elsewhere([*one, *coarser("c", 0.2)]).sites) == {"a", "c"}  # at the level that both can fill
    with pytest.raises(ValueError, match="two sites"):
        elsewhere([*coarser("a", 0.5), *coarser("b", 0.9)])
    made, tested = train([*one, *coarser("c", 0.2)])
    assert tested is not None
    assert made.heads[0] is not None
    assert made.heads[0].temperature == UNTESTED


def test_pictures_too_coarse_for_a_model_are_refused(model: Model) -> None:
    with pytest.raises(InputError, match=r"too coarse for this model: a pixel must be smaller than 0\.54 m"):
        judge_patches(model, coarser("a", 0.9))
    rgb, label = picture(Terrain.TREE, 0, side=200), np.full((200, 200), int(Terrain.TREE), np.uint8)
    with pytest.raises(InputError, match="too coarse"):
        judge_pixels(model, [("a", rgb, label)], 0.9)
    with pytest.raises(InputError, match="no pixel of the labels has a class"):
        judge_pixels(model, [("a", rgb, 0 * label)], 0.1)
    with pytest.raises(InputError, match="too coarse"):
        elsewhere([*coarser("a", 0.9), *coarser("b", 0.9)])
