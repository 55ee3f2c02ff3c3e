"""Pictures and lenses of a bag: Image, CompressedImage and CameraInfo."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from typing import Any

import cv2
import numpy as np

from alight.arrays import F64, U8
from alight.geometry import Camera, Pose
from alight.records import InputError
from alight.sources.calibration import MODELS as KALIBR_MODELS
from alight.sources.calibration import why_no_lens
from alight.sources.images import UNREADABLE, decode_image, open_image

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# encoding: bytes of a pixel, conversion to grey or RGB. OpenCV names a Bayer pattern by its second row and column.
ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, None), "8UC1": (1, None), "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB), "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB), "bgra8": (4, cv2.COLOR_BGRA2RGB), "8UC4": (4, cv2.COLOR_BGRA2RGB),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB), "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB), "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY), "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2), "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
}  # fmt: skip
RATIONAL = "rational_polynomial"
MODELS = KALIBR_MODELS | {RATIONAL: RATIONAL, "fisheye": "equidistant"}
WIDEST = 10.0  # largest x / z of a ray in the image: 84 degrees off the axis
MISFIT = 0.5  # px, largest error of a rational lens replaced by a radial-tangential one


def pixels_of(message: Any, size: tuple[int, int]) -> U8:
    """Decode an Image or a CompressedImage, (H, W) grey or (H, W, 3) RGB; `size`: width and height of the camera.

    Raises:
        ValueError: the picture is damaged, of another size, or of an encoding that is not read.
    """
    if not hasattr(message, "encoding"):
        return decode_image(bytes(message.data), size)
    if (message.width, message.height) != size:
        raise ValueError(f"it is {message.width}x{message.height}, the camera {size[0]}x{size[1]}")
    depth, conversion = ENCODINGS.get(message.encoding, (0, None))
    if not depth:
        raise ValueError(f"its encoding is {message.encoding!r}")
    row = size[0] * depth
    if message.step < row or len(message.data) < message.step * size[1]:
        raise ValueError(f"it has {len(message.data)} bytes for {size[1]} rows of {max(message.step, row)}")
    rows = np.asarray(message.data[: message.step * size[1]], np.uint8).reshape(size[1], message.step)[:, :row]
    pixels = rows if depth == 1 else rows.reshape(size[1], size[0], depth)
    converted = pixels if conversion is None else cv2.cvtColor(np.ascontiguousarray(pixels), conversion)
    return np.array(converted, np.uint8)


def header_of_picture(message: Any) -> tuple[tuple[int, int], str]:
    """Return width and height of a picture, and why pictures of its kind cannot be read; empty if they can."""
    if hasattr(message, "encoding"):
        known = message.encoding in ENCODINGS
        return (message.width, message.height), "" if known else f"encoding {message.encoding!r}"
    try:
        with open_image(BytesIO(bytes(message.data)), ("JPEG", "PNG")) as image:
            return image.size, f"format {message.format!r} of 16 bits" if image.mode.startswith("I") else ""
    except UNREADABLE:
        return (0, 0), f"format {message.format!r}"


def _field(info: Any, name: str) -> Any:
    return getattr(info, name, None) if hasattr(info, name) else getattr(info, name.lower())  # ROS 1, ROS 2


def is_calibrated(info: Any) -> bool:
    """Whether a CameraInfo has a focal length; drivers without a calibration send zeros."""
    return bool(_field(info, "K")[0] > 0)


def is_rectified(topic: str) -> bool:
    """Whether the pictures of a topic are rectified, by its last name, as image_proc names them."""
    return "rect" in topic.removesuffix("/compressed").rpartition("/")[2]


def rectified_from_camera(info: Any) -> Pose:
    """Return the rotation from the axes of a camera to those of its rectified pictures."""
    R = np.reshape(_field(info, "R"), (3, 3))
    return Pose(R) if R.any() else Pose()


def lens_of(info: Any, rectified: bool, size: tuple[int, int], where: str, mend: str) -> Camera:
    """Return the lens of images of `size` (width, height) from their CameraInfo.

    Rectified images have the lens of the projection matrix. A rational lens is replaced by the closest
    radial-tangential one. `where` and `mend` are the beginning and the end of error messages.

    Raises:
        InputError: the lens is impossible or its model unknown.
    """
    K = np.reshape(_field(info, "P" if rectified else "K"), (3, -1))[:, :3].tolist()
    D = [] if rectified else np.asarray(_field(info, "D"), float).tolist()
    model = MODELS.get(str(info.distortion_model).lower() if any(D) else "none", "")
    width, height = info.width or size[0], info.height or size[1]
    try:
        rational = model == RATIONAL
        lens = Camera(
            width, height, K[0][0], K[1][1], K[0][2], K[1][2], "none" if rational else model,
            () if rational or model == "none" else tuple(D),
        )  # fmt: skip
        lens = lens if lens.width == size[0] else lens.scaled(size[0] / lens.width)
        lens = _without_rational(lens, np.array(D)) if rational else lens
    except (ValueError, cv2.error) as e:
        raise InputError(f"{where}{info.distortion_model} lens: {' '.join(str(e).split())}; {mend}") from e
    why = why_no_lens(lens)
    if (lens.width, lens.height) != size:
        why = f"it is for {width}x{height}, and the images are {size[0]}x{size[1]}"
    if why is not None:
        raise InputError(f"{where}{why}; {mend}")
    return lens


def _without_rational(lens: Camera, D: F64) -> Camera:
    """Return the radial-tangential lens that fits a rational one best over the image (linear least squares).

    Raises:
        ValueError: none comes close, or the rational one cannot be inverted.
    """
    u, v = np.meshgrid(np.linspace(0, lens.width - 1, 24), np.linspace(0, lens.height - 1, 18))
    x, y = cv2.undistortPoints(np.stack([u, v], axis=-1).reshape(-1, 1, 2), lens.K, D)[:, 0].T
    if not max(np.abs(x).max(), np.abs(y).max()) < WIDEST:
        raise ValueError("its distortion cannot be inverted over the image")
    points = np.stack([x, y, np.ones_like(x)], axis=-1)
    real = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), D)[0][:, 0]
    r2 = x * x + y * y
    columns = np.concatenate([
        np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=-1),
        np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=-1),
    ])  # fmt: skip
    error = np.concatenate([real[:, 0] - x, real[:, 1] - y])
    found = np.linalg.lstsq(columns, error, rcond=None)[0]
    if not (worst := float(np.abs(columns @ found - error).max()) * lens.fu) <= MISFIT:
        raise ValueError(f"no radial-tangential one comes closer than {worst:.2g} pixels")
    return replace(lens, model="radial-tangential", distortion=tuple(found.tolist()))
