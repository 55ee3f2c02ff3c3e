"""Sensors, imaging and faults: closed forms, true sigmas, and a random stream for each source of errors."""

import dataclasses
import math

import numpy as np
import pytest
from quiet_imaging import QUIET

from alight.geometry import Camera, so3_exp, so3_log
from alight_sim import Air, Faults, FlightPlan, Imaging, ImuErrors, NavErrors, default_rig
from alight_sim.exposure import Sensor, gains, irregular_gauss_markov
from alight_sim.faults import Calibration, exposures
from alight_sim.kernels.exposure import LEVELS, develop
from alight_sim.patterns import line
from alight_sim.sensors import MarkovNoise, imu_biases, simulated_imu, simulated_nav
from alight_sim.vehicle import fly_through

SILENT_NAV = {
    "position": (0, 0, 0), "position_white": 0, "attitude_deg": (0, 0, 0), "attitude_white_deg": 0, "velocity_white": 0,
    "rate_white_deg": 0,
}  # fmt: skip
SILENT_IMU = {
    "gyroscope_noise_density": 0, "gyroscope_random_walk": 0, "accelerometer_noise_density": 0,
    "accelerometer_random_walk": 0, "gyroscope_bias": 0, "accelerometer_bias": 0,
}  # fmt: skip
LENS = Camera(64, 48, 48.0, 48.0, 31.5, 23.5)


def seeds(*key):
    return np.random.SeedSequence(11, spawn_key=key)


@pytest.fixture(scope="module")
def trajectory():
    plan = FlightPlan(duration=20.0)
    return fly_through(line(plan), 5.0, np.random.default_rng(1), air=Air(), rolling=True)


def nav_of(trajectory, seconds=None, **errors):
    t = np.arange(0.0, 20.0, 0.1) if seconds is None else seconds
    return list(simulated_nav(trajectory, np.round(t * 1e9).astype(np.int64), t, NavErrors(**errors), seeds(1)))


def imu_of(trajectory, **errors):
    t, e = np.arange(0.0, 4.0, 0.01), ImuErrors(rate_hz=100.0, **errors)
    biases = imu_biases(len(t), e, seeds(2))
    return list(simulated_imu(trajectory, np.round(t * 1e9).astype(np.int64), t, biases, e, seeds(3)))


def field(samples, name):
    return np.array([getattr(s, name) for s in samples])


# -- GPS/INS


def test_drift_has_the_claimed_deviation_and_correlation_time():
    t = np.arange(0, 4000, 1.0)
    noise = MarkovNoise(np.random.default_rng(2), np.array([1.0, 2.0] * 20), 60.0)
    x = np.array([noise.at(s) for s in t])
    assert x[:, ::2].std() == pytest.approx(1.0, rel=0.05)
    assert x[:, 1::2].std() == pytest.approx(2.0, rel=0.05)
    lag = (x[60:, ::2] * x[:-60, ::2]).mean() / x[:, ::2].var()
    assert lag == pytest.approx(math.exp(-1), abs=0.06)


def test_without_errors_the_solution_is_the_truth(trajectory):
    for s in nav_of(trajectory, **SILENT_NAV)[::20]:
        t = s.t_ns * 1e-9
        assert s.position_world == pytest.approx(trajectory.place_world(t), abs=1e-12)
        assert s.velocity_world == pytest.approx(trajectory.velocity_world(t), abs=1e-12)
        assert s.world_from_body == pytest.approx(trajectory.rotations(t), abs=1e-12)
        assert s.angular_velocity_body == pytest.approx(trajectory.angular_velocity_body(t), abs=1e-12)


def test_jumps_begin_end_and_add_up_as_asked(trajectory):
    jumps = [{"at": 3.0, "seconds": 4.0, "offset": (5, 0, -1)}, {"at": 6.0, "offset": (0, 2, 0)}]
    still, jumped = nav_of(trajectory), nav_of(trajectory, jumps=jumps)
    off = field(jumped, "position_world") - field(still, "position_world")
    t = np.array([s.t_ns for s in jumped]) * 1e-9
    expected = np.where(((t >= 3.0) & (t < 7.0))[:, None], [5, 0, -1], 0) + np.where((t >= 6.0)[:, None], [0, 2, 0], 0)
    assert off == pytest.approx(expected, abs=1e-9)


def test_outages_empty_the_position_or_take_the_rows(trajectory):
    outages = [{"at": 2.0, "seconds": 3.0}, {"at": 10.0, "seconds": 1.5, "what": "rows"}]
    whole, holed = nav_of(trajectory), nav_of(trajectory, outages=outages)
    assert len(whole) - len(holed) == 15
    t = np.array([s.t_ns for s in holed]) * 1e-9
    assert not ((t >= 10.0) & (t < 11.5)).any()
    empty = np.array([s.position_world is None for s in holed])
    assert np.array_equal(empty, (t >= 2.0) & (t < 5.0))
    assert all((s.sigma_position is None) == (s.position_world is None) for s in holed)
    by_time = {s.t_ns: s for s in whole}
    for s in holed:  # the remaining rows are unchanged
        assert np.array_equal(s.world_from_body, by_time[s.t_ns].world_from_body)
        assert np.array_equal(s.velocity_world, by_time[s.t_ns].velocity_world)


def test_heading_is_wrong_clockwise_at_the_start_and_fades(trajectory):
    for tau, share in ((None, 1.0), (5.0, math.exp(-2.0))):
        s = nav_of(trajectory, **SILENT_NAV, yaw_start_deg=8.0, yaw_tau=tau)[100]  # 10 s
        wrong = s.world_from_body @ trajectory.rotations(10.0).T
        assert so3_log(wrong) == pytest.approx([0.0, 0.0, -math.radians(8.0) * share], abs=1e-9)


def test_latency_tells_what_was_true_before(trajectory):
    for s in nav_of(trajectory, **SILENT_NAV, latency=0.35)[10::40]:
        assert s.position_world == pytest.approx(trajectory.place_world(s.t_ns * 1e-9 - 0.35), abs=1e-12)
        assert s.world_from_body == pytest.approx(trajectory.rotations(s.t_ns * 1e-9 - 0.35), abs=1e-12)


def test_position_errors_have_the_claimed_sigma():
    hover = fly_through(line(FlightPlan(pattern="hover")), 5.0, np.random.default_rng(0), hold=600.0)
    t = np.arange(600.0)
    drifting = {"position": (1.0, 0.5, 2.0), "position_tau": 0.4, "position_white": 0.3}
    clean, noisy = nav_of(hover, t, **SILENT_NAV), nav_of(hover, t, **(SILENT_NAV | drifting))
    error = field(noisy, "position_world") - field(clean, "position_world")
    assert error.std(axis=0) == pytest.approx(noisy[0].sigma_position, rel=0.12)
    assert noisy[0].sigma_position == pytest.approx(np.hypot([1.0, 0.5, 2.0], 0.3))


CHANCES = {
    "position": ("position", (3, 3, 3)), "position_white": ("position", 0.5), "velocity_white": ("velocity", 1.0),
    "velocity": ("velocity", 0.7), "attitude_deg": ("attitude", (3, 3, 3)), "attitude_white_deg": ("attitude", 1.0),
    "rate_white_deg": ("rate", 3.0), "jumps": ("position", [{"at": 0.0, "offset": (1, 1, 1)}]),
    "yaw_start_deg": ("attitude", 4.0),
}  # fmt: skip


@pytest.mark.parametrize("wish", CHANCES)
def test_changing_one_error_of_gps_ins_leaves_the_others_bit_for_bit(trajectory, wish):
    touched, value = CHANCES[wish]
    names = {
        "position": "position_world", "velocity": "velocity_world", "attitude": "world_from_body",
        "rate": "angular_velocity_body",
    }  # fmt: skip
    before, after = nav_of(trajectory), nav_of(trajectory, **{wish: value})
    for what, name in names.items():
        assert np.array_equal(field(before, name), field(after, name)) == (what != touched), what


# -- IMU


def test_without_errors_the_imu_is_the_truth(trajectory):
    for s in imu_of(trajectory, **SILENT_IMU)[::97]:
        assert s.angular_velocity_body == pytest.approx(trajectory.angular_velocity_body(s.t_ns * 1e-9), abs=1e-12)
        assert s.specific_force_body == pytest.approx(trajectory.specific_force_body(s.t_ns * 1e-9), abs=1e-12)


def test_imu_noise_has_its_density_and_biases_walk():
    quiet = {k: v for k, v in SILENT_IMU.items() if k not in ("gyroscope_random_walk", "gyroscope_noise_density")}
    e = ImuErrors(rate_hz=100.0, **quiet, gyroscope_random_walk=0.02)
    ends = [imu_biases(401, e, np.random.SeedSequence(k))[0][-1] for k in range(120)]
    assert np.std(ends) == pytest.approx(0.02 * math.sqrt(4.01), rel=0.12)  # density x root of time
    starts = [imu_biases(1, ImuErrors(gyroscope_bias=0.5), np.random.SeedSequence(k))[0][0] for k in range(200)]
    assert np.std(starts) == pytest.approx(0.5, rel=0.12)


def test_white_noise_of_the_imu_has_its_density(trajectory):
    clean = imu_of(trajectory, **SILENT_IMU)
    noisy = imu_of(trajectory, **(SILENT_IMU | {"accelerometer_noise_density": 0.01}))
    error = field(noisy, "specific_force_body") - field(clean, "specific_force_body")
    assert error.std() == pytest.approx(0.01 * math.sqrt(100.0), rel=0.06)
    assert np.array_equal(field(noisy, "angular_velocity_body"), field(clean, "angular_velocity_body"))


def test_scale_and_misalignment_bend_the_axes_linearly(trajectory):
    clean = imu_of(trajectory, **SILENT_IMU)
    bent = imu_of(trajectory, **SILENT_IMU, accelerometer_scale=0.03, misalignment_deg=1.0)
    f, g = field(clean, "specific_force_body"), field(bent, "specific_force_body")
    M = np.linalg.lstsq(f, g, rcond=None)[0].T
    assert np.abs(f @ M.T - g).max() < 1e-9
    assert 0.0 < np.abs(np.diag(M) - 1.0).max() < 0.12
    assert 0.0 < np.abs(M - np.diag(np.diag(M))).max() < 5 * math.radians(1.0)
    turned = field(bent, "angular_velocity_body") - field(clean, "angular_velocity_body")
    assert np.abs(turned).max() > 0.0  # misaligned too


@pytest.mark.parametrize(
    ("wish", "name"),
    [
        ({"gyroscope_noise_density": 0.1}, "specific_force_body"),
        ({"gyroscope_random_walk": 0.1}, "specific_force_body"),
        ({"gyroscope_bias": 0.1}, "specific_force_body"),
        ({"gyroscope_scale": 0.1}, "specific_force_body"),
        ({"accelerometer_noise_density": 0.1}, "angular_velocity_body"),
        ({"accelerometer_random_walk": 0.1}, "angular_velocity_body"),
        ({"accelerometer_bias": 0.1}, "angular_velocity_body"),
        ({"accelerometer_scale": 0.1}, "angular_velocity_body"),
    ],
)
def test_changing_one_error_of_the_imu_leaves_the_other_sensor_bit_for_bit(trajectory, wish, name):
    before, after = imu_of(trajectory), imu_of(trajectory, **wish)
    other = ({"specific_force_body", "angular_velocity_body"} - {name}).pop()
    assert np.array_equal(field(before, name), field(after, name))
    assert not np.array_equal(field(before, other), field(after, other))


# -- imaging


def dice(key, count):
    """NumPy twin of the kernel's noise."""
    with np.errstate(over="ignore"):
        z = np.uint64(key) + (np.arange(count, dtype=np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    total = sum((z >> np.uint64(8 * k)) & np.uint64(255) for k in range(8)).astype(np.float64)
    return (total - 1020.0) / math.sqrt(8 * (256**2 - 1) / 12)


def test_kernel_agrees_with_its_twin():
    rng = np.random.default_rng(4)
    light, falloff = rng.uniform(-0.1, 1.4, (7, 9, 3)).astype(np.float32), rng.uniform(0, 1, (7, 9)).astype(np.float32)
    gain, tone = np.array([0.8, 1.0, 1.3]), np.linspace(0, 255, LEVELS).astype(np.uint8)
    out, key = np.empty((7, 9, 3), np.uint8), 2**63 + 12345
    develop(light, falloff, gain, 1e-3, 1e-5, tone, np.uint64(key), out)
    signal = light.astype(np.float64) * falloff[..., None].astype(np.float64) * gain
    noise = dice(key, signal.size).reshape(signal.shape)
    noisy = np.clip(signal + np.sqrt(1e-3 * np.maximum(signal, 0.0) + 1e-5) * noise, 0.0, 1.0)
    expected = tone[(np.sqrt(noisy) * (LEVELS - 1) + 0.5).astype(int)]
    assert np.abs(out.astype(int) - expected.astype(int)).max() <= 1
    assert (out == expected).mean() > 0.99


def test_noise_is_normal_enough_and_not_correlated():
    x = dice(77, 200_000)
    assert x.mean() == pytest.approx(0.0, abs=0.01)
    assert x.std() == pytest.approx(1.0, abs=0.01)
    for z, share in ((1.0, 0.1587), (2.0, 0.0228)):
        assert (x > z).mean() == pytest.approx(share, abs=0.004)
    for lag in (1, 3, 192):
        assert np.corrcoef(x[:-lag], x[lag:])[0, 1] == pytest.approx(0.0, abs=0.01)
    assert np.corrcoef(x, dice(78, 200_000))[0, 1] == pytest.approx(0.0, abs=0.01)


def flat(level, size=(480, 640)):
    return np.full((*size, 3), level, np.float32)


def exposed(imaging, level, gain=1.0, key=5, covered=0.0, lens=LENS):
    sensor = Sensor.of(lens, imaging, seeds(7))
    return sensor.expose(flat(level, (lens.height, lens.width)), np.full(3, gain), key, covered)


def test_tone_is_the_gamma_curve_and_saturates():
    imaging = Imaging(**QUIET, vignetting=0.0, blur_px=0.0, gamma=2.0)
    for level in (0.0, 0.01, 0.25, 0.5, 1.0, 3.0):
        expected = round(255 * min(level * 1.25, 1.0) ** 0.5)
        assert np.abs(exposed(imaging, level, 1.25).astype(int) - expected).max() <= 1
    assert exposed(imaging, 5.0).min() == 255


def test_vignetting_takes_its_share_in_the_farthest_corner():
    picture = exposed(Imaging(**QUIET, vignetting=0.4, blur_px=0.0, gamma=1.0), 0.5)
    assert picture[0, 0, 0] == pytest.approx(0.6 * 0.5 * 255, abs=1.0)
    assert picture[23, 31, 0] == pytest.approx(0.5 * 255, abs=1.0)


@pytest.mark.parametrize("gain", [1.0, 8.0])
@pytest.mark.parametrize("signal", [0.2, 0.6])
def test_noise_is_shot_and_read_noise_and_grows_with_gain(gain, signal):
    lens = Camera(320, 240, 200.0, 200.0, 159.5, 119.5)
    imaging = Imaging(
        gain_drift=0, white_balance=0, vignetting=0, blur_px=0, gamma=1.0, full_well=2000.0, read_noise=15
    )
    picture = exposed(imaging, signal / gain, gain, lens=lens)
    amplified = gain / 2000.0
    variance = amplified * signal + (15 * amplified) ** 2
    assert picture.std() / 255 == pytest.approx(math.sqrt(variance + (1 / 255) ** 2 / 12), rel=0.03)
    assert picture.mean() / 255 == pytest.approx(signal, abs=2e-3)


def test_a_covered_lens_sees_black_and_hot_pixels_shine_through():
    imaging = Imaging(**QUIET, hot_pixels=0.01)
    picture = exposed(imaging, 0.5, covered=1.0)
    assert picture.max() == 0
    hot = exposed(imaging, 0.0)
    assert (hot > 200).any(axis=2).sum() == pytest.approx(0.01 * 64 * 48, abs=2)


def test_dust_darkens_specks_that_stay_where_they_are():
    clean, dusty = (exposed(Imaging(**QUIET, dust=n), 0.5).astype(int) for n in (0, 3))
    assert (dusty <= clean).all()
    assert 5 < (clean - dusty > 5).any(axis=2).sum() < 0.2 * 64 * 48


def test_pictures_do_not_depend_on_threads(on_one_and_all):
    one, other = on_one_and_all(lambda: exposed(Imaging(), 0.4))
    assert np.array_equal(one, other)
    assert not np.array_equal(one, exposed(Imaging(), 0.4, key=6))


def test_gain_drifts_with_its_deviation_and_time():
    t = np.arange(0.0, 3000.0, 0.5)
    log = np.log(gains(Imaging(gain=2.0, gain_drift=0.1, white_balance=0.0), t, seeds(5)))
    assert log.mean() == pytest.approx(math.log(2.0), abs=0.02)
    assert log[:, 1].std() == pytest.approx(0.1, rel=0.12)
    x = log[:, 1] - log[:, 1].mean()
    assert (x[10:] * x[:-10]).mean() / x.var() == pytest.approx(math.exp(-1.0), abs=0.1)
    assert np.array_equal(log[:, 0], log[:, 2])


def test_gain_steps_and_white_balance_do_what_they_say():
    t = np.arange(0.0, 10.0, 0.5)
    steady = gains(Imaging(gain=1.0, **QUIET), t, seeds(5))
    stepped = gains(Imaging(gain=1.0, **QUIET, gain_steps=[{"at": 4.0, "factor": 1.5}]), t, seeds(5))
    assert (steady == 1.0).all()
    assert stepped == pytest.approx(np.where(t >= 4.0, 1.5, 1.0)[:, None] * np.ones(3))
    tinted = gains(Imaging(gain_drift=0.0, white_balance=0.1), t, seeds(5))
    assert tinted[:, 1] == pytest.approx(1.25)
    assert np.abs(np.log(tinted[:, 0] / tinted[:, 2])).max() > 0.01


def test_exposure_control_follows_the_light_with_its_lag():
    t = np.arange(0.0, 8.0, 0.1)
    metered = np.where(t < 3.0, 0.4, 0.1)
    imaging = Imaging(gain=1.0, auto=True, auto_target=0.2, auto_lag=0.7, **QUIET)
    signal = gains(imaging, t, seeds(5), metered)[:, 1] * metered
    assert signal[:30] == pytest.approx(0.2)
    after = t[31:] - t[30]
    assert np.log(signal[31:] / 0.2) == pytest.approx(math.log(0.25) * np.exp(-after / 0.7), abs=1e-9)
    assert signal[-1] == pytest.approx(0.2, rel=0.01)


def test_wander_does_not_depend_on_the_times_that_are_asked():
    t = np.arange(0.0, 30.0, 0.25)
    keep = np.array([0, 3, 4, 50, 119])
    every = irregular_gauss_markov(np.random.default_rng(3), t, 2, 4.0)
    assert np.array_equal(irregular_gauss_markov(np.random.default_rng(3), t[keep], 2, 4.0), every[keep])


# -- faults


def damage(n=4000, cameras=2, rate=10.0, **wishes):
    beat = 10**18 + np.round(np.arange(n) * 1e9 / rate).astype(np.int64)
    return exposures(Faults(**wishes), beat, cameras, seeds(9)), beat


def test_without_faults_everything_is_there_and_in_time():
    x, beat = damage()
    assert np.array_equal(x.true_ns, beat)
    assert np.array_equal(x.stamp_ns, beat)
    assert np.array_equal(x.arrival_ns, beat)
    assert x.seen.all()
    assert np.array_equal(x.order, np.arange(4000))


def test_the_asked_share_is_lost_late_or_repeated():
    x, beat = damage(dropped=0.2, dropped_one=0.1, late=0.15, late_by=0.4, repeated=0.05)
    whole = x.seen.all(axis=1)
    assert (~x.seen.any(axis=1)).mean() == pytest.approx(0.2, abs=0.02)
    assert (x.seen.sum(axis=1) == 1).mean() == pytest.approx(0.08, abs=0.015)
    assert whole.mean() == pytest.approx(0.72, abs=0.02)
    late = x.arrival_ns - x.stamp_ns
    assert (late > 0).mean() == pytest.approx(0.15, abs=0.02)
    assert late[late > 0].mean() * 1e-9 == pytest.approx(0.4, rel=0.1)
    assert (np.diff(x.stamp_ns) == 0).mean() == pytest.approx(0.05, abs=0.01)
    assert np.array_equal(x.true_ns, beat)
    assert (np.diff(x.arrival_ns[x.order]) >= 0).all()


def test_bursts_lose_exactly_their_time():
    x, _ = damage(n=100, bursts=[{"at": 2.0, "seconds": 1.0}, {"at": 5.0, "seconds": 0.05}])
    assert np.flatnonzero(~x.seen.any(axis=1)).tolist() == [*range(20, 30), 50]


def test_irregular_times_are_true_and_never_cross():
    x, beat = damage(jitter=0.02)
    off = (x.true_ns - beat) * 1e-9
    assert off.std() == pytest.approx(0.0195, rel=0.1)
    assert (np.diff(x.true_ns) > 0).all()
    assert np.array_equal(x.stamp_ns, x.true_ns)


def test_time_offset_is_in_the_stamps_alone():
    x, beat = damage(time_offset=-0.03)
    assert np.array_equal(x.true_ns, beat)
    assert np.array_equal(x.stamp_ns, beat - 30_000_000)


@pytest.mark.parametrize(
    "wish", [{"dropped": 0.3}, {"dropped_one": 0.3}, {"jitter": 0.01}, {"late": 0.3}, {"repeated": 0.3}]
)
def test_changing_one_fault_leaves_the_others_bit_for_bit(wish):
    all_of_them = {"dropped": 0.1, "dropped_one": 0.1, "jitter": 0.002, "late": 0.1, "repeated": 0.1}
    before, _ = damage(**all_of_them)
    after, _ = damage(**(all_of_them | wish))
    lost = [~x.seen.any(axis=1) for x in (before, after)]
    late = [x.arrival_ns > x.stamp_ns for x in (before, after)]
    again = [np.diff(x.stamp_ns) == 0 for x in (before, after)]
    assert np.array_equal(before.true_ns, after.true_ns) == ("jitter" not in wish)
    assert np.array_equal(*lost) == ("dropped" not in wish)
    assert np.array_equal(*late) == ("late" not in wish)
    assert np.array_equal(*again) == ("repeated" not in wish)
    assert (late[1] >= late[0]).all()  # with more of the fault, the exposures that were late are still late


def test_claimed_rig_differs_as_asked():
    true = default_rig()
    wrong = Calibration(focal=0.01, principal=(2.0, -3.0), distortion=0.5, toe_deg=0.2, baseline=0.1)
    claimed = Faults(calibration=wrong).claimed(true)
    for a, b in zip(claimed.cameras, true.cameras, strict=True):
        assert a.camera.fu == pytest.approx(1.01 * b.camera.fu)
        assert (a.camera.cu - b.camera.cu, a.camera.cv - b.camera.cv) == pytest.approx((2.0, -3.0))
        assert a.camera.distortion == pytest.approx(tuple(1.5 * k for k in b.camera.distortion))
    first, second = claimed.cameras
    assert np.array_equal(first.body_from_cam.matrix, true.cameras[0].body_from_cam.matrix)
    turn = true.cameras[1].body_from_cam.rotation.T @ second.body_from_cam.rotation
    assert so3_log(turn) == pytest.approx([0.0, math.radians(0.2), 0.0], abs=1e-12)
    gap = np.linalg.norm(second.body_from_cam.translation - first.body_from_cam.translation)
    assert gap == pytest.approx(0.55)


def test_mounting_error_turns_the_whole_rig():
    true, turn = default_rig(), so3_exp(np.radians([0.5, -1.0, 2.0]))
    claimed = Faults(mounting_deg=(0.5, -1.0, 2.0)).claimed(true)
    for a, b in zip(claimed.cameras, true.cameras, strict=True):
        assert a.body_from_cam.rotation == pytest.approx(turn @ b.body_from_cam.rotation)
        assert a.body_from_cam.translation == pytest.approx(turn @ b.body_from_cam.translation)
        assert a.camera == b.camera
    assert Faults().claimed(true) is true


def test_cover_is_over_its_lens_for_its_time():
    faults = Faults(covered=[{"at": 1.0, "seconds": 2.0, "camera": 1}, {"at": 2.5, "seconds": 1.0, "share": 0.5}])
    seen = [[faults.cover(t, cam) for cam in (0, 1)] for t in (0.5, 1.0, 2.6, 3.2, 4.0)]
    assert seen == [[0.0, 0.0], [0.0, 0.98], [0.5, 0.98], [0.5, 0.5], [0.0, 0.0]]


def test_settings_are_frozen():
    with pytest.raises((dataclasses.FrozenInstanceError, ValueError)):
        Faults().dropped = 0.5
