"""Bundle adjustment on rendered photos of a textured relief: the whole way from pixels to poses."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from alight.geometry import Camera, Pose, enu_from_flu, so3_exp, so3_log
from alight.photos.bundle.adjust import adjust
from alight.pipeline.navigation import Trajectory
from alight.records import Frame, InputError, MissingExtraError, NavSample, Rig, RigCamera
from alight.settings import BundleSettings
from alight.spread import nmad

F64 = NDArray[np.float64]
CAMERA = Camera(480, 384, 520.0, 520.0, 241.5, 190.0)
LOOKS_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # the optical axis is body x
SETTINGS = BundleSettings(features=1200, neighbours=4, lens="held")
CELL = 0.1  # m, of the texture


def height(x: F64, y: F64) -> F64:
    """Relief of 4 m."""
    return 2.0 * np.sin(x / 9.0) * np.cos(y / 7.0)


def texture(seed: int) -> NDArray[np.uint8]:
    """Blobs of several sizes over 90 m."""
    rng = np.random.default_rng(seed)
    total = sum(cv2.GaussianBlur(rng.normal(size=(900, 900)), (0, 0), s) * s for s in (1.5, 3.0, 6.0))
    return np.asarray(np.clip(128 + 45 * total / np.std(total), 0, 255), dtype=np.uint8)


def photo(ground: NDArray[np.uint8], C: F64, R: F64) -> NDArray[np.uint8]:
    """Cast each pixel's ray on the relief and look the texture up."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
    ray = CAMERA.rays(np.stack([u, v], axis=-1)) @ R.T
    h = np.zeros(u.shape)
    for _ in range(12):
        xyz = C + ray * ((h - C[2]) / ray[..., 2])[..., None]
        h = height(xyz[..., 0], xyz[..., 1])
    at = ((xyz[..., :2] + 45.0) / CELL).astype(np.float32)
    return np.asarray(cv2.remap(ground, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))


@pytest.fixture(scope="module")
def survey() -> tuple[list[Frame], list[NavSample], F64, F64]:
    """Two strips of four photos at 40 m, a third of the height apart, one of another place, one with a GPS jump."""
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(9)
    ground, elsewhere = texture(3), texture(4)
    frames, nav, centres, rotations = [], [], [], []
    for k in range(10):
        C = np.array([-18.0 + 12.0 * (k % 4), -6.0 + 12.0 * (k // 4 % 2), 40.0 + k // 8]) + rng.normal(0, 0.5, 3)
        body = so3_exp(rng.normal(0, 0.02, 3)) @ enu_from_flu(np.pi / 2 if k < 4 else -np.pi / 2, -np.pi / 2, 0.0)
        R = body @ LOOKS_FORWARD
        grey = photo(elsewhere if k == 8 else ground, C, R)
        frames.append(Frame(k, (np.repeat(grey[:, :, None], 3, axis=2),), f"{k}.jpg"))
        said = C + rng.normal(0, 0.02, 3) + ([28.0, 9.0, -3.0] if k == 9 else 0.0)
        nav.append(NavSample(k, said, body, sigma_position=np.full(3, 0.02)))
        centres.append(C)
        rotations.append(R)
    return frames, nav, np.array(centres), np.array(rotations)


def rig() -> Rig:
    return Rig((RigCamera("cam0", CAMERA, Pose(LOOKS_FORWARD)),))


@pytest.fixture(scope="module")
def adjusted(survey: tuple[list[Frame], list[NavSample], F64, F64]) -> tuple[Trajectory, list[float]]:
    """Adjust the survey with every gimbal tag turned by half a turn; return the result and its progress."""
    frames, nav, _, _ = survey
    turned = [
        NavSample(
            s.t_ns, s.position_world, s.world_from_body @ np.diag([1.0, -1.0, -1.0]), sigma_position=s.sigma_position
        )
        for s in nav
        if s.world_from_body is not None
    ]
    progress: list[float] = []
    return adjust(frames, turned, rig(), SETTINGS, progress.append), progress


def test_poses_come_back_from_pixels(
    survey: tuple[list[Frame], list[NavSample], F64, F64], adjusted: tuple[Trajectory, list[float]]
) -> None:
    _, _, centres, rotations = survey
    assert [m.t_ns for m in adjusted[0].motions] == [0, 1, 2, 3, 4, 5, 6, 7, 9]
    for motion in adjusted[0].motions:
        k, cam = motion.t_ns, motion.world_from_cams[0]
        assert np.linalg.norm(cam.translation - centres[k]) < 0.08
        assert np.linalg.norm(so3_log(cam.rotation @ rotations[k].T)) < 5e-3
        body = motion.world_from_body @ rig().cameras[0].body_from_cam
        assert np.abs(body.matrix - cam.matrix).max() < 1e-9
        assert motion.tracks > 50


def test_points_lie_on_the_relief(adjusted: tuple[Trajectory, list[float]]) -> None:
    p = adjusted[0].points
    off = p[:, 2] - height(p[:, 0], p[:, 1])
    assert len(p) > 300
    assert abs(np.median(off)) < 0.15
    assert nmad(off) < 0.1


def test_a_photo_of_another_place_is_left_out_with_a_warning(adjusted: tuple[Trajectory, list[float]]) -> None:
    result = adjusted[0]
    assert 8 not in {m.t_ns for m in result.motions}
    assert any(w.startswith("8.jpg: photo left out") for w in result.warnings)


def test_half_turned_tags_are_reported(adjusted: tuple[Trajectory, list[float]]) -> None:
    assert adjusted[0].notes["attitude_turned"] == 9
    assert any("half a turn off" in w for w in adjusted[0].warnings)


def test_a_gps_jump_is_ignored_and_reported(adjusted: tuple[Trajectory, list[float]]) -> None:
    assert adjusted[0].notes["gps_ignored"] == 1
    assert "9.jpg: GPS position contradicts the pictures and was ignored" in adjusted[0].warnings


def test_notes_say_what_was_held(adjusted: tuple[Trajectory, list[float]]) -> None:
    notes = adjusted[0].notes
    assert notes["focal"] == "held"
    assert notes["focal_px"] == [520.0, 520.0]
    assert notes["lens_free"] == []
    assert isinstance(notes["reprojection_rms_px"], float)
    assert notes["reprojection_rms_px"] < 1.0


def test_progress_rises_to_one(adjusted: tuple[Trajectory, list[float]]) -> None:
    progress = adjusted[1]
    assert progress == sorted(progress)
    assert progress[-1] == pytest.approx(1.0)


def test_photos_without_texture_give_a_reason(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pycolmap")
    grey = np.full((384, 480), 90, np.uint8)
    frames = [Frame(k, (grey,), f"{k}.jpg") for k in range(3)] + [Frame(3, (None,), "3.jpg")]
    nav = [NavSample(k, np.array([5.0 * k, 0.0, 40.0]), None) for k in range(4)]
    result = adjust(frames, nav, rig(), SETTINGS)
    assert result.motions == ()
    assert result.warnings == ("no photo could be registered: the photos have no texture",)
    assert capfd.readouterr() == ("", "")


def test_photos_without_gps_give_a_reason(survey: tuple[list[Frame], list[NavSample], F64, F64]) -> None:
    result = adjust(survey[0][:3], [None] * 3, rig(), SETTINGS)
    assert result.motions == ()
    assert "fewer than two photos have a GPS position" in result.warnings[0]


def test_one_line_without_attitudes_gives_a_reason(survey: tuple[list[Frame], list[NavSample], F64, F64]) -> None:
    """Nothing then tells how far the line is rolled about itself."""
    frames, nav = survey[0][:4], survey[1][:4]
    line = [
        NavSample(n.t_ns, np.array([12.0 * k, 0.0, 40.0]), None, sigma_position=np.full(3, 30.0))
        for k, n in enumerate(nav)
    ]
    result = adjust(frames, line, rig(), SETTINGS)
    assert result.motions == ()
    assert "one line and have no attitude" in result.warnings[0]


def test_frames_and_samples_must_pair() -> None:
    pytest.importorskip("pycolmap")
    with pytest.raises(InputError, match="1 frames and 0 navigation samples"):
        adjust([Frame(0, (None,))], [], rig(), SETTINGS)


def test_missing_pycolmap_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingExtraError, match=r"pycolmap.*alight\[photos\]"):
        adjust([], [], rig(), SETTINGS)


def test_real_photos_of_one_strip(shared_data: Path) -> None:
    """Five photos at half size get the poses that structure from motion of all 32 photos gives."""
    pytest.importorskip("pycolmap")
    from alight.geometry import LocalFrame
    from alight.runner.opening import open_source
    from alight.settings import Settings

    folder = shared_data / "mirafiori"
    source = open_source(folder / "images", Settings.model_validate({"sources": {"skip": 3}}))
    nav, frames = [], []
    for event in source.events():
        if isinstance(event, Frame):
            frames.append(event)
        elif isinstance(event, NavSample):
            nav.append(event)
        if len(frames) == 5:
            break
    result = adjust(frames, nav[:5], source.rig, BundleSettings(features=1500, image_px=800, neighbours=4))
    reference = np.load(folder / "sfm_reference.npz")
    latitude, longitude, height_ = reference["origin_llh"]
    local = LocalFrame(float(latitude), float(longitude), float(height_))
    names = [str(n) for n in reference["names"]]
    for frame, motion in zip(frames, result.motions, strict=True):
        truth = local.to_geodetic(reference["centers_enu"][names.index(Path(frame.name).name)])
        assert np.linalg.norm(motion.world_from_cams[0].translation - source.local.to_enu(*truth)) < 0.10
