"""Tiny recordings, and functions that damage recordings."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image

import alight
from alight.settings import Settings

T0 = 1_700_000_000_000_000_000
STEP = 100_000_000
LATITUDE, LONGITUDE, HEIGHT = 48.1, 15.4, 300.0
SIZE = (64, 48)
UNSMOOTHED = ("--set", "tuning.filter.smooth=false")  # of a run whose reading is tested: most of its time, else
LOOK_DOWN = [0.0, -1.0, 0.0, 0.1, -1.0, 0.0, 0.0, 0.2, 0.0, 0.0, -1.0, -0.05, 0.0, 0.0, 0.0, 1.0]


def picture(seed: int = 0, size: tuple[int, int] = SIZE, grey: bool = False) -> Image.Image:
    """A picture of noise, which JPEG cannot compress to a few bytes."""
    shape = size[::-1] if grey else (*size[::-1], 3)
    return Image.fromarray(np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8))


# -- flight logs


def camera_yaml(**changes: Any) -> dict[str, Any]:
    """A healthy `sensor.yaml` of a camera, with changes; None removes a key."""
    tree = {
        "sensor_type": "camera",
        "T_BS": {"cols": 4, "rows": 4, "data": LOOK_DOWN},
        "rate_hz": 10,
        "resolution": list(SIZE),
        "camera_model": "pinhole",
        "intrinsics": [50.0, 50.5, 31.0, 24.0],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [-0.1, 0.01, 0.0, 0.0],
    } | changes
    return {k: v for k, v in tree.items() if v is not None}


def write_yaml(path: Path, tree: Any, head: str = "") -> None:
    """Write one YAML file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head + yaml.safe_dump(tree))


def write_rows(path: Path, rows: list[list[Any]]) -> None:
    """Write a CSV stream with its header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#header\n" + "".join(",".join(str(v) for v in row) + "\n" for row in rows))


def write_camera(folder: Path, n: int, grey: bool, shift: int = 0) -> None:
    """Write one camera stream of n PNG images."""
    write_yaml(folder / "sensor.yaml", camera_yaml(), head="%YAML:1.0\n")
    (folder / "data").mkdir()
    for k in range(n):
        picture(k, grey=grey).save(folder / "data" / f"{k}.png")
    write_rows(folder / "data.csv", [[T0 + k * STEP + shift, f"{k}.png"] for k in range(n)])


def nav_row(k: int) -> list[Any]:
    """Row k of nav0: level, northwards at 1e-6 degrees a row, nose to the east."""
    sigmas = [1.0, 1.0, 1.5, 0.01, 0.01, 0.03, 0.05, 0.05, 0.05]
    place = [LATITUDE + 1e-6 * k, LONGITUDE, HEIGHT + 30]
    return [T0 + k * STEP // 2, *place, 1, 0, 0, 0, 0.5, 1.0, 0.0, 0.01, 0.02, 0.03, *sigmas]


def write_flight(folder: Path, n: int = 6, cameras: int = 2) -> Path:
    """Write a whole undamaged flight log of n exposures, grey left and colour right."""
    mav = folder / "mav0"
    for c in range(cameras):
        write_camera(mav / f"cam{c}", n, grey=c == 0)
    origin = {"latitude": LATITUDE, "longitude": LONGITUDE, "height": HEIGHT}
    write_yaml(mav / "nav0" / "sensor.yaml", {"sensor_type": "nav", "rate_hz": 20, "origin": origin})
    write_rows(mav / "nav0" / "data.csv", [nav_row(k) for k in range(2 * n)])
    identity = np.eye(4).ravel().tolist()
    noise = {"gyroscope_noise_density": "4e-4", "accelerometer_noise_density": 0.002}
    write_yaml(mav / "imu0" / "sensor.yaml", {"T_BS": {"cols": 4, "rows": 4, "data": identity}, **noise})
    write_rows(mav / "imu0" / "data.csv", [[T0 + k * STEP // 10, 0.1, 0.2, 0.3, 1, 2, 9.8] for k in range(10 * n)])
    truth = [[T0 + k * STEP, k, 0, 30, 1, 0, 0, 0, *[0] * 9] for k in range(n)]
    write_rows(mav / "state_groundtruth_estimate0" / "data.csv", truth)
    return folder


def change_line(path: Path, number: int, text: str) -> None:
    """Replace one line (1 is the first) of a text file."""
    lines = path.read_text().splitlines()
    lines[number - 1] = text
    path.write_text("\n".join(lines) + "\n")


def change_field(path: Path, number: int, column: int, text: str) -> None:
    """Replace one field of one CSV line."""
    fields = path.read_text().splitlines()[number - 1].split(",")
    fields[column] = text
    change_line(path, number, ",".join(fields))


def cut_off(path: Path, share: float = 0.5) -> None:
    """Keep the first part of a file only, as after an interrupted copy."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


def zero_tail(path: Path, share: float = 0.5) -> None:
    """Keep the first part of a file and fill the rest with zeros, as after a loss of power on some file systems."""
    data = path.read_bytes()
    kept = int(len(data) * share)
    path.write_bytes(data[:kept] + bytes(len(data) - kept))


# -- photos

DJI = "http://www.dji.com/drone-dji/1.0/"
PIX4D = "http://pix4d.com/camera/1.0/"
DEWARP = "2022-03-02;60.0,60.0,2.0,-1.0,-0.1,0.01,0.001,0.0005,0.002"


def dji_tags(**changes: str) -> dict[str, str]:
    """Tags of DJI, with changes; an empty value removes a tag."""
    tags = {
        "AbsoluteAltitude": "+350.00",
        "RelativeAltitude": "+45.00",
        "GimbalYawDegree": "+90.00",
        "GimbalPitchDegree": "-90.00",
        "GimbalRollDegree": "+0.00",
        "FlightYawDegree": "+91.00",
        "FlightPitchDegree": "+1.00",
        "FlightRollDegree": "-2.00",
        "CalibratedFocalLength": "58.0",
        "CalibratedOpticalCenterX": "32.0",
        "CalibratedOpticalCenterY": "24.0",
        "RtkFlag": "50",
        "RtkStdLon": "0.02",
        "RtkStdLat": "0.015",
        "RtkStdHgt": "0.03",
        "DewarpData": DEWARP,
    } | changes
    return {k: v for k, v in tags.items() if v}


def xmp_packet(tags: dict[str, str], namespace: str = DJI, elements: bool = False) -> bytes:
    """An XMP packet with the tags as attributes or as elements."""
    attributes = "" if elements else " ".join(f'm:{k}="{v}"' for k, v in tags.items())
    inside = "".join(f"<m:{k}>{v}</m:{k}>" for k, v in tags.items()) if elements else ""
    rdf = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        f'<rdf:RDF xmlns:rdf="{rdf}"><rdf:Description rdf:about="" xmlns:m="{namespace}" {attributes}>{inside}'
        '</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def _dms(degrees: float) -> tuple[float, float, float]:
    whole = int(degrees)
    minutes = int((degrees - whole) * 60)
    return float(whole), float(minutes), round((degrees - whole) * 3600 - minutes * 60, 6)


def write_photo(
    path: Path,
    seed: int | None = None,
    *,
    second: str | None = "10",
    subsecond: str = "",
    place: tuple[float, float, float] | None = (45.0, 7.6, 350.0),
    xmp: bytes | None = None,
    size: tuple[int, int] = SIZE,
    exif_size: tuple[int, int] | None = None,
    model: str = "FC1",
    main: dict[int, Any] | None = None,
    photo: dict[int, Any] | None = None,
    gps: dict[int, Any] | None = None,
    image: Image.Image | None = None,
) -> Path:
    """Write one JPEG with EXIF (extra `main`, `photo` and `gps` tags by number) and XMP; of noise, or an `image`.

    A `gps` tag of None is left out. Without a seed, each file name has its own picture.
    """
    exif = Image.Exif()
    for tag, value in ({271: "DJI", 272: model, 274: 1} | (main or {})).items():
        exif[tag] = value
    taken = {36867: f"2026:01:26 13:50:{second}"} if second is not None else {}
    width, height = exif_size or size
    details = taken | ({37521: subsecond} if subsecond else {}) | {40962: width, 40963: height} | (photo or {})
    exif.get_ifd(0x8769).update(details)
    if place is not None:
        latitude, longitude, altitude = place
        where = {1: "NS"[latitude < 0], 2: _dms(abs(latitude)), 3: "EW"[longitude < 0], 4: _dms(abs(longitude))}
        where |= {5: b"\x00", 6: altitude} | (gps or {})
        exif.get_ifd(0x8825).update({k: v for k, v in where.items() if v is not None})
    path.parent.mkdir(parents=True, exist_ok=True)
    quality = {} if image is None else {"quality": 95}
    (image or picture(zlib.crc32(path.name.encode()) if seed is None else seed, size)).save(
        path, "JPEG", **quality, exif=exif, xmp=xmp_packet(dji_tags()) if xmp is None else xmp
    )
    return path


def write_photos(folder: Path, n: int = 4, seed: int = 0) -> Path:
    """Write an undamaged folder of n photos, 3 s and about 3 m apart."""
    for k in range(n):
        write_photo(folder / f"DJI_{k:04d}.JPG", seed + k, second=f"{10 + 3 * k}", place=(45.0 + 3e-5 * k, 7.6, 350.0))
    return folder


# -- campaigns


def campaign_line(landing: int) -> dict[str, Any]:
    """A landing that was given up, as a line of landings.jsonl."""
    conditions = {"landing": landing, "seed": 0, "scene": "lake", "world_seed": 1, "flight_seed": 2, "heading": 0.1,
                  "wind": [1, 2], "gusts": 0.1, "gps_sigma": [1, 1, 2], "gps_tau": 30}  # fmt: skip
    look = {"t": 1.5, "place": [0, 0, 0], "height": 15, "verdict": "candidate", "p_safe": 0.6, "doubt": "relief"}
    step = {"t": 2.0, "before": "search", "event": "found", "after": "approach", "reason": "found", "p_safe": 0.6}
    return {
        "conditions": conditions, "outcome": "rightly refused", "why": "no site", "state": "return",
        "looks": [look], "transitions": [step], "p_found": 0.6, "seconds": 60.0, "safe_share": 0.1,
    }  # fmt: skip


def write_campaign(folder: Path, landings: int = 3) -> Path:
    """Write the folder of a campaign whose landings are all flown."""
    head = {"alight": alight.__version__, "seed": 0, "scenes": ["lake"], "landings": landings}
    folder.mkdir(parents=True)
    tree = head | {"settings": Settings().model_dump(mode="json")}
    (folder / "campaign.json").write_text(json.dumps(tree), encoding="utf-8")
    lines = [json.dumps(campaign_line(k)) + "\n" for k in range(landings)]
    (folder / "landings.jsonl").write_text("".join(lines), encoding="utf-8")
    return folder
