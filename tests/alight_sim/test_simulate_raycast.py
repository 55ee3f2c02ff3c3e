"""Rays, noise, light: exact against closed forms and plain NumPy twins; pictures do not depend on threads."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from alight.geometry import Camera, Grid, Pose, so3_exp
from alight.records import Terrain
from alight_sim.cameras import Eye
from alight_sim.kernels.noise import MASK, UNIT_STD, gradient_noise, hash3
from alight_sim.kernels.raycast import cast_ray, cast_rays, max_pyramid
from alight_sim.light import Light
from alight_sim.patch import GroundPatch
from alight_sim.scene_world import world_of

LENSES = {
    "none": Camera(96, 72, 72.0, 71.0, 48.3, 36.1),
    "radtan": Camera(96, 72, 72.0, 71.0, 48.3, 36.1, "radial-tangential", (-0.09, 0.019, -0.0008, 0.0007)),
    "fisheye": Camera(96, 72, 60.0, 60.0, 48.3, 36.1, "equidistant", (-0.01, 0.02, -0.01, 0.002)),
}
DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def make_world(surface, side=60.0, cell=0.1, kind=Terrain.SHORT_GRASS, **more):
    n = round(side / cell) + 1
    grid = Grid(-side / 2, side / 2, cell, n, n)
    x, y = grid.xy()
    height = np.asarray(surface(*np.meshgrid(x, y)), np.float32)
    return world_of(grid, height, np.full(grid.shape, kind, np.uint8), **more)


def tilted(east=1.3, north=-2.1, up=20.0):
    a, b = 0.05, -0.08
    tilt = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    roll = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return Pose(tilt @ roll @ DOWN, np.array([east, north, up]))


def look(world, camera, pose):
    """Return depth and world points of all pixels."""
    eye = Eye(camera)
    depth = eye.depth(world, pose)
    return depth, pose.apply(eye.rays[0].astype(np.float64) * depth[..., None])


@pytest.mark.parametrize("lens", LENSES)
def test_plane_depth_is_exact_through_every_lens(lens):
    world = make_world(lambda x, y: 0.15 * x - 0.08 * y + 1.0, side=80.0)
    depth, points = look(world, LENSES[lens], tilted())
    assert (depth > 0).all()
    error = points[..., 2] - (0.15 * points[..., 0] - 0.08 * points[..., 1] + 1.0)
    assert np.abs(error).max() < 5e-6  # heights are stored in float32


@pytest.mark.parametrize("lens", LENSES)
def test_what_a_pixel_hits_projects_back_onto_the_pixel(lens):
    world = make_world(lambda x, y: np.sin(x) + 0.5 * np.cos(1.7 * y), side=80.0)
    pose = tilted()
    _, points = look(world, LENSES[lens], pose)
    u, v = np.meshgrid(np.arange(96.0), np.arange(72.0))
    uv = LENSES[lens].project(pose.inverse.apply(points))
    assert np.abs(uv - np.stack([u, v], -1)).max() < 1e-3


def test_sphere_bump_is_hit_where_the_sphere_is():
    radius = 5.0

    def cap(x, y):
        return np.sqrt(np.maximum(radius**2 - x**2 - y**2, 3.0**2))

    world = make_world(cap, cell=0.05)
    _, points = look(world, LENSES["radtan"], tilted(up=25.0))
    on_cap = np.hypot(points[..., 0], points[..., 1]) < 3.9
    assert on_cap.sum() > 300
    off = np.linalg.norm(points[on_cap], axis=-1) - radius
    assert np.abs(off).max() < 1e-3
    flat = np.hypot(points[..., 0], points[..., 1]) > 4.1
    assert np.abs(points[flat][:, 2] - 3.0).max() < 1e-6


def subpixel_hits(world, camera, pose, pixels):
    patch = world.patch(world.extent)
    to_grid = np.diag([1 / world.cell, -1 / world.cell, 1.0])
    row, col = patch.grid.index(*pose.translation[:2])
    out = np.empty((1, len(pixels)))
    origins, low = np.array([[float(col), float(row), pose.translation[2]]]), patch.low
    rays = camera.rays(pixels).astype(np.float32)  # as an eye rounds them
    cast_rays(patch.height, *patch.pyramid, origins, rays[None], (to_grid @ pose.rotation)[None], low, out)
    return rays * out[0][:, None]


def test_rays_that_fall_freely_meet_what_a_walk_from_the_camera_meets():
    rng = np.random.default_rng(8)
    for up, lean in ((30.0, 0.0), (14.0, 25.0), (11.0, 60.0)):
        height = rng.normal(0, 0.4, (120, 140)).astype(np.float32)
        for r, c in rng.integers(0, 110, (25, 2)):  # towers, and pits beside them
            height[r : r + rng.integers(1, 8), c : c + rng.integers(1, 8)] += rng.uniform(-4, 9)
        pyramid = max_pyramid(height)
        patch = GroundPatch(Grid(0.0, 0.0, 1.0, *height.shape), height, np.zeros(height.shape, np.uint8), np.ones(1))
        turn = np.diag([1.0, 1.0, -1.0]) @ so3_exp(np.array([np.radians(lean), 0.0, 0.3]))
        rays = np.ones((37, 45, 3), np.float32)
        rays[..., 0], rays[..., 1] = np.meshgrid(np.linspace(-0.8, 0.8, 45), np.linspace(-0.6, 0.6, 37))
        origin, out = np.array([60.2, 55.7, up]), np.empty((37, 45))
        cast_rays(height, *patch.pyramid, origin[None], rays, turn[None], float(height.min()), out)
        expected = [[cast_ray(height, *pyramid, origin, turn @ ray) for ray in row] for row in rays]
        assert np.abs(out - expected).max() < 1e-9
        assert (out > 0).mean() > 0.5


@pytest.mark.parametrize("lens", LENSES)
def test_step_edge_lies_where_projection_says_to_a_fiftieth_of_a_pixel(lens):
    world = make_world(lambda x, y: np.where(x > 3.95, 2.0, 0.0))
    pose, camera = tilted(east=0.0, north=0.0), LENSES[lens]
    north = np.linspace(-5, 5, 21)
    truth = world.truth()
    brink = truth.grid.xy()[0][np.argmax(truth.height[0] > 1.0)]
    edge = camera.project(pose.inverse.apply(np.stack([np.full(21, brink), north, np.full(21, 2.0)], -1)))
    # image direction of east
    beyond = camera.project(pose.inverse.apply(np.stack([np.full(21, brink + 0.1), north, np.full(21, 2.0)], -1)))
    way = (beyond - edge) / np.linalg.norm(beyond - edge, axis=1, keepdims=True)
    for side, sign in (("on", 1.0), ("off", -1.0)):
        pixels = edge + sign * 0.02 * way
        up = pose.apply(subpixel_hits(world, camera, pose, pixels))[:, 2]
        assert (np.abs(up - 2.0) < 1e-6).all() if side == "on" else (up < 1.999).all()


def march(height, origin, ray, far=200.0, step=0.01):
    """NumPy twin of `cast_ray`: a dense march, then bisection; MISS is -1."""
    rows, cols = height.shape

    def gap(t):
        p = origin[:, None] + ray[:, None] * np.atleast_1d(t)
        inside = (p[0] >= 0) & (p[0] <= cols - 1) & (p[1] >= 0) & (p[1] <= rows - 1)
        h = map_coordinates(height.astype(np.float64), [p[1], p[0]], order=1, mode="nearest")
        return np.where(inside, p[2] - h, np.inf)

    t = np.arange(0.0, far, step)
    g = gap(t)
    below = np.flatnonzero(g <= 0)
    if len(below) == 0:
        return -1.0
    k = below[0]
    if k == 0 or not np.isfinite(g[k - 1]):  # starts below, or enters the grid through its side
        return t[k]
    lo, hi = t[k - 1], t[k]
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        lo, hi = (mid, hi) if gap(mid)[0] > 0 else (lo, mid)
    return hi


def test_ray_agrees_with_a_dense_march_on_rough_ground():
    rng = np.random.default_rng(3)
    height = rng.uniform(0, 4, (13, 18)).astype(np.float32)
    height[4:6, 7:9] = 9.0
    pyramid = max_pyramid(height)
    hits, exact = 0, 0
    for _ in range(150):
        origin = np.array([rng.uniform(-3, 20), rng.uniform(-3, 15), rng.uniform(9.1, 16)])
        target = np.array([rng.uniform(0, 17), rng.uniform(0, 12), rng.uniform(-2, 6)])
        ray = (target - origin) / 10.0
        expected, got = march(height, origin, ray), cast_ray(height, *pyramid, origin, ray)
        if expected < 0 or got < 0:
            # a march may step over a grazed tip or a corner of the grid, never over more
            if (expected < 0) != (got < 0):
                p = origin + ray * max(got, expected)
                h = map_coordinates(height.astype(float), [[p[1]], [p[0]]], order=1, mode="nearest")
                assert abs(p[2] - h[0]) < 0.05 or min(p[0], p[1], 17 - p[0], 12 - p[1]) < 0.05
            continue
        hits += 1
        exact += abs(got - expected) < 1e-9
        # where the march stepped over a grazed tip, the ray is earlier, and on the surface there
        p = origin + ray * got
        h = map_coordinates(height.astype(float), [[p[1]], [p[0]]], order=1, mode="nearest")
        assert got <= expected + 1e-9
        assert abs(p[2] - h[0]) < 1e-9 or min(p[0], p[1], 17 - p[0], 12 - p[1]) < 1e-6
    assert hits > 80
    assert exact > 0.95 * hits


@pytest.mark.parametrize(
    "ray", [(0.0, 0.0, -1.0), (1.0, 0.0, -0.4), (0.0, -1.0, -0.4), (-1.0, 0.0, -0.4), (1.0, 1.0, -0.5)]
)
def test_rays_along_axes_and_diagonals_meet_a_plane_exactly(ray):
    height = np.full((33, 33), 2.0, np.float32)
    t = cast_ray(height, *max_pyramid(height), np.array([16.0, 16.0, 6.0]), np.array(ray))
    assert t == pytest.approx(4.0 / -ray[2], abs=1e-12)


def test_rays_that_see_no_ground_miss():
    height = np.zeros((9, 9), np.float32)
    pyramid = max_pyramid(height)
    for origin, ray in (
        ((4, 4, 3), (0, 0, 1)),
        ((4, 4, 3), (1, 0, 0)),
        ((-5, 4, 3), (-1, 0, -1)),
        ((4, 4, 3), (9, 0, -1)),
    ):
        assert cast_ray(height, *pyramid, np.array(origin, float), np.array(ray, float)) == -1.0


def test_shadow_of_a_wall_is_as_long_as_the_sun_says():
    light = Light(azimuth_deg=180.0, elevation_deg=45.0)  # from the south
    world = make_world(lambda x, y: np.where(np.abs(y) < 0.26, 2.0, 0.0), side=12.0, light=light)
    patch = world.patch(world.extent)
    margin = patch.light[:, patch.grid.cols // 2, 2]
    _, north = patch.grid.xy()
    shadow = (margin < 0) & (np.abs(north) > 0.35)
    assert north[shadow].min() > 0.3
    assert north[shadow].max() == pytest.approx(0.2 + 2.0, abs=0.11)


def hash_twin(i, j, seed):
    i, j = np.asarray(i, np.int64), np.asarray(j, np.int64)
    h = (i * 0x2DA6B343 + (seed * 0x4B1AB31F & MASK)) & MASK
    for add, factors in ((j * 0x58163841, (0x21F0AAAD,)), (0, (0x21F0AAAD, 0x735A2D97))):
        for k, factor in enumerate(factors):
            h = h ^ (h >> (15 if k else 16))
            h = (h * factor) & MASK
        h = ((h ^ (h >> 15)) + add) & MASK
    return h


def noise_twin(x, y, seed):
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = x - i, y - j
    blend = [t**3 * (t * (t * 6 - 15) + 10) for t in (u, v)]
    total = np.zeros_like(x)
    for a in (0, 1):
        for b in (0, 1):
            h = hash_twin(i + a, j + b, seed)
            gx, gy = [(k / 32768.0 - 1.0) * UNIT_STD for k in (h & 0xFFFF, h >> 16)]
            wx, wy = (blend[0] if a else 1 - blend[0]), (blend[1] if b else 1 - blend[1])
            total += wx * wy * (gx * (u - a) + gy * (v - b))
    return total


def test_noise_agrees_with_numpy_and_has_unit_deviation_and_true_slopes():
    xy = np.random.default_rng(1).uniform(-3000, 3000, (4000, 2))
    got = np.array([gradient_noise(x, y, 9) for x, y in xy])
    e = 1e-5
    assert np.abs(got[:, 0] - noise_twin(xy[:, 0], xy[:, 1], 9)).max() < 1e-9
    assert got[:, 0].std() == pytest.approx(1.0, abs=0.05)
    slope_x = (noise_twin(xy[:, 0] + e, xy[:, 1], 9) - noise_twin(xy[:, 0] - e, xy[:, 1], 9)) / (2 * e)
    slope_y = (noise_twin(xy[:, 0], xy[:, 1] + e, 9) - noise_twin(xy[:, 0], xy[:, 1] - e, 9)) / (2 * e)
    near_lattice = (np.abs(xy - np.round(xy)) < 2 * e).any(axis=1)
    assert np.abs(got[~near_lattice, 1] - slope_x[~near_lattice]).max() < 1e-4
    assert np.abs(got[~near_lattice, 2] - slope_y[~near_lattice]).max() < 1e-4


def test_hash_repeats_nowhere_near_and_uses_all_bits():
    i, j = np.meshgrid(np.arange(-150, 150), np.arange(-150, 150))
    h = hash_twin(i, j, 4)
    assert hash3(-7, 12, 4) == hash_twin(-7, 12, 4)
    assert len(np.unique(h)) > 0.9999 * h.size
    bits = (h[..., None] >> np.arange(32)) & 1
    assert np.abs(bits.mean(axis=(0, 1)) - 0.5).max() < 0.01


def draw(world, height, seconds=0.0, camera=LENSES["radtan"]):
    return Eye(camera).radiance(world, tilted(up=height), seconds)


@pytest.fixture(scope="module")
def meadow():
    return make_world(lambda x, y: 0.2 * np.sin(x), side=30.0)


def test_picture_does_not_depend_on_threads(meadow, on_one_and_all):
    one, other = on_one_and_all(lambda: draw(meadow, 10.0))
    assert np.array_equal(one, other)


def test_water_moves_and_ground_does_not(meadow):
    truth = meadow.truth()
    pond = world_of(truth.grid, truth.height, np.full_like(truth.label, Terrain.WATER), np.full_like(truth.height, 0.5))
    road = world_of(truth.grid, truth.height, np.full_like(truth.label, Terrain.PAVED))
    assert np.array_equal(draw(road, 10.0, 0.0), draw(road, 10.0, 0.1))
    a, b = draw(pond, 10.0, 0.0), draw(pond, 10.0, 0.1)
    assert (np.abs(a - b) / a.mean() > 0.01).mean() > 0.5


def test_texture_is_fixed_to_the_ground():
    """A point seen from two places has one colour, so that matching is possible."""
    flat = make_world(lambda x, y: 0.0 * x, side=40.0)
    camera = LENSES["none"]
    a, b = Pose(DOWN, np.array([0.0, 0.0, 14.4])), Pose(DOWN, np.array([2.0, 1.0, 14.4]))
    eye = Eye(camera)
    first, second = (eye.radiance(flat, p, 0.0)[..., 1] for p in (a, b))
    u, v = np.meshgrid(np.arange(96.0), np.arange(72.0))
    points = a.apply(camera.rays(np.stack([u, v], -1)) * 14.4)
    uv = camera.project(b.inverse.apply(points))
    warped = map_coordinates(second.astype(float), [uv[..., 1], uv[..., 0]], order=3, cval=np.nan)
    seen = np.isfinite(warped)
    seen[:3], seen[-3:], seen[:, :3], seen[:, -3:] = False, False, False, False
    together = np.corrcoef(first[seen], warped[seen])[0, 1]
    apart = np.corrcoef(first[seen], second[seen])[0, 1]
    assert together > 0.97
    assert abs(apart) < 0.5


def test_texture_is_band_limited_by_the_pixel():
    """One ray a pixel is close to four: there is no sparkle that a lens would not show."""
    flat = make_world(lambda x, y: 0.0 * x, side=100.0, cell=0.2)
    pose = Pose(DOWN, np.array([0.0, 0.0, 30.0]))
    one, four = (Eye(LENSES["none"], n).radiance(flat, pose, 0.0) for n in (1, 4))
    assert np.std(one - four) < 0.5 * np.std(four)
