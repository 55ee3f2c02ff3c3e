"""Pictures of photo sets: more than eight bits, grey, alpha, CMYK, several in a file, extras, false colours, copies."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import damage as d
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image

from alight.photos.reading import photo_selection
from alight.photos.reading.photo_tags import read_tags
from alight.photos.reading.repeated import repeated_photos
from alight.records import Frame, InputError
from alight.runner.opening import open_source
from alight.sources import Source
from alight.sources.images import image_size, read_image

GREY = np.asarray(d.picture(3, (64, 48), grey=True))
COLOUR = np.asarray(d.picture(4, (64, 48)))
SMOOTH = d.picture(4, (32, 24)).resize((64, 48))
LENS = {41989: 28}
AT = rasterio.Affine.translation(1, 1)  # else rasterio warns
PALETTES = cv2.COLORMAP_INFERNO, cv2.COLORMAP_JET, cv2.COLORMAP_HOT


def saved(path: Path, pixels: NDArray[Any], second: int = 10) -> None:
    """Write a picture of any depth as TIFF or PNG, with the tags of a photo."""
    like = d.write_photo(
        path.with_name("tags.jpg"), second=str(second), place=(45 + 3e-6 * second, 7.6, 350), photo=LENS
    )
    with Image.open(like) as photo:
        exif = photo.getexif()
    like.unlink()
    if path.suffix == ".png" and pixels.ndim == 3:
        cv2.imwrite(str(path), pixels[..., ::-1])
        return
    image = Image.fromarray(pixels)
    image.save(path, exif=exif.tobytes() if path.suffix == ".png" else exif)


def shown(source: Source) -> list[NDArray[np.uint8]]:
    return [np.asarray(e.images[0]) for e in source.events() if isinstance(e, Frame)]


@pytest.mark.parametrize("suffix", [".tif", ".png"])
@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_one_range_stretches_all_pictures_of_a_set(tmp_path: Path, bits: int, suffix: str) -> None:
    """The second picture is half as bright as the first, and stays so."""
    bright = GREY.astype(np.uint16) << (bits - 8)
    saved(tmp_path / f"a{suffix}", bright, 10)
    saved(tmp_path / f"b{suffix}", bright // 2, 20)
    source = open_source(tmp_path)
    first, second = (p.astype(float) for p in shown(source))
    np.testing.assert_allclose(first, GREY, atol=2.5)
    np.testing.assert_allclose(second, GREY / 2, atol=2.5)
    assert source.notes["levels"].endswith("of 2 pictures become 0 to 255")


@pytest.mark.parametrize("scale", [1.0, 1 / 255])
def test_reflectances_and_hot_pixels(tmp_path: Path, scale: float) -> None:
    values = GREY.astype(np.float32) * scale
    values[5, 5], values[6, 6] = 1e6, np.nan
    saved(tmp_path / "a.tif", values)
    (found,) = shown(open_source(tmp_path))
    others = np.ones(GREY.shape, dtype=bool)
    others[5, 5] = others[6, 6] = False
    np.testing.assert_allclose(found[others].astype(float), GREY[others], atol=2.5)


def test_colours_of_sixteen_bits_keep_their_ratios(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", "GTiff", 64, 48, 3, dtype="uint16", transform=AT) as raster:
        raster.write(np.moveaxis((COLOUR // 2 + 100).astype(np.uint16) * 16, -1, 0))
    from alight.sources.image_formats import levels_of

    found = read_image(path, (64, 48), levels_of([path])).astype(float)
    np.testing.assert_allclose(found, (COLOUR // 2 + 100.0) * 255 / 227, atol=1.5)


@pytest.mark.parametrize(
    ("image", "options", "channels"),
    [
        (Image.fromarray(GREY), {}, 1),
        (Image.fromarray(GREY).convert("LA"), {}, 1),
        (Image.fromarray(COLOUR).convert("RGBA"), {}, 3),
        (Image.fromarray(COLOUR).convert("P"), {}, 3),
        (Image.fromarray(COLOUR).convert("CMYK"), {"format": "JPEG"}, 3),
        (Image.fromarray(COLOUR).convert("CMYK"), {"format": "TIFF"}, 3),
        (Image.fromarray(COLOUR), {"format": "JPEG", "subsampling": 0, "quality": 98}, 3),
        (SMOOTH, {"format": "MPO", "save_all": True, "append_images": [d.picture(9, (32, 24))], "quality": 98}, 3),
    ],
    ids=["grey", "grey alpha", "alpha", "palette", "cmyk", "cmyk tiff", "4:4:4", "mpo"],
)  # fmt: skip
def test_kinds_of_pictures(tmp_path: Path, image: Image.Image, options: dict[str, Any], channels: int) -> None:
    """All are read as they look; of several pictures in one file, the first."""
    path = tmp_path / f"a.{options.get('format', 'png').lower().replace('mpo', 'jpg')}"
    image.save(path, **options)
    assert image_size(path) == (64, 48)
    found = read_image(path, (64, 48))
    assert found.shape == ((48, 64) if channels == 1 else (48, 64, 3))
    like = GREY if channels == 1 else np.asarray(image.convert("RGB"))
    assert np.abs(found.astype(int) - like).mean() < 25  # JPEG of noise


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_what_transparency_hides_has_no_edges(tmp_path: Path, suffix: str, mode: str) -> None:
    """Hidden pixels continue their surroundings; an alpha channel that hides all is none."""
    ramp = np.tile(np.linspace(60, 180, 64), (48, 1)).astype(np.uint8)
    hidden = np.zeros(ramp.shape, bool)
    hidden[30:, 20:50] = True
    for name, alpha in (("a", ~hidden), ("b", np.ones_like(hidden)), ("c", np.zeros_like(hidden))):
        image = Image.fromarray(np.where(hidden, 0, ramp).astype(np.uint8)).convert(mode)
        image.putalpha(Image.fromarray((255 * alpha).astype(np.uint8)))
        image.save(tmp_path / f"{name}{suffix}")
    a, b, c = (read_image(tmp_path / f"{name}{suffix}", (64, 48)).astype(float) for name in "abc")
    assert a.shape == ((48, 64) if mode == "LA" else (48, 64, 3))
    assert np.array_equal(a[~hidden], b[~hidden])
    assert np.array_equal(b, c)
    assert abs(a[hidden].T - ramp[hidden]).max() < 40
    assert abs(np.diff(a, axis=0)).max() < 15
    assert abs(np.diff(b, axis=0)).max() > 60


def test_hidden_pixels_of_a_set_are_reported(tmp_path: Path) -> None:
    saved(
        tmp_path / "a.tif",
        np.dstack([COLOUR, np.where(np.arange(64) < 16, 0, 255) + np.zeros((48, 1), int)]).astype(np.uint8),
    )
    source = open_source(tmp_path)
    assert any("transparency hides pixels (25.0% of a.tif)" in w for w in source.warnings)
    assert shown(source)[0].shape == (48, 64, 3)


@pytest.mark.parametrize(("suffix", "extra"), [("heic", "heic"), ("HEIF", "heic"), ("DNG", "raw")])
def test_a_missing_extra_is_named_in_one_line(
    tmp_path: Path, suffix: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("alight.sources.image_formats.find_spec", lambda package: None if package != "PIL" else 1)
    for k in range(3):
        (tmp_path / f"b{k}.{suffix}").write_bytes(b"")
    with pytest.raises(
        InputError,
        match=rf"pictures can be read .3 found.; .* is not installed; mend it with: pip install 'alight\[{extra}\]'",
    ):
        open_source(tmp_path)
    d.write_photos(tmp_path, 2)
    source = open_source(tmp_path)
    assert [w for w in source.warnings if extra in w] == source.warnings
    assert source.warnings[0].startswith("3 photo(s) are left out: ")


def test_a_raw_picture_is_developed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its tags are those of a TIFF that pillow cannot decode; beside a JPEG of the same name it is not used."""

    class Raw:
        sizes = SimpleNamespace(width=64, height=48)

        def __enter__(self) -> Raw:
            return self

        def __exit__(self, *_: object) -> None: ...

        def postprocess(self, **_: object) -> NDArray[np.uint8]:
            return COLOUR

    monkeypatch.setitem(sys.modules, "rawpy", SimpleNamespace(imread=lambda _: Raw(), LibRawError=ValueError))
    monkeypatch.setattr("alight.sources.image_formats.find_spec", lambda _: 1)
    saved(tmp_path / "a.tif", GREY)
    (tmp_path / "a.tif").rename(tmp_path / "a.DNG")
    (found,) = shown(open_source(tmp_path))
    np.testing.assert_array_equal(found, COLOUR)
    d.write_photo(tmp_path / "a.jpg", photo=LENS)
    assert [p.name for p in photo_selection.find_photos(tmp_path).files] == ["a.jpg"]


def test_heic_of_a_phone(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif", reason="needs the extra heic")
    heif.register_heif_opener()
    like = d.write_photo(tmp_path / "tags.jpg", photo=LENS)
    with Image.open(like) as photo:
        d.picture(2).save(tmp_path / "a.heic", exif=photo.getexif().tobytes(), quality=95)
    like.unlink()
    source = open_source(tmp_path)
    assert source.notes["camera"].startswith("DJI FC1, 64x48")
    assert shown(source)[0].shape == (48, 64, 3)


def false_coloured(palette: int, size: tuple[int, int] = (160, 120)) -> Image.Image:
    grey = cv2.resize(GREY[:12, :16], size, interpolation=cv2.INTER_CUBIC)
    return Image.fromarray(np.ascontiguousarray(cv2.applyColorMap(grey, palette)[..., ::-1]))


def write_set(folder: Path, name: str = "DJI_000{}", **how: Any) -> Source:
    for k in range(3):
        d.write_photo(folder / (name.format(k) + ".JPG"), place=(45 + 3e-5 * k, 7.6, 350), photo=LENS, **how)
    return open_source(folder)


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("palette_{}", {"image": false_coloured(cv2.COLORMAP_INFERNO, (180, 135)), "size": (180, 135)}),
        ("DJI_000{}_T", {"size": (40, 30)}),
        ("DJI_20230930152833_000{}_T_point1", {"size": (40, 30)}),
        ("IRX_000{}", {"size": (40, 30)}),
        ("a{}", {"xmp": d.xmp_packet(d.dji_tags(ImageSource="InfraredCamera"))}),
        ("b{}", {"xmp": d.xmp_packet({"BandName": "LWIR"}, d.PIX4D)}),
        ("c{}", {"main": {271: "FLIR"}, "size": (160, 120)}),
        *((f"{'efg'[k]}{{}}", {"image": false_coloured(p), "size": (160, 120)}) for k, p in enumerate(PALETTES)),
    ],
)
def test_a_set_of_temperatures_is_read_as_grey(tmp_path: Path, name: str, how: dict[str, Any]) -> None:
    source = write_set(tmp_path, name, **how)
    assert any("the colours of all 3 pictures show temperatures" in w for w in source.warnings)
    assert all(p.ndim == 2 for p in shown(source))


@pytest.mark.parametrize(
    "how",
    [
        {"xmp": d.xmp_packet({"BandName": "NIR, Green, Blue"}, d.PIX4D)},
        {"main": {271: "MAPIR"}, "model": "Survey3W_RGN"},
    ],
)
def test_a_colour_that_is_infrared(tmp_path: Path, how: dict[str, Any]) -> None:
    source = write_set(tmp_path, **how)
    assert any("show near infrared" in w for w in source.warnings)
    assert all(p.ndim == 2 for p in shown(source))


def test_a_single_band_is_reported(tmp_path: Path) -> None:
    source = write_set(tmp_path, xmp=d.xmp_packet({"BandName": "NIR"}, d.PIX4D), image=Image.fromarray(GREY))
    assert "0 picture(s) of single bands are left out: of a multispectral camera band NIR is used" in source.warnings


def test_photos_as_small_as_a_thermal_sensor_keep_their_colours(tmp_path: Path) -> None:
    grey = np.asarray(d.picture(2, (160, 120), grey=True)).astype(int)
    muted = np.stack([grey, grey + 10, grey - 15], axis=-1).clip(0, 255).astype(np.uint8)
    source = write_set(tmp_path, image=Image.fromarray(muted), size=(160, 120))
    assert shown(source)[0].ndim == 3


def test_letters_that_an_owner_gave_are_no_thermal_pictures(tmp_path: Path) -> None:
    """`plot_T` of the same camera stays; of another camera it is thermal, also of a size that no sensor has."""
    for k in range(3):
        d.write_photo(tmp_path / f"plot{k}{'_T' * (k == 2)}.jpg", second=f"{10 + k}", photo=LENS)
    assert len(shown(open_source(tmp_path))) == 3
    d.write_photo(tmp_path / "plot3_IR.jpg", size=(72, 54), photo=LENS)
    source = open_source(tmp_path)
    assert source.counts["thermal pictures"] == 1
    assert all(p.ndim == 3 for p in shown(write_set(tmp_path / "roof", "roof_IR_{}")))


def test_grey_pictures_of_a_thermal_size_are_named(tmp_path: Path) -> None:
    grey = Image.fromarray(cv2.resize(GREY, (160, 120))).convert("RGB")
    source = write_set(tmp_path / "a", image=grey, size=(160, 120))
    assert any("show temperatures, if of a thermal camera" in w for w in source.warnings)
    assert not any(
        "temperatures" in w for w in write_set(tmp_path / "b", image=grey.resize((200, 120)), size=(200, 120)).warnings
    )


def test_panoramas_are_left_out(tmp_path: Path) -> None:
    pano = d.xmp_packet({"ProjectionType": "equirectangular"}, "http://ns.google.com/photos/1.0/panorama/")
    d.write_photo(tmp_path / "pano.jpg", xmp=pano, photo=LENS, size=(80, 40))
    with pytest.raises(InputError, match=r"all 1 pictures are panoramas \(pano.jpg\)"):
        open_source(tmp_path)
    d.write_photos(tmp_path, 3)
    d.write_photo(tmp_path / "wide.jpg", second="40", photo=LENS, size=(80, 40))
    source = open_source(tmp_path)
    said = "1 panorama(s) are left out (first: pano.jpg); 1 picture(s) are twice as wide as high, as panoramas are"
    assert any(w.startswith(said) for w in source.warnings)
    assert [p.left_out for p in source.photos if p.name == "pano.jpg"] == ["a panorama (equirectangular)"]


def test_copies_count_once(tmp_path: Path) -> None:
    """Copies of a file; the same exposure saved again, also smaller; another exposure of the same second stays."""
    d.write_photos(tmp_path, 3)
    d.write_photo(tmp_path / "DJI_0000.JPG", image=false_coloured(cv2.COLORMAP_BONE, (64, 48)))
    shutil.copy(tmp_path / "DJI_0001.JPG", tmp_path / "DJI_0001 (1).JPG")
    (tmp_path / "copy").mkdir()
    shutil.copy(tmp_path / "DJI_0002.JPG", tmp_path / "copy" / "DJI_0002.JPG")
    with Image.open(tmp_path / "DJI_0000.JPG") as photo:
        for size in ((64, 48), (32, 24)):
            photo.resize(size).save(tmp_path / f"smaller-{size[0]}.jpg", exif=photo.getexif(), quality=60)
    d.write_photo(tmp_path / "burst.jpg", 77, second="10")
    source = open_source(tmp_path)
    used = sorted(e.name for e in source.events() if isinstance(e, Frame))
    assert used == ["DJI_0000.JPG", "DJI_0001.JPG", "DJI_0002.JPG", "burst.jpg"]
    assert "4 photo(s) are in the set twice and count once (first: " in source.warnings[0]
    assert source.counts["repeated photos"] == 4


@pytest.mark.parametrize(
    ("again", "out"),
    [
        ({"place": (45.0 + 1.2e-6, 7.6, 350.0)}, "long name.jpg"),  # rounded
        ({"subsecond": ""}, "b.jpg"),  # fewer tags
        ({"second": None}, "b.jpg"),
        ({"place": None}, "b.jpg"),
        ({"place": (45.0 + 3e-5, 7.6, 350.0)}, ""),
        ({"second": "11"}, ""),
        ({"subsecond": "75"}, ""),
        ({"second": None, "place": None}, ""),
        ({"model": "FC2"}, ""),
        ({"seed": 9}, ""),
    ],
)
def test_an_exposure_saved_again_with_poorer_tags_counts_once(tmp_path: Path, again: dict[str, Any], out: str) -> None:
    paths = []
    for name, changes in (("b.jpg", again), ("long name.jpg", {})):
        tags = {"seed": 1, "second": "10", "subsecond": "25", "place": (45.0, 7.6, 350.0)} | changes
        paths.append(d.write_photo(tmp_path / name, xmp=d.xmp_packet({}), **tags))
    paths[1].write_bytes(paths[1].read_bytes() + b" ")
    found = repeated_photos([read_tags(path)[0] for path in paths], lambda p: np.asarray(Image.open(p.path)))
    assert [p.name for p in found.reasons] == [out] * bool(out)
