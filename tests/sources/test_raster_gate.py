"""The gate for rasters: units, scales, directions and projections are settled, or refused with the command that mends.

Every raster here is drawn: a plane of a known slope on the ground, stored as somebody might have stored it.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyproj
import pytest
import rasterio
from rasterio.crs import CRS
from rasterio.transform import Affine

from alight.geometry import LocalFrame
from alight.records import InputError
from alight.sources.geoid import separation_at
from alight.sources.prior_dem import read_prior
from alight.sources.raster import GroundRaster, read_ground
from alight.sources.raster_band import metres_of

SIZE, CELL, SLOPE, LEVEL = 60, 0.5, 9.0, 100.0  # cells; metres on the ground; degrees; metres in the middle
SURVEY_FOOT = 1200 / 3937
UNITS = {"": 1.0, "m": 1.0, "metre": 1.0, "ft": 0.3048, "US survey foot": SURVEY_FOOT, "ftUS": SURVEY_FOOT,
         "km": 1e3, "cm": 1e-2, "dm": 1e-1, "mm": 1e-3, "yd": math.nan, "degree": math.nan}  # fmt: skip
LOCAL = 'LOCAL_CS["site grid",UNIT["{}",{}],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
UTM = "EPSG:32632"


class Projection(NamedTuple):
    """A coordinate system, a place in it (degrees), and what is right."""

    crs: str | None
    lon: float = 9.5
    lat: float = 48.0
    up: float | None = None  # metres of its vertical axis, below zero where that points down
    refused: bool = False


PROJECTIONS = [
    Projection(UTM), Projection("EPSG:32633", 10.0, 48.0), Projection("EPSG:2154", 3.0, 46.0),
    Projection("EPSG:3857", 10.0, 60.0), Projection("EPSG:3857", -70.0, -20.0), Projection("EPSG:3395", 10.0, 60.0),
    Projection("EPSG:3413", -40.0, 75.0), Projection("EPSG:3031", 100.0, -75.0), Projection("EPSG:5514", 15.0, 50.0),
    Projection("EPSG:2227", -121.0, 37.5), Projection("EPSG:2263", -74.0, 40.7), Projection("EPSG:3035", 10.0, 52.0),
    Projection("EPSG:32632+5773", up=1.0), Projection("EPSG:25832+7837", up=1.0), Projection("EPSG:32632+5715", up=-1),
    Projection("EPSG:2227+6360", -121.0, 37.5, up=SURVEY_FOOT), Projection("EPSG:32613+6360", -105, 40, SURVEY_FOOT),
    Projection(LOCAL.format("metre", 1)), Projection(LOCAL.format("foot", 0.3048)), Projection(None),
    Projection("EPSG:3035", 35.0, 68.0, refused=True), Projection("EPSG:5070", -96.0, 38.0, refused=True),
    Projection("EPSG:4087", 10.0, 60.0, refused=True), Projection("EPSG:4326", refused=True),
    Projection("EPSG:2053", 29.0, -26.0, refused=True),
]  # fmt: skip


def cell_and_corner(p: Projection) -> tuple[float, float, float]:
    """Length of a cell in the units of a system, and its north-western corner; by geodesics, in one direction."""
    if p.crs is None or p.crs.startswith("LOCAL"):
        return CELL / (0.3048 if p.crs and "foot" in p.crs else 1.0), 5000.0, 2000.0
    crs = pyproj.CRS(p.crs)
    plane = crs.sub_crs_list[0] if crs.sub_crs_list else crs
    if plane.is_geographic:
        return 1e-5, p.lon, p.lat
    to_plane = pyproj.Transformer.from_crs(plane.geodetic_crs, plane, always_xy=True)
    x, y = to_plane.transform(p.lon, p.lat)
    there, _ = to_plane.transform([p.lon] * 2, [p.lat] * 2)
    lon, lat, _ = plane.get_geod().fwd(p.lon, p.lat, 90.0, 1.0)
    x1, y1 = to_plane.transform(lon, lat)
    cell = CELL * math.hypot(x1 - x, y1 - y)
    return cell, there[0] - cell * SIZE / 2, y + cell * SIZE / 2


def turned(values: np.ndarray, place: Affine, way: int) -> tuple[np.ndarray, Affine]:
    """Store values (R, C), north up, in one of the eight orders of rows and columns."""
    rows, cols = values.shape
    if way & 4:
        values, place, (rows, cols) = values.T, place @ Affine(0, 1, 0, 1, 0, 0), (cols, rows)
    if way & 1:
        values, place = values[::-1], place @ Affine(1, 0, 0, 0, -1, rows)
    if way & 2:
        values, place = values[:, ::-1], place @ Affine(-1, 0, cols, 0, 1, 0)
    return np.ascontiguousarray(values), place


def store(path: Path, values: np.ndarray, place: Affine, crs: Any = UTM, way: int = 0, **more: Any) -> Path:
    """Write (R, C) or (B, R, C) as a GeoTIFF; `more`: of the profile, or `units`, `scales`, `descriptions`, ..."""
    bands = values if values.ndim == 3 else values[None]
    stored = [turned(b, place, way) for b in bands]
    rows, cols = stored[0][0].shape
    after = {k: more.pop(k) for k in ("units", "scales", "offsets", "descriptions", "colorinterp") if k in more}
    profile = {"driver": "GTiff", "width": cols, "height": rows, "count": len(bands), "dtype": bands.dtype.name}
    crs = CRS.from_wkt(crs) if isinstance(crs, str) and crs.startswith("LOCAL") else crs
    with rasterio.open(path, "w", crs=crs, transform=stored[0][1], **{**profile, **more}) as d:
        d.write(np.stack([b for b, _ in stored]))
        for key, value in after.items():
            setattr(d, key, value)
    return path


def ground_plane(slope: float = SLOPE, size: int = SIZE) -> np.ndarray:
    """Heights (R, C) in metres: up to the east and, half as steep, to the north."""
    u = (np.arange(size) - (size - 1) / 2) * CELL
    return LEVEL + math.tan(math.radians(slope)) * (u[None, :] * 0.8 - u[:, None] * 0.6)


def slope_of(ground: GroundRaster) -> float:
    """Slope of the heights as read, degrees."""
    east, north = np.meshgrid(*ground.elevation.grid.xy())
    e, n = (v.ravel() - v.mean() for v in (east, north))
    rise = np.linalg.lstsq(np.column_stack([e, n, np.ones(e.size)]), ground.elevation.height.ravel(), rcond=None)[0]
    return math.degrees(math.atan(math.hypot(rise[0], rise[1])))


HERE = Affine(CELL, 0, 500000, 0, -CELL, 5300000)


# -- the whole table


@pytest.mark.parametrize("number", range(60))
def test_a_drawn_raster_is_read_right_or_refused_with_a_command(tmp_path: Path, number: int) -> None:
    rng = np.random.default_rng(number)
    p = PROJECTIONS[number % len(PROJECTIONS)]
    unit = rng.choice(list(UNITS)) if number % 3 else ""
    scale, offset = [(1.0, 0.0), (0.01, 0.0), (0.1, 200.0), (-1.0, 0.0)][number // 2 % 4]
    declared = UNITS[unit] if unit else abs(p.up) if p.up else 1.0
    stored = (ground_plane() / (1.0 if math.isnan(declared) else declared) * (-1 if p.up == -1 else 1) - offset) / scale
    cell, west, north = cell_and_corner(p)
    path = store(
        tmp_path / "dem.tif", stored, Affine(cell, 0, west, 0, -cell, north), p.crs, int(rng.integers(8)),
        scales=(scale,), offsets=(offset,), **({"units": (unit,)} if unit else {}),
    )  # fmt: skip
    feet = p.crs is not None and ("foot" in p.crs or p.crs in ("EPSG:2227", "EPSG:2263"))
    contradicts = p.up is not None and unit and abs(declared / abs(p.up) - 1) > 1e-5
    if p.refused or math.isnan(declared) or contradicts or (feet and not unit):
        with pytest.raises(InputError, match=r"mend.*: gdal(_edit\.py|warp) "):
            read_ground(path, "0.01", None, 0.05)
        return
    ground = read_ground(path, "0.01", None, 0.05)
    assert slope_of(ground) == pytest.approx(SLOPE, abs=0.1)
    assert np.abs(ground.elevation.height - ground_plane()).max() < 0.01
    assert ground.elevation.grid.cell == pytest.approx(CELL, rel=5e-3)
    assert "heights in" in ground.settled
    assert ground.plane is not None
    own = ground.plane.grid_in_crs(ground.elevation.grid)  # as outputs are written
    assert own.transform == pytest.approx((cell, 0, west, 0, -cell, north), rel=1e-9)


@pytest.mark.parametrize(
    ("word", "metres"),
    [("m", 1), ("Meters", 1), ("METRE", 1), ("metres", 1), ("feet", 0.3048), ("Foot", 0.3048), ("ift", 0.3048),
     ("International Feet", 0.3048), ("us-ft", SURVEY_FOOT), ("Foot_US", SURVEY_FOOT), ("US Survey Feet", SURVEY_FOOT),
     ("foot (US survey)", SURVEY_FOOT), ("sFT", SURVEY_FOOT), ("Kilometers", 1e3), ("decimetre", 0.1), ("mm", 1e-3),
     ("fathom", None), ("m/s", None), ("m2", None), ("percent", None), ("'", None)],
)  # fmt: skip
def test_units_as_they_are_spelled(word: str, metres: float | None) -> None:
    assert metres_of(word) == (None if metres is None else pytest.approx(metres, rel=1e-12))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"crs": "EPSG:4326", "place": Affine(1e-5, 0, -70.6, 0, -1e-5, -33.4)}, "EPSG:32719"),
        ({"crs": "EPSG:3857", "place": Affine(1000, 0, 0, 0, -1000, 11e6)}, "by place or direction.*EPSG:32631"),
        ({"crs": "EPSG:32632", "place": Affine(CELL, 0, 9e7, 0, -CELL, 0)}, "nowhere"),
        ({"place": Affine(CELL, 0.01, 0, 0, -CELL, 0)}, r"gdalwarp -r bilinear -tr 0\.5 0\.5"),
        ({"place": Affine(CELL, 0, 0, 0, -CELL / 2, 0)}, "not square"),
        ({"place": Affine.identity(), "crs": None}, "no place"),
        ({"scales": (math.nan,)}, "gdal_edit.py -scale 1"),
        ({"units": ("furlong",)}, "unit 'furlong' of band 1 is not known.*gdal_edit.py -units"),
        ({"crs": "EPSG:32632+5773", "units": ("ft",)}, "EGM96 height.*mend what is wrong"),
        ({"crs": "EPSG:2227"}, "declares no unit.*gdal_edit.py -units"),
        ({"crs": "EPSG:4978"}, "no plane"),
    ],
)
def test_what_cannot_be_settled_is_refused_with_the_command(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    options = {"place": HERE, "crs": UTM, **change}
    with warnings.catch_warnings(action="ignore"):
        path = store(tmp_path / "my dem.tif", ground_plane(size=120), options.pop("place"), **options)
    with pytest.raises(InputError, match=words) as e:
        read_ground(path, "0.01", None, 0.05)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    "more", [{"tiled": True, "blockxsize": 16, "blockysize": 16}, {"BIGTIFF": "YES"}, {"driver": "COG"}]
)
def test_forms_of_tiff(tmp_path: Path, more: dict[str, Any]) -> None:
    ground = read_ground(store(tmp_path / "d.tif", ground_plane(), HERE, **more), "0.01", None, 0.05)
    assert np.abs(ground.elevation.height - ground_plane()).max() < 1e-4


# -- bands and masks


def test_heights_are_found_by_the_name_of_their_band(tmp_path: Path) -> None:
    noise = np.full((SIZE, SIZE), 7.0)
    bands = np.stack([noise, ground_plane(), noise / 100])
    dem = store(tmp_path / "d.tif", bands, HERE, descriptions=("height error", "Elevation", "sigma"))
    ground = read_ground(dem, None, None, 0.05)
    assert slope_of(ground) == pytest.approx(SLOPE, abs=0.05)
    assert np.allclose(ground.elevation.sigma, 0.07)
    assert "band 2 of 3" in ground.settled
    first = read_ground(store(tmp_path / "e.tif", bands[1:], HERE), "0.01", None, 0.05)
    assert "band 1 of 2" in first.settled


@pytest.mark.parametrize(
    "kind", ["no-data", "NaN", "mask", "sidecar", "alpha", "mask and no-data", "alpha and no-data"]
)
@pytest.mark.parametrize("way", [0, 5])
def test_hidden_cells_are_unknown(tmp_path: Path, kind: str, way: int) -> None:
    z, hidden = ground_plane().astype(np.float32), np.zeros((SIZE, SIZE), bool)
    hidden[10:20, 5:9] = True
    z[hidden] = -32768.0 if kind == "no-data" else np.nan if kind == "NaN" else 50.0
    nodata = -32768.0 if "no-data" in kind else None
    if " and " in kind:
        z[40, 40], hidden[40, 40] = -32768.0, True
    seen = np.where(hidden, 0, 255)
    bands = np.stack([z, seen.astype(np.float32)]) if "alpha" in kind else z
    path = store(
        tmp_path / "d.tif", bands, HERE, way=way, nodata=nodata, **({"alpha": "yes"} if "alpha" in kind else {})
    )
    if "mask" in kind or kind == "sidecar":
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=kind != "sidecar"), rasterio.open(path, "r+") as d:
            d.write_mask(turned(seen.astype(np.uint8), HERE, way)[0])
        assert (tmp_path / "d.tif.msk").exists() == (kind == "sidecar")
    assert np.array_equal(np.isnan(read_ground(path, "0.01", None, 0.05).elevation.height), hidden)


def test_rounded_heights_have_the_sigma_of_rounding(tmp_path: Path) -> None:
    dem = store(tmp_path / "d.tif", np.rint(10 * ground_plane()).astype(np.int16), HERE, scales=(0.1,))
    assert np.allclose(read_ground(dem, "0.01", None, 0.05).elevation.sigma, math.hypot(0.01, 0.1 / math.sqrt(12)))


@pytest.mark.parametrize(
    ("names", "number"),
    [(("hillshade of DEM", "DEM"), 2), (("slope of dsm", "DSM"), 2), (("sun altitude", "z"), 2), (("a", "b"), 1)],
)
def test_a_band_derived_from_heights_is_not_heights(tmp_path: Path, names: tuple[str, str], number: int) -> None:
    bands = np.stack([ground_plane(), ground_plane()])
    bands[2 - number] = np.sin(bands[0])
    ground = read_ground(store(tmp_path / "d.tif", bands, HERE, descriptions=names), "0.01", None, 0.05)
    assert f"band {number} of 2" in ground.settled
    assert slope_of(ground) == pytest.approx(SLOPE, abs=0.05)


@pytest.mark.parametrize(
    ("lowest", "code", "refused"),
    [(995.0, 9999, False), (995.0, -9999, True), (300.0, 9999, True), (-99.9, -999, False), (300.0, -999, True)],
)
def test_a_code_for_unknown_heights_may_be_a_height_in_decimetres(
    tmp_path: Path, lowest: float, code: int, refused: bool
) -> None:
    stored = np.rint(10 * (lowest + ground_plane() - ground_plane().min())).astype(np.int16)
    stored = np.where(stored > 9999, 9999, stored) if code > 0 else np.where(stored < -998, -999, stored)
    stored[:7, :7] = code
    dem = store(tmp_path / "d.tif", stored.astype(np.int16), HERE, scales=(0.1,))
    if refused:
        with pytest.raises(InputError, match=f"{code} stands in .* no height"):
            read_ground(dem, "0.01", None, 0.05)
    else:
        assert np.isfinite(read_ground(dem, "0.01", None, 0.05).elevation.height).all()


# -- rasters that belong to the heights

LEFT = np.where(np.arange(SIZE) < SIZE // 2, 0.01, 0.6) + np.zeros((SIZE, 1))
LEFT[:10, :10] = 0.3


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return store(tmp_path_factory.mktemp("dem") / "dem.tif", ground_plane(), HERE)


@pytest.mark.parametrize("way", range(8))
def test_a_sigma_is_put_where_it_lies(tmp_path: Path, dem: Path, way: int) -> None:
    sigma = store(tmp_path / "s.tif", LEFT, HERE, way=way)
    assert np.allclose(read_ground(dem, str(sigma), None, 0.05).elevation.sigma, LEFT)


@pytest.mark.parametrize("case", ["coarser", "finer", "shifted", "mercator", "degrees", "feet", "stored in cm"])
def test_a_sigma_on_other_cells_is_never_too_small(tmp_path: Path, dem: Path, case: str) -> None:
    values, place, crs, more = LEFT, HERE, UTM, dict[str, Any]()
    if case == "coarser":
        values, place = LEFT[::5, ::5], HERE @ Affine.scale(5)
    elif case == "finer":
        values, place = np.kron(LEFT, np.ones((3, 3))), HERE @ Affine.scale(1 / 3)
    elif case == "shifted":
        place = HERE @ Affine.translation(0.4, 0.0)
    elif case in ("mercator", "degrees"):
        crs = "EPSG:3857" if case == "mercator" else "EPSG:4326"
        x, y = pyproj.Transformer.from_crs(UTM, crs, always_xy=True).transform([500000, 500030], [5300000, 5299970])
        place = Affine((x[1] - x[0]) / SIZE, 0, x[0], 0, (y[1] - y[0]) / SIZE, y[0])
    elif case == "feet":
        values, more = LEFT / 0.3048, {"units": ("ft",)}
    else:
        values, more = (100 * LEFT).astype(np.int16), {"scales": (0.01,)}
    found = read_ground(dem, str(store(tmp_path / "s.tif", values, place, crs, **more)), None, 0.05).elevation.sigma
    inner = (slice(2, -2), slice(2, -2))
    assert (found[inner] >= LEFT[inner] - 1e-6).all()
    assert np.mean(np.isclose(found[inner], LEFT[inner])) > 0.9


def test_a_sigma_without_a_place_must_have_the_shape(tmp_path: Path, dem: Path) -> None:
    with warnings.catch_warnings(action="ignore"):
        fits = store(tmp_path / "s.tif", LEFT, Affine.identity(), None)
        other = store(tmp_path / "o.tif", LEFT[:, :-1], Affine.identity(), None)
    ground = read_ground(dem, str(fits), None, 0.05)
    assert np.allclose(ground.elevation.sigma, LEFT)
    assert any("s.tif has no place" in w for w in ground.warnings)
    with pytest.raises(InputError, match="has no place"):
        read_ground(dem, str(other), None, 0.05)


@pytest.mark.parametrize("crs", [UTM, LOCAL.format("metre", 1), "EPSG:3857"])
def test_a_sigma_elsewhere_is_refused(tmp_path: Path, dem: Path, crs: str) -> None:
    sigma = store(tmp_path / "s.tif", LEFT, Affine(CELL, 0, 900000, 0, -CELL, 5000000), crs)
    with pytest.raises(InputError, match=r"lies elsewhere|cannot be converted"):
        read_ground(dem, str(sigma), None, 0.05)


def test_a_sigma_in_part_leaves_the_rest_unknown(tmp_path: Path, dem: Path) -> None:
    sigma = store(tmp_path / "s.tif", LEFT[:, :30], HERE)
    ground = read_ground(dem, str(sigma), None, 0.05)
    assert np.array_equal(np.isfinite(ground.elevation.height), np.arange(SIZE) < 30 + np.zeros((SIZE, 1), int))
    assert any("covers 50 % of the heights" in w for w in ground.warnings)


@pytest.mark.parametrize("where", ["beside", "finer", "own band"])
@pytest.mark.parametrize("name", ["sigma", "Std", "Uncertainty (1 sigma)"])
def test_a_sigma_of_0_is_unknown(tmp_path: Path, dem: Path, where: str, name: str) -> None:
    values = LEFT.copy()
    values[:, 40:] = 0.0
    bands, place = np.stack([ground_plane(), values]), HERE
    if where == "finer":
        bands, place = np.kron(bands, np.ones((1, 3, 3))), HERE @ Affine.scale(1 / 3)
    path = store(tmp_path / "s.tif", bands, place, descriptions=("z", name))
    ground = read_ground(path, None, None, 0.05) if where == "own band" else read_ground(dem, str(path), None, 0.05)
    assert np.array_equal(np.isfinite(ground.elevation.height), values > 0)
    assert sum("s.tif: sigma is 0 in 33.3 % of the heights" in w for w in ground.warnings) == len(ground.warnings) == 1
    assert np.isfinite(read_ground(dem, "0", None, 0.05).elevation.height).all()


def test_a_sigma_without_a_unit_beside_feet_is_refused(tmp_path: Path) -> None:
    feet = store(tmp_path / "d.tif", ground_plane() / 0.3048, HERE, units=("ft",))
    sigma = store(tmp_path / "s.tif", LEFT, HERE)
    with pytest.raises(InputError, match="declares no unit"):
        read_ground(feet, str(sigma), None, 0.05)


PICTURE = np.random.default_rng(0).integers(30, 220, (2 * SIZE, 2 * SIZE)).astype(np.uint8)


@pytest.mark.parametrize("case", ["grey", "south up", "rgba", "16 bits", "palette", "no place"])
def test_an_image_keeps_its_pixels(tmp_path: Path, dem: Path, case: str) -> None:
    place, more, bands, crs, way = HERE @ Affine.scale(0.5), dict[str, Any](), PICTURE, UTM, 0
    if case == "south up":
        way = 1
    elif case == "rgba":
        bands = np.stack([PICTURE, PICTURE // 2, PICTURE, np.full_like(PICTURE, 255)])
        more = {"photometric": "RGB", "alpha": "yes"}
    elif case == "16 bits":
        bands = 10 * PICTURE.astype(np.uint16)
    elif case == "no place":
        place, crs = Affine.identity(), None
    with warnings.catch_warnings(action="ignore"):
        image = store(tmp_path / "i.tif", bands, place, crs, way, **more)
    if case == "palette":
        with rasterio.open(image, "r+") as d:
            d.write_colormap(1, {i: (i, 255 - i, 7, 255) for i in range(256)})
    found = read_ground(dem, "0.01", image, 0.05).image
    assert found is not None
    if case == "16 bits":
        assert np.corrcoef(found.ravel(), PICTURE.ravel())[0, 1] > 0.999
        assert found.max() == 255
    elif case in ("rgba", "palette"):
        green = PICTURE // 2 if case == "rgba" else 255 - PICTURE
        assert np.array_equal(
            found, np.stack([PICTURE, green, PICTURE if case == "rgba" else np.full_like(PICTURE, 7)], -1)
        )
    else:
        assert np.array_equal(found, PICTURE)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("Blue", "Green", "Red", "NIR", "Red edge"), "band 3, 2, 1 of 5 as red, green, blue"),
        (("Blue-475", "Green_560", "RedEdge", "red (668 nm)"), "band 4, 2, 1 of 4 as red, green, blue"),
        (("NIR", "Red", "Green"), "band 3 of 3 as grey"),
        (("near-infrared", "infra red 2", "LWIR"), "band 1 of 3 as grey"),
        ((None, None, None), "band 1, 2, 3 of 3 as red, green, blue"),
        ((None, None, None, None, None), "band 1 of 5 as grey"),
    ],
)
@pytest.mark.parametrize("photometric", ["RGB", "MINISBLACK"])
def test_colours_are_found_by_the_names_of_bands(
    tmp_path: Path, dem: Path, names: tuple[str, ...], words: str, photometric: str
) -> None:
    """False colours are read as grey, whatever drivers write as the colours of the first three bands."""
    bands = np.stack([np.full((SIZE, SIZE), 40 * k + 30, np.uint8) for k in range(len(names))])
    image = store(tmp_path / "i.tif", bands, HERE, photometric=photometric)
    with rasterio.open(image, "r+") as d:
        d.descriptions = names
    if photometric == "RGB" and not any(names):
        words = f"band 1, 2, 3 of {len(names)} as red, green, blue"
    ground = read_ground(dem, "0.01", image, 0.05)
    assert words in ground.settled
    assert ("grey" in words) == any("as grey" in w for w in ground.warnings)
    numbers = [int(n) for n in words[5:].split(" of")[0].split(", ")]
    assert ground.image is not None
    assert np.array_equal(ground.image[0, 0], np.squeeze([40 * n - 10 for n in numbers]))


@pytest.mark.parametrize(("pixels", "factor"), [(1, 1), (3, 2), (5, 4), (0.5, 1)])
def test_an_image_is_resampled_to_whole_pixels_of_a_cell(tmp_path: Path, dem: Path, pixels: float, factor: int) -> None:
    size = int(SIZE * pixels)
    ramp = np.tile(np.linspace(20, 220, size), (size, 1)).astype(np.uint8)
    found = read_ground(dem, "0.01", store(tmp_path / "i.tif", ramp, HERE @ Affine.scale(1 / pixels)), 0.05).image
    assert found is not None
    assert found.shape == (factor * SIZE, factor * SIZE)
    assert np.abs(found[5].astype(float) - np.linspace(20, 220, factor * SIZE)).max() < 5


def test_an_image_elsewhere_is_refused(tmp_path: Path, dem: Path) -> None:
    with pytest.raises(InputError, match="lies elsewhere"):
        read_ground(dem, "0.01", store(tmp_path / "i.tif", PICTURE, Affine(0.25, 0, 0, 0, -0.25, 0)), 0.05)


# -- a DEM from elsewhere, and the geoid


@pytest.mark.parametrize("case", ["metres", "decimetres", "feet", "south up", "compound feet", "mask"])
def test_a_prior_dem_is_read_in_metres(tmp_path: Path, case: str) -> None:
    z, more, crs, way = ground_plane(2.0), dict[str, Any](), UTM, 0
    if case == "decimetres":
        z, more = np.rint((z - 50) * 10).astype(np.int16), {"scales": (0.1,), "offsets": (50.0,)}
    elif case == "feet":
        z, more = z / 0.3048, {"units": ("ft",)}
    elif case == "south up":
        way = 1
    elif case == "compound feet":
        z, crs = z / SURVEY_FOOT, "EPSG:32632+6360"
    path = store(tmp_path / "dem.tif", z, HERE, crs, way, **more)
    if case == "mask":
        with rasterio.open(path, "r+") as d:
            d.write_mask(np.where(np.arange(SIZE) < 10, 0, 255).astype(np.uint8) * np.ones((SIZE, 1), np.uint8))
    lon, lat = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True).transform(500015, 5299985)
    prior = read_prior(path, LocalFrame(lat, lon, LEVEL))
    at = prior.at(np.array([0.1, 5.1, -12.0]), np.array([0.1, 5.1, 0.0]))
    assert at[:2] == pytest.approx([0.0, 5 * 1.4 * math.tan(math.radians(2.0))], abs=0.06)
    assert np.isnan(at[2]) == (case == "mask")
    assert ("NAVD88 height (ftUS)" if case == "compound feet" else "undeclared") in prior.name


@pytest.mark.parametrize(
    ("crs", "words"), [(LOCAL.format("metre", 1), "on Earth"), ("EPSG:2227", "declares no unit"), (None, "on Earth")]
)
def test_a_prior_dem_that_cannot_be_settled_is_refused(tmp_path: Path, crs: str | None, words: str) -> None:
    path = store(tmp_path / "dem.tif", ground_plane(), HERE, crs)
    with pytest.raises(InputError, match=rf"--prior-dem .*{words}.*gdal_edit"):
        read_prior(path, LocalFrame(47.8, 9.0, LEVEL))


@pytest.mark.parametrize("case", ["metres", "feet", "centimetres from the south", "between two levels"])
def test_a_geoid_is_read_in_metres(tmp_path: Path, case: str) -> None:
    lat, lon = 52.875 - 0.25 * np.arange(40)[:, None], 10.125 + 0.25 * np.arange(40)
    z, more, way = 40 + 0.5 * (lat - 48) - 0.25 * (lon - 15), dict[str, Any](), 0
    if case == "feet":
        z, more = z / 0.3048, {"units": ("ft",)}
    elif case == "centimetres from the south":
        z, more, way = np.rint(100 * z).astype(np.int16), {"scales": (0.01,), "units": ("m",)}, 1
    path = store(tmp_path / "g.tif", z, Affine(0.25, 0, 10, 0, -0.25, 53), "EPSG:4326", way, **more)
    if case == "between two levels":
        with rasterio.open(path, "r+") as d:
            d.update_tags(TYPE="VERTICAL_OFFSET_VERTICAL_TO_VERTICAL")
        with pytest.raises(InputError, match="two levels of the sea"):
            separation_at(path, 48.1, 15.44)
        return
    assert separation_at(path, 48.1, 15.44) == pytest.approx(39.94, abs=6e-3)


@pytest.mark.parametrize("crs", ["EPSG:4326", None])
def test_terrain_in_degrees_is_no_geoid(tmp_path: Path, crs: str | None) -> None:
    """A coast: low heights, flat at the position itself."""
    z = 0.5 + np.zeros((100, 100))
    z[:40] = np.linspace(30.0, 1.0, 40)[:, None]
    path = store(tmp_path / "dem.tif", z, Affine(1 / 3600, 0, 10, 0, -1 / 3600, 48), crs)
    with pytest.raises(InputError, match="is no geoid"):
        separation_at(path, 48 - 50.5 / 3600, 10 + 50.5 / 3600)
