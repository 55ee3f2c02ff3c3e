"""Live cameras, one or several matched by stamp, through OpenCV (V4L2, RTSP and, if available, GStreamer)."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2

from alight.arrays import U8
from alight.records import Event, Frame, InputError
from alight.settings import Settings
from alight.sources.calibrated_folder import CalibratedFolder
from alight.sources.growing import WaitingExposures

SILENT = 10.0  # s without an image after which the cameras are assumed to be off
DRIFT = 1e-4  # s per s by which the smallest delay may grow, because clocks drift
StampedImage = tuple[int, U8]  # ns, and the image


class SensorClock:
    """Converts a camera's own time to this machine's clock by the smallest delay so far.

    A driver's stamps are regular but have an unknown zero. Arrival times are on this machine's clock but have a varying
    delay. A frame is stamped with its own time plus the smallest difference so far between arrival and own time.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._last = 0.0

    def stamp(self, own: float, arrival: float) -> int:
        """Return an image's time on this machine's clock in ns, from its own time and its arrival, both in s."""
        if own <= 0 or (self._offset is not None and own < self._last):  # the driver gives no time, or restarted
            self._offset, self._last = None, own
            return round(arrival * 1e9)
        offset = arrival - own
        grown = offset if self._offset is None else self._offset + DRIFT * max(own - self._last, 0.0)
        self._offset, self._last = min(offset, grown), own
        return round((own + self._offset) * 1e9)


def open_capture(name: str, size: tuple[int, int]) -> Any:
    """Open a camera by its name: `camera:0`, `camera:/dev/video2`, `rtsp://...`, `gst:PIPELINE`, `video:FILE`.

    Raises:
        InputError: the camera cannot be opened, or its images are not of `size` (width, height).
    """
    kind, _, rest = name.partition(":")
    if kind == "camera":
        capture = cv2.VideoCapture(int(rest) if rest.isdigit() else rest)
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # deliver the newest image, not the oldest
    elif kind == "gst":
        capture = cv2.VideoCapture(rest, cv2.CAP_GSTREAMER)
    elif kind == "rtsp":  # a camera that loses its power closes no connection; OpenCV would wait for it for 30 s
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1e3 * SILENT), cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(250 * SILENT)]
        limits += [cv2.CAP_PROP_N_THREADS, 1]  # each thread more delays every image by one
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, limits)
    else:
        capture = cv2.VideoCapture(rest)
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


def skip_backlog(capture: Any) -> None:
    """Skip the images that queued up while a stream was opened (2.5 s of GStreamer's): they arrived at unknown times.

    An image was waited for if it came at no more than twice the pace of its own time. The first two have the same time.
    """
    number, arrival, own = 0, 0.0, 0.0
    while capture.grab():
        number, before, own_before = number + 1, arrival, own
        arrival, own = time.monotonic(), capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
        if number > 2 and arrival - before >= (own - own_before) / 2:
            return


class Cameras(CalibratedFolder):
    """Live cameras, with the calibration of a folder in the layout of a flight log.

    Args:
        names: one name per camera of the rig, in its order.
        rig: folder with `cam0/sensor.yaml` and so on.

    Raises:
        InputError: the calibration is for another number of cameras, or is invalid.
    """

    def __init__(self, names: Sequence[str], rig: Path, settings: Settings) -> None:
        super().__init__(rig, settings)
        if len(names) != len(self.rig.cameras):
            raise InputError(
                f"{len(names)} camera(s) named, but {rig} has the calibration of {len(self.rig.cameras)}; name as many"
            )
        if any(self._ahead_ns):
            self.findings.warn(
                "timeshift_cam_imu is not used: live cameras are stamped by the clock of this machine; set "
                "motion.filter.time_offset where they are late"
            )
        self.name = ",".join(names)
        self._names = names
        self._note(False, False)

    def events(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Yield an exposure as soon as all cameras have delivered it, until `stopped()` is True or the cameras end.

        Raises:
            InputError: a camera cannot be opened.
        """
        arrived: queue.Queue[tuple[int, StampedImage | None]] = queue.Queue(64)
        over, open_cameras = threading.Event(), len(self._names)
        sizes = [(c.camera.width, c.camera.height) for c in self.rig.cameras]

        def put(k: int, image: StampedImage | None) -> None:
            try:
                arrived.put_nowait((k, image))
            except queue.Full:
                self.findings.lose("images", str(image[0] if image else 0), "they came faster than they were used")

        def read(k: int, capture: Any) -> None:
            clock, begin = SensorClock(), time.monotonic()
            own_time = self._names[k].startswith("video:")  # a film is paced and stamped by its own time
            is_stream = self._names[k].startswith("rtsp:")
            if is_stream:
                skip_backlog(capture)
            while not over.is_set():
                good, image = capture.read()
                if not good:
                    capture.release()
                    if not is_stream or (again := self._reopened(k, over)) is None:
                        break
                    clock, capture = SensorClock(), again
                    skip_backlog(capture)
                    continue
                arrival, own = time.monotonic(), capture.get(cv2.CAP_PROP_POS_MSEC) * 1e-3
                if image.ndim == 3:
                    image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
                if own_time:
                    time.sleep(max(0.0, begin + own - arrival))
                if (image.shape[1], image.shape[0]) == sizes[k]:
                    put(k, (round(own * 1e9) if own_time else clock.stamp(own, arrival), image))
            capture.release()
            put(k, None)

        captures = [open_capture(name, size) for name, size in zip(self._names, sizes, strict=True)]
        for number in enumerate(captures):
            threading.Thread(target=read, args=number, daemon=True).start()
        waiting = WaitingExposures[U8](len(sizes))
        try:
            while not stopped():
                try:
                    k, image = arrived.get(timeout=SILENT)
                except queue.Empty:
                    self.findings.warn(f"no image for {SILENT:.0f} s: the cameras are taken to be off")
                    return
                if image is None:
                    open_cameras -= 1
                else:
                    waiting.add(k, *image, time.monotonic())
                for t_ns, images, _ in waiting.ready(time.monotonic() if open_cameras else math.inf):
                    if images[0] is not None:  # only exposures of the first camera are used
                        self.length += 1
                        yield Frame(t_ns, tuple(images))
                if not open_cameras:
                    return
        finally:
            over.set()

    def _reopened(self, k: int, over: threading.Event) -> Any:
        """Open a stream again that broke off, as when its server restarts; None: it does not come back."""
        name, lens, begin = self._names[k], self.rig.cameras[k].camera, time.monotonic()
        while not over.wait(SILENT / 20) and time.monotonic() - begin < SILENT:
            with suppress(InputError):
                capture = open_capture(name, (lens.width, lens.height))
                self.findings.warn(f"{name}: broke off and was opened again; motion and map have a gap there")
                return capture
        return None
