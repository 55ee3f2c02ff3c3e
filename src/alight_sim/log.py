"""A simulated flight as a folder in the format of formats/flight-log.md, with its truth."""

from __future__ import annotations

import errno
import math
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import rasterio
import yaml
from numpy.typing import NDArray
from rasterio.windows import Window

from alight.geometry import Pose, quaternion_from_matrix
from alight.geometry.geodesy import MEAN_RADIUS
from alight.records import Frame, ImuSample, NavSample, OutputError, Pixels, Rig, RigCamera, Terrain
from alight_sim.flight import SimulatedFlight
from alight_sim.spans import HEADER
from alight_sim.truth import BAND

JPEG_QUALITY = 90  # of small cameras
LEAST_BYTES = {"jpg": 0.1, "png": 0.5}  # least bytes per pixel on the disk: plain ground in haze
NAV_COLUMNS = (
    "timestamp,latitude,longitude,height,q_w,q_x,q_y,q_z,v_e,v_n,v_u,w_x,w_y,w_z,"
    "sigma_e,sigma_n,sigma_u,sigma_roll,sigma_pitch,sigma_yaw,sigma_ve,sigma_vn,sigma_vu"
)
IMU_COLUMNS = (
    "timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
TRUTH_COLUMNS = (
    "timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [],"
    " v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1],"
    " b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]"
)
SCENE_USED = "scene-used.yaml"  # `alight simulate` with this scene and the same seed makes the same flight
SECTIONS = ("origin", "light", "traffic", "flight", "imaging", "sensors", "faults")
EXPOSURE_COLUMNS = "true time [ns],stamp [ns],arrival [ns]"

Progress = Callable[[int, int], None]  # exposures done, all exposures


def write(
    flight: SimulatedFlight,
    out: Path,
    progress: Progress | None = None,
    *,
    image: Literal["jpg", "png"] = "jpg",
    overwrite: bool = False,
) -> None:
    """Write the flight as a folder, completely or not at all: it is written under a temporary name, then renamed.

    Raises:
        OutputError: the folder is not empty (unless it is a simulated flight and `overwrite` is true), cannot be
            written, or the images alone need more than the free space on the disk.
    """
    _refuse(out, overwrite)
    _refuse_too_large(flight, out, image)
    part = out.with_name(f".{out.name}.tmp")
    try:
        shutil.rmtree(part, ignore_errors=True)
        _write_sensors(flight, part / "mav0")
        _write_streams(flight, part / "mav0", image, progress)
        _write_truth(flight, part / "truth")
        shutil.rmtree(out, ignore_errors=True)
        os.replace(part, out)
    except OSError as e:
        full = e.errno in (errno.ENOSPC, errno.EDQUOT)
        why = "the disk is full; free some space" if full else f"cannot be written ({e.strerror or e}); mend that"
        raise OutputError(f"{out}: {why} or choose another folder with --out") from e
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _refuse(out: Path, overwrite: bool) -> None:
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    simulated = (out / "truth" / "scene.yaml").is_file()
    if not (overwrite and simulated):
        raise OutputError(f"{out}: exists already; choose another folder with --out")


def _refuse_too_large(flight: SimulatedFlight, out: Path, image: str) -> None:
    """Raise OutputError if the pictures of a flight do not fit on the disk of `out`; `image`: `jpg` or `png`."""
    pixels = sum(c.camera.width * c.camera.height for c in flight.rig.cameras)
    needed = LEAST_BYTES[image] * flight.length * pixels
    there = next((p for p in (out, *out.resolve().parents) if p.is_dir()), Path("/"))
    if needed > (free := shutil.disk_usage(there).free):
        raise OutputError(
            f"{out}: {flight.length:,} exposures need {needed / 1e9:,.1f} GB or more, and {free / 1e9:,.1f} GB are "
            "free; shorten flight.duration, lower imaging.rate_hz, choose smaller images or another folder with --out"
        )


# -- calibration


def _dump(path: Path, tree: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=110), encoding="utf-8")


def _transform(pose: Pose) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": [float(v) for v in pose.matrix.ravel()]}


def _camera_yaml(cam: RigCamera, rate_hz: float) -> dict[str, Any]:
    lens = cam.camera
    return {
        "sensor_type": "camera",
        "comment": cam.name,
        "T_BS": _transform(cam.body_from_cam),
        "rate_hz": rate_hz,
        "resolution": [lens.width, lens.height],
        "camera_model": "pinhole",
        "intrinsics": [lens.fu, lens.fv, lens.cu, lens.cv],
        "distortion_model": lens.model,
        "distortion_coefficients": list(lens.distortion),
    }


def write_calibration(rig: Rig, rate_hz: float, root: Path) -> None:
    """Write the calibration of all cameras, and create the folders for their images, in the log's folder `root`."""
    for cam in rig.cameras:
        _dump(root / cam.name / "sensor.yaml", _camera_yaml(cam, rate_hz))
        (root / cam.name / "data").mkdir()


def _write_sensors(flight: SimulatedFlight, root: Path) -> None:
    write_calibration(flight.rig, flight.rate_hz, root)
    local, imu = flight.local, flight.imu
    origin = {"latitude": local.latitude, "longitude": local.longitude, "height": local.height}
    _dump(root / "nav0" / "sensor.yaml", {"sensor_type": "nav", "rate_hz": flight.nav.rate_hz, "origin": origin})
    numbers = {"rate_hz": imu.rate_hz} | imu.densities
    _dump(root / "imu0" / "sensor.yaml", {"sensor_type": "imu", "T_BS": _transform(Pose()), **numbers})
    _dump(
        root / "state_groundtruth_estimate0" / "sensor.yaml",
        {"sensor_type": "visual-inertial", "comment": "simulated truth of the body frame", "T_BS": _transform(Pose())},
    )


# -- streams


def _table(path: Path, header: str, rows: Iterable[str]) -> None:
    path.write_text("\n".join([f"#{header}", *rows]) + "\n", encoding="utf-8")


def _join(t_ns: int, fields: Iterable[str]) -> str:
    return ",".join([str(t_ns), *fields])


def _nav_row(flight: SimulatedFlight, s: NavSample) -> str:
    place = ["", "", ""]
    if s.position_world is not None:
        lat, lon, height = flight.local.to_geodetic(np.asarray(s.position_world))
        place = [f"{float(lat):.10f}", f"{float(lon):.10f}", f"{float(height):.4f}"]
    turn = [f"{v:.9f}" for v in quaternion_from_matrix(np.asarray(s.world_from_body))]
    fields = [*place, *turn]
    for values in (s.velocity_world, s.angular_velocity_body, s.sigma_position, s.sigma_attitude, s.sigma_velocity):
        fields += ["", "", ""] if values is None else [f"{v:.6f}" for v in values]
    return _join(s.t_ns, fields)


def _imu_row(s: ImuSample) -> str:
    return _join(s.t_ns, [f"{v:.9f}" for v in (*s.angular_velocity_body, *s.specific_force_body)])


def _truth_rows(flight: SimulatedFlight) -> Iterable[str]:
    gyro, accel = flight.biases
    times, poses = flight.truth_trajectory
    latest = np.clip(np.searchsorted(flight.imu_times, times), 0, len(gyro) - 1)
    velocities = flight.trajectory.velocity_world(flight.since(times))
    for t, k, pose, velocity in zip(times, latest, poses, velocities, strict=True):
        numbers = [*pose.translation, *pose.quaternion, *velocity, *gyro[k], *accel[k]]
        yield _join(int(t), [f"{v:.10f}" for v in numbers])


def encode_image(image: Pixels, kind: str) -> bytes:
    """Return an RGB image (H, W, 3) encoded as a `jpg` or `png` file."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if kind == "jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 3]
    return bytes(cv2.imencode(f".{kind}", np.ascontiguousarray(np.asarray(image)[..., ::-1]), options)[1])


def _write_streams(flight: SimulatedFlight, root: Path, image: str, progress: Progress | None) -> None:
    nav, imu, done = [], [], 0
    names = file_names(flight)
    for event in flight.events():
        if isinstance(event, NavSample):
            nav.append(_nav_row(flight, event))
        elif isinstance(event, ImuSample):
            imu.append(_imu_row(event))
        else:
            _write_frame(flight, root, event, f"{names[flight.exposures.order[done]]}.{image}")
            done += 1
            if progress is not None:
                progress(done, flight.length)
    _table(root / "nav0" / "data.csv", NAV_COLUMNS, nav)
    _table(root / "imu0" / "data.csv", IMU_COLUMNS, imu)
    rows = [_join(int(t), [f"{name}.{image}"]) for t, name in zip(flight.exposures.stamp_ns, names, strict=True)]
    for cam in flight.rig.cameras:  # a lost picture has a row but no file
        _table(root / cam.name / "data.csv", "timestamp [ns],filename", rows)
    _table(root / "state_groundtruth_estimate0" / "data.csv", TRUTH_COLUMNS, _truth_rows(flight))


def file_names(flight: SimulatedFlight) -> list[str]:
    """Return one name per exposure: its stamp, with a suffix number if the stamp is repeated."""
    stamps = flight.exposures.stamp_ns.tolist()
    first = {t: k for k, t in reversed(list(enumerate(stamps)))}
    return [str(t) if first[t] == k else f"{t}-{k - first[t]}" for k, t in enumerate(stamps)]


def _write_frame(flight: SimulatedFlight, root: Path, frame: Frame, name: str) -> None:
    for cam, picture in zip(flight.rig.cameras, frame.images, strict=True):
        if picture is not None:
            (root / cam.name / "data" / name).write_bytes(encode_image(picture, Path(name).suffix[1:]))


# -- truth


def _write_truth(flight: SimulatedFlight, root: Path) -> None:
    root.mkdir()
    truth, local = flight.truth, flight.local
    east, north = truth.grid.xy()

    def height(rows: slice) -> NDArray[Any]:
        fall = (east[None] ** 2 + north[rows, None] ** 2) / (2 * MEAN_RADIUS)  # fall of the ellipsoid below the plane
        return np.asarray((local.height + truth.height[rows] + fall).astype(np.float32))

    _raster(flight, root / "dem.tif", height, "float32", math.nan)
    _raster(flight, root / "class.tif", lambda rows: truth.label[rows], "uint8", 0)
    if len(truth.spans):
        rows = (",".join(f"{v:.4f}" for v in row) for row in truth.spans.table)
        _table(root / "spans.csv", HEADER, rows)
    columns = EXPOSURE_COLUMNS + "".join(f",{c.name}" for c in flight.rig.cameras)
    _table(root / "exposures.csv", columns, _exposure_rows(flight))
    if flight.repeatable:
        _dump(root / SCENE_USED, flight.scene.model_dump(mode="json"))
    _dump(root / "scene.yaml", scene_yaml(flight))


def _raster(flight: SimulatedFlight, path: Path, rows: Callable[[slice], NDArray[Any]], dtype: str, no: float) -> None:
    """Write a raster of the flight's world, in bands of rows to save memory.

    `rows`: returns the values of a slice of rows. `no`: the value of missing cells.
    """
    grid = flight.truth.grid
    profile = {
        "driver": "GTiff", "height": grid.rows, "width": grid.cols, "count": 1, "dtype": dtype, "nodata": no,
        "crs": flight.local.crs, "transform": rasterio.Affine(*grid.transform),
        "compress": "deflate", "tiled": True, "blockxsize": 256, "blockysize": 256,
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as dataset:
        for start in range(0, grid.rows, BAND):
            count = min(BAND, grid.rows - start)
            dataset.write(rows(slice(start, start + count)), 1, window=Window(0, start, grid.cols, count))


def _exposure_rows(flight: SimulatedFlight) -> Iterable[str]:
    x = flight.exposures
    for k in range(len(x.true_ns)):
        yield _join(int(x.true_ns[k]), [str(x.stamp_ns[k]), str(x.arrival_ns[k]), *(str(int(s)) for s in x.seen[k])])


def scene_yaml(flight: SimulatedFlight) -> dict[str, Any]:
    """Return the content of truth/scene.yaml: the scene, the flight, the faults, and the safe share of the ground."""
    world, truth = flight.world, flight.truth
    share = np.bincount(truth.label.ravel(), minlength=len(Terrain)) / truth.label.size
    return {
        "name": world.name,
        "seed": flight.seed,
        "description": world.description,
        "sun": _sun(flight),
        "duration_s": round(flight.seconds, 3),
        "frames": flight.length,
        "lost": {k: n for k, n in flight.counts.items() if k != "exposures"},
        "seen_m": dict(zip(("west", "south", "east", "north"), (round(v, 3) for v in flight.seen), strict=True)),
        "dem_cell_m": truth.grid.cell,
        "class_fraction": {kind.name.lower(): round(float(share[kind]), 4) for kind in Terrain},
        "safety": _safety(flight),
        **{k: v for k, v in flight.scene.model_dump(mode="json").items() if k in SECTIONS},
        "true_rig": {c.name: _camera_yaml(c, flight.rate_hz) for c in flight.true_rig.cameras},
    }


def _sun(flight: SimulatedFlight) -> dict[str, float]:
    sun = flight.world.sun
    return {
        "azimuth_deg": round(math.degrees(sun.azimuth), 3),
        "elevation_deg": round(math.degrees(sun.elevation), 3),
    }


def _safety(flight: SimulatedFlight) -> dict[str, Any]:
    lander = flight.scene.lander.footprint
    return {
        "lander": {
            "footprint_radius_m": lander.radius,
            "max_slope_deg": round(math.degrees(lander.max_slope), 6),
            "max_roughness_m": lander.max_roughness,
            "classes": [int(k) for k in lander.classes],
            "rule": "every cell centre within the radius: allowed class; least-squares plane of the disc: slope "
            "and largest deviation within the limits",
        },
        "safe_fraction": round(float(flight.truth.safe(lander).mean()), 6),
    }
