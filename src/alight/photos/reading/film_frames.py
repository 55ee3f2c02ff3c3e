"""Frames of a film in order, as stored, with the decoder's time stamps."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np

from alight.arrays import U8


class FilmFrames:
    """An open film. Iteration yields the time of each frame in seconds; `image` decodes the current frame."""

    def __init__(self, path: Path) -> None:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # else the decoder repeats Alight's messages on stderr
        self._film = cv2.VideoCapture(str(path))
        self._film.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        self._rate = self._film.get(cv2.CAP_PROP_FPS) or 30.0
        self.number = -1  # index of the current frame

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._film.release()

    def __iter__(self) -> Iterator[float]:
        before = -1.0
        while self._film.grab():
            self.number += 1
            stamp = 1e-3 * self._film.get(cv2.CAP_PROP_POS_MSEC)
            before = stamp if stamp > before else before + 1.0 / self._rate  # streams without time stamps give zeros
            yield max(before, 0.0)

    def image(self) -> U8 | None:
        """Decode the current frame, (H, W, 3) RGB; None if it is damaged."""
        fine, frame = self._film.retrieve()
        return np.ascontiguousarray(frame[..., ::-1]) if fine else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames in pixels."""
        return int(self._film.get(cv2.CAP_PROP_FRAME_WIDTH)), int(self._film.get(cv2.CAP_PROP_FRAME_HEIGHT))

    @property
    def orientation(self) -> int:
        """EXIF orientation that displays the frames upright; 1: the frames are stored upright."""
        turn = round(self._film.get(cv2.CAP_PROP_ORIENTATION_META) / 90) % 4
        return (1, 6, 3, 8)[turn]

    @property
    def seconds(self) -> float:
        """Length of the film in seconds by its header; 0 if not given."""
        return max(self._film.get(cv2.CAP_PROP_FRAME_COUNT), 0.0) / self._rate
