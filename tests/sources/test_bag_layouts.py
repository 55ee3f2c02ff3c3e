"""The topics chosen from the layouts of public projects, drawn small: one message or two a topic."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_bags import Drawn, header, image, transform, vector, write_bag

from alight.records import InputError
from alight.sources.bags.choice import ROLES, choose_topics
from alight.sources.bags.streams import read_streams
from alight.sources.source import Findings

T0 = 1_700_000_000_000_000_000
DOWN, AHEAD = (0.0, 1.0, 0.0, 0.0), (0.5, -0.5, 0.5, -0.5)  # w, x, y, z of base_link_from_camera
SPIN = [{"orientation": vector((np.cos(a), 0, 0, np.sin(a)), "wxyz")} for a in (0.0, 0.1, 0.2)]
UNTURNED = {"orientation_covariance": [-1.0, *[0.0] * 8]}
MAVROS = [
    "mavros/imu/data imu 50 base_link", "mavros/imu/data_raw rawimu 50 base_link",
    "mavros/global_position/global fix 10",
    "mavros/global_position/raw/fix fix 5", "mavros/global_position/raw/gps_vel twist 5 base_link",
    "mavros/global_position/local odom 10 map", "mavros/local_position/pose pose 30 map",
    "mavros/local_position/odom odom 30 map", "mavros/local_position/velocity_local twist 30 map",
    "mavros/local_position/velocity_body twist 30 base_link", "mavros/setpoint_position/local pose 20 map",
]  # fmt: skip
OF_MAVROS = {"position": "mavros/global_position/global", "attitude": "mavros/imu/data",
             "velocity": "mavros/local_position/velocity_local", "imu": "mavros/imu/data_raw"}  # fmt: skip
PX4 = ["fmu/out/vehicle_global_position px4place 10", "fmu/out/vehicle_attitude px4attitude 50",
       "fmu/out/vehicle_local_position px4velocity 50", "fmu/out/sensor_combined px4imu 100"]  # fmt: skip
OF_PX4 = dict(zip(("position", "attitude", "velocity", "imu"), (row.split()[0] for row in PX4), strict=True))
LAYOUTS: dict[str, tuple[list[str], dict[str, str] | str]] = {  # topics, and the choice or the role of the question
    "EuRoC": (["cam0/image_raw image 20 cam0", "cam1/image_raw image 20 cam1", "imu0 rawimu 200 imu0"],
              {"left": "cam0/image_raw", "right": "cam1/image_raw", "imu": "imu0"}),
    "TUM VI": (["cam0/image_raw image 20 cam0", "cam1/image_raw image 20 cam1", "imu0 rawimu 200 imu0",
                "vrpn_client/estimated_pose pose 120 world"],
               {"left": "cam0/image_raw", "right": "cam1/image_raw", "imu": "imu0", "position":
                "vrpn_client/estimated_pose", "attitude": "vrpn_client/estimated_pose"}),
    "UZH FPV": (["snappy_cam/stereo_l image 30 l", "snappy_cam/stereo_r image 30 r", "snappy_imu rawimu 500 imu",
                 "groundtruth/pose pose 20 world"],
                {"left": "snappy_cam/stereo_l", "right": "snappy_cam/stereo_r", "imu": "snappy_imu"}),
    "NTU VIRAL": (["left/image_raw image 10 left", "right/image_raw image 10 right", "imu/imu imu 385 imu",
                   "os1_cloud_node1/imu rawimu 100 os1", "os1_cloud_node2/imu rawimu 100 os2",
                   "leica/pose/relative pose 20 leica"],
                  {"left": "left/image_raw", "right": "right/image_raw", "imu": "imu/imu",
                   "position": "leica/pose/relative", "attitude": "leica/pose/relative"}),
    "MAVROS, usb_cam": ([*MAVROS, "usb_cam/image_raw image 30 cam", "usb_cam/image_raw/compressed jpeg 30 cam"],
                        {**OF_MAVROS, "left": "usb_cam/image_raw"}),
    "MAVROS, three views of a RealSense": ([
        *MAVROS, "camera/infra1/image_rect_raw image 30 i1", "camera/infra2/image_rect_raw image 30 i2",
        "camera/color/image_raw image 30 c", "camera/depth/image_rect_raw depth 30 d"], "left"),
    "MAVROS, a RealSense, a camera below": ([
        *MAVROS, "camera/infra1/image_rect_raw image 30 ahead1", "camera/infra2/image_rect_raw image 30 ahead2",
        "nav_cam/image_raw image 20 down1"], {**OF_MAVROS, "left": "nav_cam/image_raw"}),
    "MRS": ([*(f"uav1/{row}" for row in MAVROS), "uav1/bluefox_optflow/image_raw image 60 down1",
             "uav1/rgbd/color/image_raw image 30 ahead1", "uav1/estimation_manager/odom_main odom 100 uav1/utm_origin"],
            {**{k: f"uav1/{v}" for k, v in OF_MAVROS.items()}, "left": "uav1/bluefox_optflow/image_raw"}),
    "PX4, ROS 2": ([*PX4, "camera/image_raw image 30 cam"], {**OF_PX4, "left": "camera/image_raw"}),
    "PX4, VOXL": ([*PX4, "tracking_down image 30 td", "tracking_front image 30 tf", "imu_apps rawimu 1000 imu_apps",
                   "qvio pose 30 odom"], {**OF_PX4, "left": "tracking_down"}),
    "ArduPilot, ROS 2": (["ap/navsat fix 5", "ap/pose/filtered pose 30 base_link",
                          "ap/twist/filtered twist 30 base_link",
                          "ap/imu/experimental/data imu 100 base_link", "camera/image image 10 cam"],
                         {"left": "camera/image", "position": "ap/navsat", "attitude": "ap/imu/experimental/data",
                          "imu": "ap/imu/experimental/data"}),
    "DJI OSDK": (["dji_osdk_ros/gps_position fix 50", "dji_osdk_ros/rtk_position fix 10",
                  "dji_osdk_ros/imu imu 400 body",
                  "dji_osdk_ros/main_camera_images image 30 main"],
                 {"left": "dji_osdk_ros/main_camera_images", "position": "dji_osdk_ros/rtk_position",
                  "attitude": "dji_osdk_ros/imu", "imu": "dji_osdk_ros/imu"}),
    "robot_localization": (["gps/fix fix 5", "gps/filtered fix 30", "imu/data imu 100 imu_link",
                            "odometry/filtered odom 30 odom", "odometry/filtered/global odom 30 map",
                            "camera/image_raw image 15 cam"],
                           {"left": "camera/image_raw", "position": "gps/filtered", "attitude": "imu/data",
                            "velocity": "odometry/filtered/global", "imu": "imu/data"}),
    "NovAtel": (["novatel/oem7/fix fix 10", "novatel/oem7/odom odom 100 map", "novatel/oem7/bestvel twist 10 gps",
                 "novatel/oem7/imu imu 100 imu", "imu/data imu 50 cheap",
                 "flir_left/image_raw image 20 l", "flir_right/image_raw image 20 r"],
                {"left": "flir_left/image_raw", "right": "flir_right/image_raw", "position": "novatel/oem7/fix",
                 "attitude": "novatel/oem7/imu", "velocity": "novatel/oem7/odom", "imu": "novatel/oem7/imu"}),
    "MicroStrain, two receivers": (["ekf/llh_position fix 10", "gnss_1/llh_position fix 5", "gnss_2/llh_position fix 5",
                                    "imu/data rawimu 500 imu", "ekf/imu/data imu 100 imu",
                                    "cam/image_color image 10 c"],
                                   {"left": "cam/image_color", "position": "ekf/llh_position",
                                    "attitude": "ekf/imu/data", "imu": "imu/data"}),
    "two receivers": (["gps1/fix fix 5", "gps2/fix fix 5", "cam/image_raw image 10 c"], "position"),
    "SBG": (["imu/nav_sat_fix fix 5", "imu/data imu 100 imu", "imu/odometry odom 50 map", "imu/velocity twist 50 enu",
             "pylon/image_raw/compressed jpeg 10 c"],
            {"left": "pylon/image_raw/compressed", "position": "imu/nav_sat_fix", "attitude": "imu/data",
             "velocity": "imu/velocity", "imu": "imu/data"}),
    "ZED": (["zed/zed_node/left/image_rect_color image 30 zl", "zed/zed_node/right/image_rect_color image 30 zr",
             "zed/zed_node/depth/depth_registered depth 30 zl", "zed/zed_node/imu/data imu 200 zi", "fix fix 5"],
            {"left": "zed/zed_node/left/image_rect_color", "right": "zed/zed_node/right/image_rect_color",
             "position": "fix", "attitude": "zed/zed_node/imu/data", "imu": "zed/zed_node/imu/data"}),
    "AirSim": (["airsim_node/drone_1/bottom_center/Scene image 20 b", "airsim_node/drone_1/front_left/Scene image 20 f",
                "airsim_node/drone_1/global_gps fix 50", "airsim_node/drone_1/imu/imu imu 100 imu",
                "airsim_node/drone_1/odom_local_ned odom 50 world_ned"],
               {"left": "airsim_node/drone_1/bottom_center/Scene", "position": "airsim_node/drone_1/global_gps",
                "attitude": "airsim_node/drone_1/imu/imu", "imu": "airsim_node/drone_1/imu/imu"}),
    "hector_quadrotor": (["downward_cam/camera/image image 20 d", "front_cam/camera/image image 20 f", "fix fix 4",
                          "raw_imu imu 100 base_link", "ground_truth/state odom 100 map"],
                         {"left": "downward_cam/camera/image", "position": "fix", "attitude": "raw_imu",
                          "imu": "raw_imu"}),
    "KITTI, kitti2bag": (["kitti/camera_gray_left/image_raw image 10 camera_gray_left",
                          "kitti/camera_gray_right/image_raw image 10 camera_gray_right",
                          "kitti/camera_color_left/image_raw image 10 camera_color_left",
                          "kitti/camera_color_right/image_raw image 10 camera_color_right",
                          "kitti/oxts/imu imu 10 imu_link", "kitti/oxts/gps/fix fix 10 imu_link",
                          "kitti/oxts/gps/vel twist 10 imu_link"], "left"),
    "MARS-LVIG": (["left_camera/image/compressed jpeg 10 camera", "livox/imu rawimu 200 livox_frame",
                   "dji_osdk_ros/gps_position fix 50 gps", "dji_osdk_ros/rtk_position fix 5 gps",
                   "dji_osdk_ros/imu imu 400 body_FLU"],
                  {"left": "left_camera/image/compressed", "position": "dji_osdk_ros/rtk_position",
                   "attitude": "dji_osdk_ros/imu", "imu": "dji_osdk_ros/imu"}),
    "Newer College": (["camera/infra1/image_rect_raw image 30 i1", "camera/infra2/image_rect_raw image 30 i2",
                       "camera/imu rawimu 650 ci", "os1_cloud_node/imu rawimu 100 os1"],
                      {"left": "camera/infra1/image_rect_raw", "right": "camera/infra2/image_rect_raw",
                       "imu": "camera/imu"}),
    "Hilti 2022": ([*(f"alphasense/cam{k}/image_raw image 40 cam{k}" for k in range(5)),
                    "alphasense/imu rawimu 400 imu"], "left"),
    "AlphaSense, two cameras": (["alphasense_driver_ros/cam0 image 20 cam0", "alphasense_driver_ros/cam1 image 20 cam1",
                                 "alphasense_driver_ros/imu rawimu 200 imu"],
                                {"left": "alphasense_driver_ros/cam0", "right": "alphasense_driver_ros/cam1",
                                 "imu": "alphasense_driver_ros/imu"}),
    "VIODE": (["cam0/image_raw image 20 cam0", "cam1/image_raw image 20 cam1", "cam0/segmentation image 20 cam0",
               "cam1/segmentation image 20 cam1", "imu0 rawimu 200 imu0", "odometry odom 200 world"],
              {"left": "cam0/image_raw", "right": "cam1/image_raw", "imu": "imu0", "position": "odometry",
               "attitude": "odometry", "velocity": "odometry"}),
    "SNAIL radar": (["zed2i/zed_node/left_raw/image_raw_gray/compressed jpeg 15 zl",
                     "zed2i/zed_node/right_raw/image_raw_gray/compressed jpeg 15 zr",
                     "zed2i/zed_node/imu/data imu 400 zi", "zed2i/zed_node/odom odom 15 odom",
                     "mti3dk/imu imu 100 mti", "x36d/imu_raw rawimu 100 x36d",
                     "x36d/gnss fix 1", "x36d/gnss_ins fix 100"],
                    "attitude"),
    "M2UD": (["camera/color image 10 c", "camera/depth depth 10 c", "RTK/data fix 5", "imu/data imu 200 imu"],
             {"left": "camera/color", "position": "RTK/data", "attitude": "imu/data", "imu": "imu/data"}),
}  # fmt: skip


def fields_of(kind: str, k: int) -> tuple[str, dict[str, Any]]:
    """Type and fields of message k of a kind of topic."""
    spin = SPIN[k]
    place = vector((48.0, 15.0, 300.0), ("latitude", "longitude", "altitude"))
    return {
        "fix": ("sensor_msgs/msg/NavSatFix", place), "imu": ("sensor_msgs/msg/Imu", spin),
        "rawimu": ("sensor_msgs/msg/Imu", UNTURNED), "pose": ("geometry_msgs/msg/PoseStamped", {"pose": spin}),
        "odom": ("nav_msgs/msg/Odometry", {"pose": {"pose": spin}}), "twist": ("geometry_msgs/msg/TwistStamped", {}),
        "px4place": ("px4_msgs/msg/VehicleGlobalPosition", {"lat": 48.0, "alt": 1.0, "alt_ellipsoid": 50.0}),
        "px4attitude": ("px4_msgs/msg/VehicleAttitude", {"q": list(spin["orientation"].values())}),
        "px4velocity": ("px4_msgs/msg/VehicleLocalPosition", {}), "px4imu": ("px4_msgs/msg/SensorCombined", {}),
        "jpeg": ("sensor_msgs/msg/CompressedImage", {"data": list(TINY_PNG)}),
    }[kind]  # fmt: skip


TINY_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010800000000"
    "3a7e9b550000000a49444154789c63600000000200014873a4fa0000000049454e44ae426082"
)


def drawn(rows: list[str]) -> Iterator[Drawn]:
    """Three messages of each topic."""
    for row in rows:
        name, kind, rate, *frame = row.split()
        topic, at = f"/{name}", frame[0] if frame else ""
        if at.startswith(("down", "ahead")):
            yield transform(T0, "base_link", at, DOWN if at.startswith("down") else AHEAD, (0, 0, 0), "/tf_static")
        for k in range(3):
            t = T0 + round(k * 1e9 / float(rate))
            if kind in ("image", "depth"):
                encoding = {"encoding": "16UC1"} if kind == "depth" else {}
                yield image(topic, t, at, np.zeros((2, 3), np.uint8), **encoding)
                continue
            type_name, fields = fields_of(kind, k)
            stamp = {"timestamp": t // 1000} if kind.startswith("px4") else {"header": header(t, at)}
            yield Drawn(topic, type_name, t, stamp | fields)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_topics_of_public_projects(layout: str, tmp_path: Path) -> None:
    rows, want = LAYOUTS[layout]
    bag = write_bag(tmp_path / "flight", "ros1", drawn(rows))
    streams, frames = read_streams([bag], Findings())
    if isinstance(want, str):
        with pytest.raises(InputError, match=rf"which topic is {want}: /.* or /.*\? Name it: --topic {want}=/"):
            choose_topics(streams, frames, {}, ())
        return
    found = choose_topics(streams, frames, {}, ())
    topics = {role: s.topic[1:] for role in ROLES if (s := getattr(found, role)) is not None}
    assert topics == want
