"""Light, looks, shutters and cars: against closed forms and plain NumPy twins, independent of blocks and threads."""

import dataclasses

import numpy as np
import pytest
from exactness import LENSES, errors

from alight.geometry import Camera, Grid, Pose
from alight.records import InputError, Terrain
from alight_sim import cameras, coarser
from alight_sim.cameras import Eye, Shutter, rays_in_pixel
from alight_sim.kernels import block, texture
from alight_sim.kernels.block import B, Slot, noise_at, values_at
from alight_sim.kernels.boxes import hit_box
from alight_sim.kernels.ground import PLAIN, STEP, beside
from alight_sim.kernels.noise import gradient_noise, noise32, seed32
from alight_sim.light import Clouds, Light, Wind
from alight_sim.looks import Look
from alight_sim.materials import materials, tables
from alight_sim.movers import Mover, Traffic, boxes_at
from alight_sim.patch import GroundPatch
from alight_sim.scene_world import world_of

DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # image top is east, image right is south
SMALL = Camera(160, 96, 120.0, 120.0, 79.5, 47.5)


def ground(look=Look.MEADOW, side=40.0, cell=0.1, surface=lambda x, y: 0.0 * x * y, **more):
    n = round(side / cell) + 1
    grid = Grid(-0.5 * side, 0.5 * side, cell, n, n)
    x, y = grid.xy()
    height = np.asarray(surface(x[None], y[:, None]), np.float32)
    label = np.full(grid.shape, Terrain.BARE, np.uint8)
    looks = np.full(grid.shape, look, np.uint8)
    return world_of(grid, height, label, look=looks, **more)


def above(east=0.0, north=0.0, up=12.0):
    return Pose(DOWN, np.array([east, north, up]))


def along(start, velocity):
    """Return the poses, as a function of time, of a camera that looks down and flies straight on."""
    return lambda t: (np.repeat(DOWN[None], len(t), axis=0), np.array(start) + np.outer(t, velocity))


# -- geometry


@pytest.mark.parametrize("lens", LENSES)
def test_plane_sphere_and_step_land_where_projection_says(lens):
    assert max(errors(LENSES[lens]).values()) < 0.001  # pixels; required: 0.02


def test_rays_of_a_pixel_spread_about_its_centre():
    for n in (1, 2, 4, 8, 16):
        offsets = rays_in_pixel(n)
        assert offsets.shape == (n, 2)
        assert np.abs(offsets.mean(axis=0)).max() < 1e-12
        assert np.abs(offsets).max() < 0.75
    assert np.ptp(rays_in_pixel(16), axis=0).min() > 0.75


def test_a_camera_below_the_ground_is_refused():
    with pytest.raises(InputError, match=r"below the ground at east 1\.0, north 2\.0"):
        Eye(SMALL).radiance(ground(), above(1.0, 2.0, -0.5), 0.0)


# -- twins


def test_noise_in_32_bits_agrees_with_the_one_in_64():
    rng = np.random.default_rng(2)
    for _ in range(300):
        i, j, (x, y) = int(rng.integers(-9e5, 9e5)), int(rng.integers(-9e5, 9e5)), rng.uniform(-20, 20, 2)
        got = noise32(np.float32(x), np.float32(y), np.int32(i), np.int32(j), np.uint32(seed32(9)))
        expected = gradient_noise(i + float(np.float32(x)), j + float(np.float32(y)), 9)
        assert np.abs(np.array(got) - expected).max() < 2e-4


def test_noise_of_a_block_is_that_of_its_pixels_within_one_cell_and_over_many():
    rng = np.random.default_rng(3)
    for wavelength in (200.0, 0.3):
        buf, base = np.zeros(Slot.PARAM, np.float32), np.array([12.0, -7.0, 0.0])
        buf[Slot.TX : Slot.TX + B], buf[Slot.TY : Slot.TY + B] = rng.uniform(1, 6, (2, B)).astype(np.float32)
        noise_at(buf, base, wavelength, 0.8, 0.6, 5)
        got = [buf[k : k + B].copy() for k in (Slot.N, Slot.DU, Slot.DV)]
        values_at(buf, base, wavelength, 0.8, 0.6, 5)
        assert np.array_equal(buf[Slot.N : Slot.N + B], got[0])
        x, y = base[0] + buf[Slot.TX : Slot.TX + B].astype(float), base[1] + buf[Slot.TY : Slot.TY + B].astype(float)
        u, v = (0.8 * x - 0.6 * y) / wavelength, (0.6 * x + 0.8 * y) / wavelength
        assert (np.ptp(np.floor(u)) + np.ptp(np.floor(v)) == 0) == (wavelength > 100)
        for k in range(B):
            expected = gradient_noise(float(u[k]), float(v[k]), 5)
            assert np.allclose([part[k] for part in got], expected, atol=2e-3)


def test_a_cell_knows_whether_all_about_it_is_alike_and_whether_it_lies_at_a_step():
    rng = np.random.default_rng(4)
    height = (0.03 * rng.random((30, 33))).astype(np.float32)
    height[10:14, 20:25] += 0.5
    label = np.full(height.shape, Terrain.BARE, np.uint8)
    label[20:, :9] = Terrain.PAVED
    look = np.zeros(height.shape, np.uint8)
    look[3, 4] = Look.SAND
    cells = GroundPatch(Grid(0.0, 0.0, 0.1, *height.shape), height, label, np.ones(1), look).cells
    assert cells[3, 4, 0] == Look.SAND
    assert cells[25, 3, 0] == Look.ASPHALT
    for r, c in np.ndindex(height.shape):
        near = slice(max(r - 3, 0), r + 4), slice(max(c - 3, 0), c + 4)
        alike = np.ptp(label[near]) == 0 and np.ptp(look[near]) == 0
        assert bool(cells[r, c, 1] & PLAIN) == alike
        inside = 1 <= r <= 27 and 1 <= c <= 30
        assert bool(cells[r, c, 1] & STEP) == bool(inside and np.ptp(height[r : r + 2, c : c + 2]) >= 0.06)


def test_beside_a_step_the_nearest_cell_of_the_own_side_counts():
    rng = np.random.default_rng(6)
    for _ in range(400):
        height, (gx, gy) = rng.uniform(0, 1, (8, 8)).astype(np.float32), rng.uniform(2.0, 5.0, 2)
        z = rng.uniform(0, 1)
        rows, cols = np.mgrid[int(gy) - 1 : int(gy) + 3, int(gx) - 1 : int(gx) + 3]
        near = height[rows, cols].astype(float)
        middle = 0.5 * (near.max() + near.min())
        upper = z > min(middle, near.min() + 0.25)
        away = np.where((near > middle) == upper, np.hypot(cols - gx, rows - gy), np.inf)
        best = np.unravel_index(np.argmin(away), away.shape)
        assert beside(height, gx, gy, z) == (rows[best], cols[best], upper)


def test_small_functions_agree_with_numpy():
    x = np.linspace(0, 9, 200, dtype=np.float32)
    assert max(abs(block.fading(v) - np.exp(-v)) for v in x) < 0.004
    t = np.clip((x - 2) / 3, 0, 1)
    assert (
        max(
            abs(block.smoothstep(np.float32(2), np.float32(5), a) - b)
            for a, b in zip(x, t * t * (3 - 2 * t), strict=True)
        )
        < 1e-6
    )


def scratch(x, y, look, foot=0.02):
    """Return the working memory of a block of pixels."""
    buf = np.zeros(block.Slot.PARAM + texture.TRAITS * block.B, np.float32)
    for slot, values in ((block.Slot.TX, x), (block.Slot.TY, y), (block.Slot.FOOT, foot)):
        buf[slot : slot + block.B] = values
    texture.load_looks(buf, tables()[0], np.full(block.B, look, np.int32), texture.Trait.BED)
    return buf


def test_detail_agrees_with_numpy():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-30, 30, (2, block.B)).astype(np.float32)
    buf, base, q = scratch(x, y, Look.SOIL), np.array([812.0, -377.0, 0.0]), 1.0
    texture.texture_detail(buf, base, 5)
    value, wavelength, c, s = np.zeros(block.B), 3.0, 1.0, 0.0
    for k in range(9):
        t = np.clip((wavelength / 0.02 - 1.2) / 1.2, 0, 1)
        for i in range(block.B):
            e, n = base[0] + float(x[i]), base[1] + float(y[i])
            noise, _, _ = gradient_noise((c * e - s * n) / wavelength, (s * e + c * n) / wavelength, 5 + 101 * k)
            value[i] += q * t * t * (3 - 2 * t) * noise / 3.0
        wavelength *= 0.5
        c, s = 0.7986 * c - 0.6018 * s, 0.6018 * c + 0.7986 * s
    assert materials()[Look.SOIL].ridge == materials()[Look.SOIL].roughening == 0
    assert np.abs(buf[block.Slot.VALUE : block.Slot.VALUE + block.B] - value).max() < 2e-3


def slabs(box, origin, ray):
    """NumPy twin of `hit_box`: a dense march."""
    t = np.linspace(0, 40, 400_001)[:, None]
    p = origin + t * ray - box[:3]
    u, v = box[3] * p[:, 0] + box[4] * p[:, 1], box[3] * p[:, 1] - box[4] * p[:, 0]
    inside = (abs(u) <= box[5]) & (abs(v) <= box[6]) & (p[:, 2] >= 0) & (p[:, 2] <= box[7])
    return t[np.argmax(inside), 0] if inside.any() else -1.0


def test_boxes_agree_with_a_dense_march():
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(60):
        a = rng.uniform(0, 6)
        box = np.array([*rng.uniform(-3, 3, 2), 0.2, np.cos(a), np.sin(a), 2.2, 0.9, 1.5, 0, 0, 0, 0])
        origin = np.array([*rng.uniform(-8, 8, 2), rng.uniform(3, 9)])
        ray = np.array([*rng.uniform(-4, 4, 2), 0.8]) - origin
        t, face = hit_box(box, tuple(origin), tuple(ray / 10))
        expected = slabs(box, origin, ray / 10)
        assert abs(t - expected) < 2e-4 or min(t, expected) < 0  # a march may step over a corner
        hits += t > 0 and expected > 0
        if t > 0:
            assert face in (1, 2, 3, 4, 5)
    assert hits > 15
    assert hit_box(np.array([0, 0, 0, 1, 0, 2, 1, 1.5, 0, 0, 0, 0.0]), (0.0, 0.0, 5.0), (0.0, 0.0, -1.0)) == (3.5, 1)


# -- invariance


def test_texture_does_not_depend_on_blocks_threads_or_samples_before():
    """Another principal point shifts the blocks of pixels over the ground, but not the texture."""
    rough = ground(Look.MEADOW, side=60.0, surface=lambda x, y: 0.8 * np.sin(1.3 * x) + np.where(y > 4, 3.0, 0.0))
    wide = Camera(300, 40, 120.0, 120.0, 150.0, 19.5)
    moved = dataclasses.replace(wide, cu=wide.cu - 53.0)
    one, other = (Eye(c).radiance(rough, above(3.0, 1.0), 0.0) for c in (wide, moved))
    assert np.abs(one[:, 53:] - other[:, :-53]).max() < 0.02 * one.mean()


def test_picture_of_everything_does_not_depend_on_threads(on_one_and_all):
    world = busy_world()
    shutter = Shutter(0.01, 1e-4, 2)
    assert np.array_equal(*on_one_and_all(lambda: Eye(SMALL, 2).radiance(world, above(), 1.0, shutter)))


def busy_world():
    light = Light(clouds=Clouds(share=0.4), visibility=500.0)
    world = ground(Look.CLEAR_WATER, light=light)
    return with_cars(world, Traffic(path=((-15.0, 0.0), (15.0, 0.0)), speed=5.0))


def with_cars(world, *traffic):
    flat = dataclasses.replace(world)
    flat.__dict__["movers"] = tuple(Mover(t, lambda e, n: 0.0, 3) for t in traffic)
    return flat


# -- shutters


def test_blur_is_the_mean_of_sharp_pictures():
    world, eye, path = ground(), Eye(SMALL), along((0.0, 0.0, 12.0), (3.0, -6.0, 0.5))
    blurred = eye.radiance(world, path, 2.0, Shutter(exposure=0.04, moments=4))
    at = [Pose(*(a[0] for a in path(np.array([2.0 + s])))) for s in (-0.015, -0.005, 0.005, 0.015)]
    sharp = [eye.radiance(world, pose, 2.0 + s) for pose, s in zip(at, (-0.015, -0.005, 0.005, 0.015), strict=True)]
    assert np.abs(blurred - np.mean(sharp, axis=0)).max() < 1e-5
    assert np.diff(blurred, axis=1).std() < 0.7 * np.diff(sharp[0], axis=1).std()  # it flies along the rows


def test_each_row_of_a_rolling_shutter_is_a_row_of_a_sharp_picture_at_its_own_time():
    world, eye, line = ground(), Eye(SMALL), 2e-4
    path = along((0.0, 0.0, 12.0), (0.0, -8.0, 0.0))
    rolled = eye.radiance(world, path, 1.0, Shutter(line_time=line))
    for r in (0, 30, 47, 95):
        t = np.array([1.0 + (r - 47.5) * line])
        sharp = eye.radiance(world, Pose(*(a[0] for a in path(t))), float(t[0]))
        assert np.abs(rolled[r] - sharp[r]).max() < 1e-5


def test_a_rolling_shutter_skews_by_speed_times_line_time():
    tint = np.ones((401, 401, 3), np.float32)
    tint[200:] = 0.2  # the south is dark; image right is south
    world, line, speed = ground(Look.PLAIN, tint=tint), 5e-4, 9.0
    path = along((0.0, 0.0, 12.0), (0.0, -speed, 0.0))
    rolled = Eye(SMALL, 4).radiance(world, path, 0.0, Shutter(line_time=line))[..., 1]
    share = (rolled - rolled.min()) / (rolled.max() - rolled.min())
    edge = np.array([np.interp(-0.5, -np.sort(row)[::-1], np.arange(160.0)) for row in share])
    assert np.polyfit(np.arange(96), edge, 1)[0] == pytest.approx(-speed * line * 120.0 / 12.0, rel=0.03)


# -- cars

RED = Traffic(path=((-15.0, 1.0), (15.0, 1.0)), speed=6.0, gap=30.0, colour=(0.9, 0.02, 0.02))


def reddish(picture):
    return picture[..., 0] > 4.0 * picture[..., 2]


def test_a_car_is_where_its_path_and_time_say():
    mover = Mover(RED, lambda e, n: 0.5, 3)
    first, later = mover.places_at(np.array([0.0, 1.5]))[0]
    assert (later[0, 0] - first[0, 0]) % 30.0 == pytest.approx(9.0)  # a car comes again at the start
    assert later[0, 1:] == pytest.approx([1.0, 0.5])
    boxes = boxes_at((mover,), np.array([0.0]))
    assert boxes.shape == (1, 2, 12)
    assert boxes[0, 1, 2] == pytest.approx(0.5 + boxes[0, 0, 7])  # the cabin stands on the body


@pytest.mark.parametrize("seconds", [0.0, 1.0])
def test_a_car_is_drawn_where_it_is(seconds):
    world, camera = with_cars(ground(Look.ASPHALT), RED), Camera(160, 96, 120.0, 120.0, 79.5, 47.5)
    place = world.movers[0].places_at(np.array([seconds]))[0][0, 0]
    pose = above(place[0] + 0.4, place[1] - 0.3, 12.0)
    picture = Eye(camera, 4).radiance(world, pose, seconds)
    rows, cols = np.nonzero(reddish(picture))
    top = [[a, b, 1.5 * 0.58] for a in (-2.2, 2.2) for b in (-0.9, 0.9)]
    corners = camera.project(pose.inverse.apply(np.array(top) + np.array([place[0], place[1], 0.0])))
    assert cols.min() == pytest.approx(corners[:, 0].min(), abs=1.5)
    assert cols.max() == pytest.approx(corners[:, 0].max(), abs=1.5)
    assert rows.min() == pytest.approx(corners[:, 1].min(), abs=1.5)
    assert rows.max() == pytest.approx(corners[:, 1].max(), abs=1.5)


def test_a_car_throws_its_shadow_away_from_the_sun():
    light = Light(azimuth_deg=180.0, elevation_deg=30.0)  # from the south: shadows fall to the north
    world = ground(Look.CONCRETE, light=light)
    cars, pose = with_cars(world, RED), above(0.0, 1.0, 12.0)
    place = cars.movers[0].places_at(np.array([0.0]))[0][0, 0]
    pose = above(place[0], place[1], 12.0)
    with_car, without = (Eye(SMALL).radiance(w, pose, 0.0)[..., 1] for w in (cars, world))
    ratio = with_car / without
    assert ratio[47, 79 - 22] < 0.4  # image left is north: 2.2 m that way lies in shadow, as long as 1.5 m / tan 30
    assert ratio[47, 79 - 45] == pytest.approx(1.0)  # 4.5 m away it has ended
    assert ratio[47, 79 + 22] == pytest.approx(1.0)


def test_a_moving_car_is_askew_under_a_rolling_shutter():
    fast = Traffic(path=((1.0, 15.0), (1.0, -15.0)), speed=12.0, gap=30.0, colour=(0.9, 0.02, 0.02))
    world, line = with_cars(ground(Look.ASPHALT), fast), 1e-3
    place = world.movers[0].places_at(np.array([0.0]))[0][0, 0]
    picture = Eye(SMALL).radiance(world, above(1.0, place[1]), 0.0, Shutter(line_time=line))
    rows = [r for r in range(96) if reddish(picture)[r].sum() > 10]
    fronts = [np.nonzero(reddish(picture)[r])[0].max() for r in rows]
    skew = np.polyfit(rows, fronts, 1)[0]
    assert skew == pytest.approx(12.0 * line * 120.0 / (12.0 - 1.5 * 0.58), abs=0.03)  # pixels a row, to the south


# -- light and air


def test_in_thick_haze_everything_is_air_light():
    thick, thin = (ground(Look.SOIL, light=Light(visibility=v)) for v in (30.0, 1e7))
    none = Eye(SMALL).radiance(thin, above(up=100.0), 0.0)
    hazy = Eye(SMALL).radiance(thick, above(up=100.0), 0.0)
    air = thick.light.numbers(0.0)[10:13]
    assert np.abs(hazy - air).max() < 0.01 * air.max()
    assert hazy.std(axis=(0, 1)).max() < 0.01 * none.std(axis=(0, 1)).max()


def test_haze_dims_contrast_as_its_visibility_says():
    clear, hazy = (
        Eye(SMALL).radiance(ground(Look.SOIL, light=Light(visibility=v)), above(up=60.0), 0.0) for v in (1e7, 200.0)
    )
    assert hazy[..., 1].std() / clear[..., 1].std() == pytest.approx(0.02 ** (60.0 / 200.0), rel=0.03)


def test_shadows_of_clouds_drift_with_the_wind():
    light = Light(clouds=Clouds(share=0.5, size=12.0, speed=5.0), wind=Wind(speed=0.0, from_deg=270.0), visibility=1e7)
    world, clear = (ground(Look.CONCRETE, side=60.0, light=x) for x in (light, Light(visibility=1e7)))
    eye = Eye(SMALL)
    plain = eye.radiance(clear, above(up=20.0), 0.0)[..., 1]
    now, later = (eye.radiance(world, above(up=20.0), t)[..., 1] / plain for t in (0.0, 1.0))
    assert now.min() < 0.5
    assert now.max() == pytest.approx(1.0, abs=0.01)
    moved = round(5.0 * 120.0 / 20.0)  # pixels to the east, which is up in the picture
    assert np.corrcoef(now[moved:].ravel(), later[:-moved].ravel())[0, 1] > 0.98
    assert np.corrcoef(now.ravel(), later.ravel())[0, 1] < 0.9


def test_the_sun_reddens_when_low_and_turns_in_steps():
    high, low = (Light(elevation_deg=e).sun_at(0.0) for e in (60.0, 6.0))
    assert low.colour[0] / low.colour[2] > 1.5 * high.colour[0] / high.colour[2]
    assert low.colour[1] < 0.7 * high.colour[1]
    turning = Light(turn_deg_per_s=0.5)
    assert turning.sun_at(0.01) == turning.sun_at(0.02)
    assert np.degrees(turning.sun_at(20.0).azimuth - turning.sun_at(0.0).azimuth) == pytest.approx(10.0, abs=0.06)


def test_shadows_turn_with_the_sun():
    wall = ground(
        Look.CONCRETE, surface=lambda x, y: np.where((abs(x) < 0.3) & (abs(y) < 0.3), 4.0, 0.0),
        light=Light(azimuth_deg=180.0, elevation_deg=45.0, turn_deg_per_s=9.0),
    )  # fmt: skip
    eye = Eye(SMALL)
    south, west = (eye.radiance(wall, above(up=15.0), t)[..., 1] for t in (0.0, 10.0))
    assert south[47, 79 - 16] < 0.4 * south[47 - 16, 79]  # 2 m to the north dark, 2 m to the east bright
    assert west[47 - 16, 79] < 0.4 * west[47, 79 - 16]


# -- looks


def test_every_look_has_a_row_and_texture_from_5_to_150_m():
    assert set(materials()) == set(Look)
    assert tables()[0].shape == (len(Look), texture.TRAITS)
    for look in (Look.MEADOW, Look.SOIL, Look.ASPHALT, Look.SAND, Look.ROCK, Look.BROADLEAF):
        for up in (5.0, 40.0, 150.0):
            picture = Eye(SMALL).radiance(ground(look, side=30.0, cell=0.2), above(up=up), 0.0)[..., 1]
            assert picture.std() > 0.01 * picture.mean(), (look, up)


def test_plain_surfaces_are_plain_and_white_ones_bright():
    def look_at(look):
        picture = Eye(SMALL).radiance(ground(look), above(up=20.0), 0.0)[..., 1]
        return picture.mean(), (np.diff(picture, axis=1).std() / picture.mean())

    grass, sand, snow, white = (look_at(k) for k in (Look.MEADOW, Look.SAND, Look.SNOW, Look.WHITE))
    assert sand[1] < 0.25 * grass[1]
    assert snow[1] < 0.25 * grass[1]
    assert min(snow[0], white[0]) > 0.8  # full scale of the usual gain of 1.25
    assert grass[0] < 0.25


def test_leaves_look_different_from_two_places_and_stones_do_not():
    """Plants have several layers in depth, so that matching is as hard as on real ones."""

    def likeness(look):
        world = ground(look, side=40.0)
        a, b = (Eye(SMALL).radiance(world, above(east, 0.0, 8.0), 0.0)[..., 1] for east in (0.0, 2.0))
        fine = [np.diff(v) for v in (a[:-30], b[30:])]  # the camera moved up in the picture
        return np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1]

    assert likeness(Look.GRAVEL) > 0.9
    assert likeness(Look.CONIFER) < 0.7


def test_wind_moves_grass_and_not_asphalt():
    for look, moves in ((Look.TALL_GRASS, True), (Look.ASPHALT, False)):
        a, b = (Eye(SMALL).radiance(ground(look), above(), t) for t in (0.0, 0.3))
        assert np.array_equal(a, b) != moves


def test_tint_multiplies_the_look():
    n = 401
    tint = np.ones((n, n, 3), np.float32)
    tint[:, 200:] = (2.0, 0.5, 1.0)
    plain, tinted = (Eye(SMALL).radiance(ground(Look.PLAIN, tint=x), above(), 0.0) for x in (None, tint))
    ratio = tinted / plain
    assert ratio[5:40, 20:140].mean(axis=(0, 1)) == pytest.approx([2.0, 0.5, 1.0], rel=3e-3)  # east is up
    assert ratio[60:90, 20:140].mean(axis=(0, 1)) == pytest.approx([1.0, 1.0, 1.0], rel=3e-3)


# -- edges, plants, far pictures


def test_a_thing_askew_to_the_grid_has_a_straight_edge_of_colour():
    n, turn = 301, np.radians(17.0)
    grid = Grid(-15.0, 15.0, 0.1, n, n)
    x, y = (a.ravel() for a in grid.xy())
    u = np.cos(turn) * x[None] + np.sin(turn) * y[:, None]  # east of the edge stands a block
    covered = np.clip(0.5 + u / (0.1 * (np.cos(turn) + np.sin(turn))), 0.0, 1.0)
    look = np.where(covered >= 0.5, Look.WHITE, Look.ASPHALT).astype(np.uint8)
    label = np.where(covered >= 0.5, Terrain.STRUCTURE, Terrain.PAVED).astype(np.uint8)
    world = world_of(grid, (0.4 * covered).astype(np.float32), label, look=look, light=Light(elevation_deg=80.0))
    camera = Camera(160, 96, 600.0, 600.0, 79.5, 47.5)
    picture = Eye(camera).radiance(world, above(up=12.0), 0.0)[..., 1]
    rows = np.array([np.argmax(column < 0.4) for column in picture.T], float)  # image top is east
    away = rows - np.polyval(np.polyfit(np.arange(160), rows, 1), np.arange(160))
    assert rows.min() > 5
    assert away.std() * 12.0 / 600.0 < 0.016  # metres; a stair of cells: 0.03


def test_what_is_matched_on_short_plants_is_the_height_that_truth_knows():
    camera, up, base = Camera(320, 240, 600.0, 600.0, 159.5, 119.5), 27.0, 2.7
    for look in (Look.MEADOW, Look.LAWN, Look.DRY_GRASS, Look.STUBBLE, Look.HEATH, Look.SOIL, Look.ASPHALT):
        eye, world = Eye(camera), ground(look, side=60.0)
        left, right = (eye.radiance(world, above(3.0, n, up), 0.0)[..., 1] for n in (0.5 * base, -0.5 * base))
        shift = round(camera.fu * base / up)
        found = []
        for r in range(20, 220, 24):
            for c in range(shift + 20, 300, 24):
                a = left[r - 12 : r + 13, c - 12 : c + 13]
                likeness = [
                    np.corrcoef(a.ravel(), right[r - 12 : r + 13, c - shift + d - 12 : c - shift + d + 13].ravel())[
                        0, 1
                    ]
                    for d in (-1, 0, 1)
                ]
                bend = likeness[0] - 2 * likeness[1] + likeness[2]
                found.append(shift - 0.5 * (likeness[0] - likeness[2]) / bend)
        assert up - camera.fu * base / np.median(found) == pytest.approx(0.0, abs=0.012), look


def test_coarser_layers_are_means_and_what_most_are():
    rng = np.random.default_rng(3)
    layer = rng.random((8, 12, 2)).astype(np.float32)
    assert coarser.mean_of(layer, 2) == pytest.approx(layer.reshape(2, 4, 3, 4, 2).mean(axis=(1, 3)), abs=1e-6)
    codes = np.array([[7, 3, 1, 1], [3, 3, 2, 2], [5, 4, 9, 8], [6, 4, 8, 7]], np.uint16)
    assert coarser.most_of(codes, 1).tolist() == [[3, 1], [4, 8]]
    margin = rng.uniform(-0.5, 0.5, (16, 16)).astype(np.float32)
    t = np.clip((margin + 0.03) / 0.08, 0, 1)
    share = (t * t * (3 - 2 * t)).reshape(8, 2, 8, 2).mean(axis=(1, 3))
    t = np.clip((coarser.mean_shadow(margin, 1) + 0.03) / 0.08, 0, 1)
    assert t * t * (3 - 2 * t) == pytest.approx(share, abs=1e-5)


def test_a_far_picture_is_as_smooth_as_many_rays_would_make_it(monkeypatch):
    """Stripes and shadows finer than a pixel do not sparkle, and the picture needs less memory."""
    n = 1201
    tint = np.ones((n, n, 3), np.float32)
    tint[::2, ::3] = 0.1
    world = ground(
        Look.PLAIN, side=120.0, tint=tint, surface=lambda x, y: 0.3 * (np.sin(9.0 * x) * np.sin(8.0 * y) > 0.5)
    )
    one, many = (Eye(SMALL, k).radiance(world, above(up=60.0), 0.0)[..., 1] for k in (1, 16))
    monkeypatch.setattr(cameras, "COARSEST", 0)
    sparkling = Eye(SMALL).radiance(world, above(up=60.0), 0.0)[..., 1]
    assert np.std(one - many) < 0.35 * np.std(sparkling - many)
    box = (-30.0, -30.0, 30.0, 30.0)
    fine, coarse = world.patch(box), world.patch(box, 0.0, 2)
    assert np.array_equal(fine.height, coarse.height)
    assert coarse.light.shape[0] == fine.light.shape[0] // 4
    assert coarse.nbytes < 0.35 * fine.nbytes
    assert coarse.skin_place == pytest.approx(fine.place * (1, 1, 4) + (0.15, -0.15, 0.0))
