"""Logs of PX4, of ArduPilot and of a ground station: the same flight as it was, and what they lack."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from autopilot_logs import SEPARATION, Autopilot, telemetry_of, write_dataflash, write_telemetry, write_ulog

from alight.arrays import F64
from alight.flight.logs.logged import LoggedFlight, streams_of
from alight.flight.logs.logged_frames import read_log
from alight.geometry import LocalFrame, so3_exp
from alight.records import ImuSample, InputError, MissingExtraError, NavSample
from alight.sources.source import Findings
from alight.sources.streams import imu_samples, nav_samples

LOCAL = LocalFrame(48.1, 15.44, 301.0)
BEGIN = 1_700_000_000_000_000_000
WRITERS: dict[str, Callable[[Path, Autopilot], None]] = {
    "flight.bin": write_dataflash,
    "flight.tlog": lambda path, a: write_telemetry(path, telemetry_of(a)),
    "flight.ulg": write_ulog,
}


@cache
def autopilot(seconds: float = 3.0) -> Autopilot:
    """An aircraft that turns and climbs; its clock begins 43 s before."""
    events: list[NavSample | ImuSample] = []
    w = np.array([0.1, -0.2, 0.5])
    for k in range(round(50 * seconds)):
        t = 0.02 * k
        R = so3_exp(w * t)
        if k % 5 == 0:
            events.append(NavSample(BEGIN + k * 20_000_000, np.array([3.0 * t, t * t, 30.0 + t]), R,
                                    np.array([3.0, 2.0 * t, 1.0]), w, np.array([0.9, 0.9, 1.4]), None,
                                    np.full(3, 0.1)))  # fmt: skip
        events.append(ImuSample(BEGIN + k * 20_000_000, w, R.T @ [0.0, 2.0, 9.8]))
    return Autopilot(events, LOCAL, BEGIN - 43_000_000_000)


def read(path: Path, separation: float | None = None, findings: Findings | None = None) -> LoggedFlight:
    return streams_of(read_log(path), path.name, separation, findings or Findings())


@pytest.mark.parametrize("name", WRITERS)
def test_a_log_is_the_flight_that_was_flown(tmp_path: Path, name: str) -> None:
    if name.endswith(".ulg"):
        pytest.importorskip("pyulog", reason="PX4's logs need pyulog")
    a = autopilot()
    WRITERS[name](tmp_path / name, a)
    log = read(tmp_path / name)
    assert log.imu is not None
    was = [e for e in a.events if isinstance(e, NavSample)]
    rows = list(nav_samples(log.nav, LOCAL))
    assert [r.t_ns + a.late_ns for r in rows] == [e.t_ns for e in was][: len(rows)]
    assert len(rows) >= len(was) - 1

    def close(own: list[F64 | None], other: list[F64 | None], atol: float) -> None:
        np.testing.assert_allclose(np.array(own[1:], float), np.array(other[1 : len(own)], float), atol=atol)

    close([r.position_world for r in rows], [e.position_world for e in was], 0.02)  # of 1e-7 degrees
    close([r.world_from_body for r in rows], [e.world_from_body for e in was], 2e-4)  # of a hundredth of a degree
    close([r.velocity_world for r in rows], [e.velocity_world for e in was], 6e-3)
    close([r.angular_velocity_body for r in rows], [e.angular_velocity_body for e in was], 1e-3)
    close([r.sigma_position for r in rows], [e.sigma_position for e in was], 1e-6)
    inertial = [e for e in a.events if isinstance(e, ImuSample)]
    own = list(imu_samples(log.imu))
    assert len(own) == len(inertial)  # the second IMU is left out
    close([s.specific_force_body for s in own], [e.specific_force_body for e in inertial], 0.01)
    assert f"{SEPARATION:+.1f} m, by the receiver" in log.found[-1]


def test_heights_above_the_sea_alone_need_the_separation(tmp_path: Path) -> None:
    write_dataflash(tmp_path / "old.bin", autopilot(), ellipsoid="")
    with pytest.raises(InputError, match=r"sources\.separation"):
        read(tmp_path / "old.bin")
    log = read(tmp_path / "old.bin", 30.0)
    height = autopilot().place(next(e for e in autopilot().events if isinstance(e, NavSample)))[2] + 30.0
    assert log.local.height == pytest.approx(height, abs=0.01)


@pytest.mark.parametrize(
    ("ellipsoid", "driver", "refused"),
    [("Und", "u-blox", False), ("AEl", "u-blox", False), ("Und", "NOVA", True), ("AEl", "NOVA", True)],
)
def test_ellipsoidal_heights_of_ardupilot(tmp_path: Path, ellipsoid: str, driver: str, refused: bool) -> None:
    """Its undulation counts from the ellipsoid down; one driver has the opposite sign, in both fields."""
    write_dataflash(tmp_path / "a.bin", autopilot(), ellipsoid, driver)
    if refused:
        with pytest.raises(InputError, match=r"sources\.separation"):
            read(tmp_path / "a.bin")
        return
    assert read(tmp_path / "a.bin").local.height == pytest.approx(LOCAL.height + 30.0, abs=0.02)


def test_a_separation_beside_that_of_the_receiver_is_reported(tmp_path: Path) -> None:
    write_dataflash(tmp_path / "a.bin", autopilot())
    assert "-46.5 m, by sources.separation; the receiver has +46.5 m" in read(tmp_path / "a.bin", -46.5).found[-1]


def test_of_several_starts_the_longest_is_read(tmp_path: Path) -> None:
    """The autopilot restarts in the air: its clock begins anew in one file."""
    long, short = autopilot(), replace(autopilot(1.0), late_ns=BEGIN)
    write_telemetry(tmp_path / "two.tlog", [*telemetry_of(short), *telemetry_of(replace(long, late_ns=BEGIN))])
    assert read(tmp_path / "two.tlog").nav.t_ns[-1] == pytest.approx(2.9e9, abs=1e8)


def test_milliseconds_of_32_bits_go_on_after_they_wrap(tmp_path: Path) -> None:
    late_ns = BEGIN - (2**32 * 1_000_000 - 1_500_000_000)  # they wrap after a second and a half
    messages = [m for m in telemetry_of(replace(autopilot(), late_ns=late_ns)) if "IMU" not in m[1].get_type()]
    write_telemetry(tmp_path / "wrap.tlog", messages)
    t = read(tmp_path / "wrap.tlog").nav.t_ns
    assert len(t) == 30
    np.testing.assert_allclose(np.diff(t), 1e8)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("content", [b"", b"no log at all", bytes(5000)])
def test_what_is_no_log_is_refused_by_its_name(tmp_path: Path, name: str, content: bytes) -> None:
    if name.endswith(".ulg"):
        pytest.importorskip("pyulog", reason="PX4's logs need pyulog")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=name):
        read(tmp_path / name)


def test_a_log_that_is_cut_off_is_read_so_far(tmp_path: Path) -> None:
    write_dataflash(tmp_path / "cut.bin", autopilot())
    whole = (tmp_path / "cut.bin").read_bytes()
    (tmp_path / "cut.bin").write_bytes(whole[: len(whole) * 2 // 3])
    assert 15 < len(read(tmp_path / "cut.bin").nav.t_ns) < 25


def test_without_pyulog_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(MissingExtraError, match=r"alight\[logs\]"):
        read_log(tmp_path / "flight.ulg")
