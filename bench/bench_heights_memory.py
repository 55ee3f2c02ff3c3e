"""Memory of an endless flight: memory of the process after ten minutes over that after one.

    python bench/bench_heights_memory.py              # ten minutes of flight, some five of CPU
    python bench/bench_heights_memory.py --minutes 3

Frames, GPS/INS rows and IMU samples of a straight flight go through the whole pipeline: tracks, filter, ring, map. The
ground is a painted plane, because frames have to be cheap; memory does not depend on objects on the ground.
`forgotten`: the map ends where the vehicle cannot see; `spilled`: all of it stays, on the disk.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from heights_table import Row, head, kept

from alight.arrays import U8
from alight.elevation import NullStore, TileStore
from alight.geometry import Camera, Pose
from alight.outputs import FileStore
from alight.pipeline import Pipeline
from alight.records import Event, Frame, ImuSample, NavSample, Rig, RigCamera
from alight.settings import Settings

UP, SPEED = 40.0, 4.0  # metres, m/s: 0.8 m between exposures, 2 % of the height
RATE, NAV_RATE, IMU_RATE = 5, 10, 100  # Hz
LENS = Camera(640, 480, 480.0, 480.0, 319.5, 239.5)
DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # the picture's top is ahead
K = np.array([[LENS.fu, 0.0, LENS.cu], [0.0, LENS.fv, LENS.cv], [0.0, 0.0, 1.0]])
RIG = Rig((RigCamera("cam0", LENS, Pose(DOWN, np.zeros(3))),))
PAINT, SIDE = 0.06, 2048  # metres a texel; the plane repeats itself after 123 m
GRAVITY = np.array([0.0, 0.0, 9.80665])  # specific force measured at rest
LIBC = ctypes.CDLL(None)
EVERY = 10  # s between two measurements of the memory
WAYS = ("forgotten", "spilled")


def painted() -> U8:
    """A periodic texture with detail from a texel to some metres."""
    rng = np.random.default_rng(0)
    out = np.full((SIDE, SIDE), 128.0, np.float32)
    for k in range(6):
        rough = np.tile(rng.normal(0, 1, (SIDE >> k, SIDE >> k)).astype(np.float32), (2, 2))
        smooth = cv2.resize(cv2.GaussianBlur(rough, (0, 0), 0.8), (2 * SIDE, 2 * SIDE), interpolation=cv2.INTER_LINEAR)
        half = SIDE // 2
        smooth = smooth[half : half + SIDE, half : half + SIDE]
        out += 14.0 * smooth / smooth.std()
    grey = np.clip(out, 0, 255).astype(np.uint8)
    return np.stack([grey, grey, (0.8 * grey).astype(np.uint8)], axis=-1)


def place(t: float) -> np.ndarray:
    """Position (3,) of the vehicle at a time, metres."""
    return np.array([SPEED * t, 1.5 * np.sin(0.4 * t), UP + 0.8 * np.sin(0.25 * t)])


def picture(paint: U8, t: float, rng: np.random.Generator) -> U8:
    """Picture of the camera at a time: one homography."""
    cam_from_world = (Pose(np.eye(3), place(t)) @ RIG.cameras[0].body_from_cam).inverse
    P = K @ np.column_stack([cam_from_world.rotation, cam_from_world.translation])
    period, shift = PAINT * SIDE, np.floor(SPEED * t / (PAINT * SIDE)) * PAINT * SIDE
    texel = np.array([[PAINT, 0.0, shift], [0.0, PAINT, 0.5 * period], [0.0, 0.0, 1.0]])
    seen = cv2.warpPerspective(
        paint, P[:, [0, 1, 3]] @ texel, (640, 480), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    noise = rng.integers(-2, 3, seen.shape[:2], dtype=np.int16)[..., None]
    return np.clip(seen + noise, 0, 255).astype(np.uint8)


def events(seconds: float) -> Iterator[Event]:
    """Events of the flight, in order of time."""
    paint, rng = painted(), np.random.default_rng(1)
    h = 1e-3
    for k in range(int(seconds * IMU_RATE)):
        t, t_ns = k / IMU_RATE, k * 1_000_000_000 // IMU_RATE
        acceleration = (place(t + h) - 2 * place(t) + place(t - h)) / h**2
        yield ImuSample(t_ns, rng.normal(0, 5e-4, 3), acceleration + GRAVITY + rng.normal(0, 0.02, 3))
        if k % (IMU_RATE // NAV_RATE) == 0:
            velocity = (place(t + h) - place(t - h)) / (2 * h)
            where, fast = place(t) + rng.normal(0, 0.03, 3), velocity + rng.normal(0, 0.02, 3)
            sigma = np.full(3, 0.05), np.full(3, 0.003), np.full(3, 0.03)
            yield NavSample(t_ns, where, np.eye(3), fast, None, *sigma)
        if k % (IMU_RATE // RATE) == 0:
            yield Frame(t_ns, (picture(paint, t, rng),))


def resident() -> float:
    """MB that the process holds now, without free memory that the allocator keeps for later."""
    gc.collect()
    LIBC.malloc_trim(0)
    return float(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def fly(way: str, minutes: float) -> list[float]:
    """MB after every `EVERY` seconds of flight."""
    out = []
    settings = Settings.model_validate({"parallax": {"method": "ring"}})
    with tempfile.TemporaryDirectory() as folder:
        far: TileStore = NullStore() if way == "forgotten" else FileStore(Path(folder))
        pipeline = Pipeline(RIG, "flight", settings, far=far, history=False)
        for event in events(60.0 * minutes + 0.1):
            pipeline.feed(event)
            if event.t_ns and event.t_ns % (EVERY * 1_000_000_000) == 0 and isinstance(event, Frame):
                out.append(resident())
    return out


def measured(way: str, minutes: float) -> list[float]:
    """`fly` in a process of its own, which held no other memory before."""
    command = [sys.executable, __file__, "--child", way, "--minutes", str(minutes)]
    return [float(v) for v in json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)]


def rows(minutes: float = 10.0) -> list[Row]:
    """Memory at the end over memory after a minute, each the mean of three measurements."""
    out = []
    for way in WAYS:
        held = kept(f"memory {way} {minutes:g}", lambda way=way: measured(way, minutes))  # type: ignore[misc]
        at = 60 // EVERY
        ratio = float(np.mean(held[-3:]) / np.mean(held[at - 1 : at + 2]))
        out.append(Row(f"memory after {minutes:g} minutes of flight over that after one, {way}", ratio, (0.95, 1.05)))
    return out


def main() -> None:
    """Print the rows, and the numbers behind them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--child", choices=WAYS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(fly(options.child, options.minutes)))
        return
    print(head("memory"))
    for row in rows(options.minutes):
        print(row.line(), flush=True)


if __name__ == "__main__":
    main()
