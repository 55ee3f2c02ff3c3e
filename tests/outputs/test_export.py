"""Runs and recordings in the formats of other tools, read by independent readers."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rosbags.highlevel import AnyReader
from some_run import GRID, LOCAL, elevation, hazards, some_run, terrain

from alight.cli import call
from alight.geometry import Pose
from alight.outputs import write_run
from alight.outputs.recorder import Recorder
from alight.pipeline import Verdict
from alight.records import Frame, Motion, Telemetry
from alight.records.codec import FlightHead
from alight.records.map_frame import MapFrame
from alight.runner.opening import open_source
from alight.settings import ImuNoise, Settings


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    write_run(some_run(), folder, overwrite=True)
    return folder


def read(path: Path) -> tuple[Counter[str], dict[str, Any]]:
    """Decode every message by rosbags; return their number by topic, and the last of each topic."""
    count, last = Counter[str](), dict[str, Any]()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            count[connection.topic] += 1
            last[connection.topic] = reader.deserialize(data, connection.msgtype)
    return count, last


def cells(message: Any, name: str) -> Iterator[tuple[float, float, float]]:
    """Yield east, north and value of the cells of a layer, as grid_map defines them: from the largest x and y down."""
    info, values = message.info, message.data[message.layers.index(name)]
    columns, rows = (d.size for d in values.layout.dim)
    at = values.data.reshape(columns, rows)
    for j in range(0, columns, 7):
        for i in range(0, rows, 7):
            x = info.pose.position.x + info.length_x / 2 - (i + 0.5) * info.resolution
            y = info.pose.position.y + info.length_y / 2 - (j + 0.5) * info.resolution
            yield x, y, float(at[j, i])


def test_ros2_has_the_map_and_the_sites_where_the_rasters_have_them(out: Path, tmp_path: Path) -> None:
    assert call(["export", str(out), "--ros2", str(tmp_path / "o.mcap"), "--gridmap", str(tmp_path / "g.mcap")]) == 0
    count, last = read(tmp_path / "o.mcap")
    assert count["/motion"] == count["/fix"] == len(some_run().motions)
    assert {"/tf", "/map", "/sites", "/sites/poses", "/route"} <= set(count)
    grid_map = last["/map"]
    assert grid_map.layers == ["elevation", "sigma", "p_safe", "land_cover"]
    with rasterio.open(out / "dem.tif") as dem, rasterio.open(out / "terrain.tif") as cover:
        height, label = dem.read(1), cover.read(1)
        for x, y, value in cells(grid_map, "elevation"):
            row, col = dem.index(x, y)
            np.testing.assert_allclose(value, height[row, col] - LOCAL.height, atol=1e-3)
        for x, y, value in cells(grid_map, "land_cover"):
            assert np.nan_to_num(value) == label[cover.index(x, y)]
    for site, pose in zip(some_run().sites.listed, last["/sites/poses"].poses, strict=True):
        found = pose.position.x, pose.position.y, pose.position.z
        np.testing.assert_allclose(found, site.position_world, atol=1e-3)
    assert next(m.text for m in last["/sites"].markers if m.text) == "site 1: P(safe) 0.970"
    assert len(last["/route"].poses) == 3
    assert [*read(tmp_path / "g.mcap")[0]] == ["/map"]


def test_a_mission_is_read_by_pymavlink(out: Path, tmp_path: Path) -> None:
    mavwp = pytest.importorskip("pymavlink.mavwp", reason="needs the extra `fly`")
    assert call(["export", str(out), "--waypoints", str(tmp_path / "o.waypoints")]) == 0
    loader = mavwp.MAVWPLoader()
    loader.load(str(tmp_path / "o.waypoints"))
    items = [loader.wp(k) for k in range(loader.count())]
    latitude, longitude, height = LOCAL.to_geodetic([5.0, -2.0, 2.12])
    assert [i.command for i in items] == [16, 16, 178, 115, 16, 178, 115, 21]
    for item in (items[0], items[-1]):
        np.testing.assert_allclose((item.x, item.y), (latitude, longitude), atol=1e-7)
    np.testing.assert_allclose([items[0].z, items[1].z, items[-1].z], [height, 29.88, 0.0], atol=1e-2)


def test_kml_has_sites_and_route(out: Path, tmp_path: Path) -> None:
    assert call(["export", str(out), "--kml", str(tmp_path / "o.kml")]) == 0
    places = ET.parse(tmp_path / "o.kml").getroot().iter("{http://www.opengis.net/kml/2.2}Placemark")
    found = {p[0].text: next(p.iter("{http://www.opengis.net/kml/2.2}coordinates")).text for p in places}
    latitude, longitude, _ = LOCAL.to_geodetic([5.0, -2.0, 2.12])
    np.testing.assert_allclose([float(v) for v in (found["site 1"] or "").split(",")], (longitude, latitude))
    assert len((found["route to site 1"] or "").split()) == 3


def test_las_has_a_point_for_each_height(out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    laspy = pytest.importorskip("laspy", reason="needs the extra `las`")
    assert call(["export", str(out), "--las", str(tmp_path / "o.las")]) == 0
    points = laspy.read(tmp_path / "o.las")
    with rasterio.open(out / "dem.tif") as dem:
        height = dem.read(1)
        assert len(points) == np.isfinite(height).sum()
        row, col = dem.index(points.x[99], points.y[99])
        np.testing.assert_allclose(points.z[99], height[row, col], atol=1e-3)


def test_styles_stand_beside_the_rasters(out: Path) -> None:
    assert call(["export", str(out), "--styles"]) == 0
    for name in ("dem", "safe"):
        items = [*ET.parse(out / f"{name}.qml").getroot().iter("item")]
        assert len(items) > 3
    write_run(some_run(), out)  # a style is nobody else's file


def test_what_cannot_be_exported_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--kml", str(tmp_path / "o.kml")]):
        assert call(["export", str(tmp_path), *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_every_topic_of_a_recording_is_decoded_by_rosbags(flight: Path, tmp_path: Path) -> None:
    source = open_source(flight)
    head = FlightHead(source.name, source.rig, source.local, True, ImuNoise(), Settings())
    recorder = Recorder(tmp_path / "recording.mcap", head, map_share=1000.0)
    events = list(source.events())
    for event in events:
        recorder.event(event)
        if isinstance(event, Frame):
            recorder.entry("tracked", event.t_ns)
            recorder.motion(Motion(event.t_ns, Pose(), (), np.eye(6), np.ones(3)))
            recorder.order(event.t_ns, "search", "fly there")
    r, end = some_run(), events[-1].t_ns
    verdict = Verdict(elevation(), terrain(), hazards(), r.sites, MapFrame(0, np.zeros(3), np.eye(3)))
    recorder.verdict(end, verdict)
    recorder.telemetry(end, Telemetry("PX4", mode_name="AUTO"))
    recorder.note("mapping", "slow")
    recorder.decision(r)
    recorder.close()
    count, last = read(tmp_path / "recording.mcap")
    assert not recorder.lost
    assert count["/cam0/image_raw"] == count["/cam1/camera_info"] == count["/motion"] == 6
    assert (count["/map"], count["/sites"], count["/route"], count["/imu"], count["/fix"]) == (2, 2, 1, 60, 12)
    assert last["/map"].info.resolution == GRID.cell
    frame = [e for e in events if isinstance(e, Frame)][-1]
    image = last["/cam1/image_raw"]
    assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == frame.t_ns
    np.testing.assert_array_equal(image.data, np.asarray(frame.images[1]).ravel())
    np.testing.assert_allclose(last["/cam0/camera_info"].k.reshape(3, 3), source.rig.cameras[0].camera.K)
    place = LOCAL if source.local is None else source.local
    np.testing.assert_allclose(
        [last["/fix"].latitude, last["/fix"].longitude], [place.latitude, place.longitude], atol=1
    )
