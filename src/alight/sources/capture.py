"""Live cameras: one, or several matched by stamp, through OpenCV (V4L2, RTSP, GStreamer where it has them)."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2

from alight.arrays import U8
from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder

SILENT = 10.0  # s without an image after which the cameras are over
DRIFT = 1e-4  # s of arrival a second by which the smallest delay may grow: clocks drift


@dataclass
class StampedImage:
    """One image of a camera."""

    t_ns: int
    image: U8


class SensorClock:
    """Converts a camera's own time to the clock of this machine, by the smallest delay so far.

    A driver's stamps have an unknown zero, but are regular. Arrivals are on this machine's clock, but have a varying
    delay. The stamp of a frame is its own time plus the smallest difference of both so far.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._last = 0.0

    def stamp(self, own: float, arrival: float) -> int:
        """Return an image's time on this machine's clock, ns, from its own time and its arrival, both in s."""
        if own <= 0 or (self._offset is not None and own < self._last):  # the driver gives no time, or began again
            self._offset, self._last = None, own
            return round(arrival * 1e9)
        offset = arrival - own
        grown = offset if self._offset is None else self._offset + DRIFT * max(own - self._last, 0.0)
        self._offset, self._last = min(offset, grown), own
        return round((own + self._offset) * 1e9)


class CameraThread:
    """Reads one camera on a thread of its own, and keeps its newest images.

    Raises:
        InputError: it cannot be opened.
    """

    def __init__(self, name: str, size: tuple[int, int], put: Callable[[StampedImage | None], None]) -> None:
        self._size, self._put = size, put
        self._film = name.startswith("video:")  # has a time of its own, and would come as fast as it can be read
        self._clock, self.ended = SensorClock(), threading.Event()
        self._capture = open_capture(name, size)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        begin = time.monotonic()
        while not self.ended.is_set():
            good, image = self._capture.read()
            if not good:
                break
            arrival, own = time.monotonic(), self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
            if image.ndim == 3:
                image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            if self._film:
                time.sleep(max(0.0, begin + own - arrival))
            if (image.shape[1], image.shape[0]) == self._size:
                t_ns = round(own * 1e9) if self._film else self._clock.stamp(own, arrival)
                self._put(StampedImage(t_ns, image))
        self._capture.release()
        self._put(None)


def open_capture(name: str, size: tuple[int, int]) -> Any:
    """Open a camera by its name: `camera:0`, `camera:/dev/video2`, `rtsp://...`, `gst:PIPELINE`, `video:FILE`.

    Raises:
        InputError: it cannot be opened, or its pictures have another size.
    """
    kind, _, rest = name.partition(":")
    if kind == "camera":
        capture = cv2.VideoCapture(int(rest) if rest.isdigit() else rest)
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest image, not the oldest
    elif kind == "gst":
        capture = cv2.VideoCapture(rest, cv2.CAP_GSTREAMER)
    else:
        capture = cv2.VideoCapture(rest if kind == "video" else name)
    if not capture.isOpened():
        raise InputError(
            f"{name}: cannot be opened; check the cable, the name and the permissions, or close what uses it"
        )
    width, height = (round(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if (width, height) != size:
        raise InputError(
            f"{name}: gives {width}x{height}, its calibration is for {size[0]}x{size[1]}; calibrate at this size"
        )
    return capture


class Cameras(CalibratedFolder):
    """Live cameras, with the calibration of a folder in the layout of a flight log.

    Args:
        names: one a camera of the rig, in its order.
        rig: the folder with `cam0/sensor.yaml` and so on.

    Raises:
        InputError: a camera cannot be opened, or the calibration does not fit.
    """

    def __init__(self, names: Sequence[str], rig: Path, settings: Settings) -> None:
        super().__init__(rig, settings)
        if len(names) != len(self.rig.cameras):
            raise InputError(
                f"{len(names)} camera(s) named, but {rig} has the calibration of {len(self.rig.cameras)}; name as many"
            )
        self.name = ",".join(names)
        self._names = names
        self._note(False, False)

    def events(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Yield an exposure as soon as all cameras have it."""
        waiting: queue.Queue[tuple[int, StampedImage | None]] = queue.Queue(64)

        def put(k: int, image: StampedImage | None) -> None:
            try:
                waiting.put_nowait((k, image))
            except queue.Full:
                self.findings.lose("images", str(image.t_ns if image else 0), "they came faster than they were used")

        threads = [
            CameraThread(name, (c.camera.width, c.camera.height), partial(put, k))
            for k, (name, c) in enumerate(zip(self._names, self.rig.cameras, strict=True))
        ]
        matcher, over = ExposureMatcher(len(threads)), 0
        try:
            while not stopped():
                try:
                    k, image = waiting.get(timeout=SILENT)
                except queue.Empty:
                    self.findings.warn(f"no image for {SILENT:.0f} s: the cameras are taken to be off")
                    return
                if image is None:
                    over += 1
                    if over == len(threads):
                        return
                    continue
                for frame in matcher.take(k, image):
                    self.length += 1
                    yield frame
        finally:
            for t in threads:
                t.ended.set()


class ExposureMatcher:
    """Groups the images of several cameras by their stamps, those that are nearer than half a frame period.

    An image without partner is an exposure of its own if it is the first camera's, and is dropped otherwise.
    """

    def __init__(self, cameras: int) -> None:
        self._images: list[deque[StampedImage]] = [deque() for _ in range(cameras)]
        self._period = 1.0 / 30.0  # s, of the first camera
        self._last = 0

    def take(self, camera: int, image: StampedImage) -> list[Frame]:
        """Take an image; return the exposures that it completes."""
        self._images[camera].append(image)
        if camera == 0:
            step = 1e-9 * (image.t_ns - self._last)
            if self._last and 0 < step < 1.0:
                self._period += 0.1 * (step - self._period)
            self._last = image.t_ns
        out = []
        while self._images[0] and (frame := self._first()) is not None:
            out.append(frame)
        return out

    def _first(self) -> Frame | None:
        """The oldest exposure; None while a partner may still come: four images of the first camera wait at most."""
        left, near = self._images[0][0], self._period * 0.5 * 1e9
        partners: list[StampedImage | None] = []
        for others in self._images[1:]:
            while others and others[0].t_ns < left.t_ns - near:
                others.popleft()
            if not others and len(self._images[0]) < 4:
                return None
            partners.append(others[0] if others and others[0].t_ns <= left.t_ns + near else None)
        for others, partner in zip(self._images[1:], partners, strict=True):
            if partner is not None:
                others.popleft()
        self._images[0].popleft()
        return Frame(left.t_ns, (left.image, *(None if p is None else p.image for p in partners)))
