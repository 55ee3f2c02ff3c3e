"""Choose the topics of a bag by type, frame, name and rate; a choice that is not clear becomes a question."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from alight.records import InputError
from alight.sources.bags.frame_tree import FrameTree
from alight.sources.bags.images import IMAGES
from alight.sources.bags.streams import TopicStream

ROLES = ("left", "right", "position", "attitude", "velocity", "imu")
NOT_MEASURED = re.compile(
    r"setpoint|target|goal|desired|command|cmd|/home|truth|(^|/|_)gt(/|_|$)|waypoint|trajectory|raw/gps_vel"
)
NO_PICTURE = re.compile(
    r"depth|disparity|confidence|mask|overlay|debug|annotat|detect|segment|track_image|feature|match|theora"
)
FUSED = re.compile(r"filter|fused|ekf|rtk|(^|[/_])ins([/_]|$)|global_position/global$|local_position")
DOWN = re.compile(r"down|nadir|bottom|belly")
NORTHED = ("", "map", "enu", "utm", "local_enu", "local_origin")  # frames whose x axis points east; others may turn
ONE_CAMERA = re.compile(r"^image(_raw|_color|_mono|_rect|_rect_color|_rect_raw)?$")  # variants of one picture
SIDE = re.compile(r"left|right|\d+|(?<=[/_])[lr](?=[/_]|$)")
LOWEST = 0.5  # cosine of the largest angle of a downward camera from the vertical: 60 degrees
PARALLEL = 0.94  # cosine of the largest angle between the two cameras of a pair: 20 degrees

NEEDED = {"position": ("place", "local"), "attitude": ("attitude",), "velocity": ("velocity",), "imu": ("force",)}

Rank = Callable[[TopicStream], tuple[Any, ...]]  # the highest is chosen


@dataclass(frozen=True, eq=False)
class Topics:
    """The stream of each role; None: the bag has none."""

    left: TopicStream
    right: TopicStream | None
    position: TopicStream | None
    attitude: TopicStream | None
    velocity: TopicStream | None
    imu: TopicStream | None
    body: str  # name of the frame that the attitude turns

    @property
    def cameras(self) -> list[TopicStream]:
        """The streams of pictures."""
        return [self.left, *([self.right] if self.right else [])]

    def __str__(self) -> str:
        chosen = [(role, getattr(self, role)) for role in ROLES]
        return ", ".join(f"{role}={s.topic} ({s.rate:.3g} Hz, {1e3 * s.age:.0f} ms old)" for role, s in chosen if s)


def choose_topics(
    streams: Mapping[str, TopicStream], frames: FrameTree, given: Mapping[str, str], calibrated: Sequence[str]
) -> Topics:
    """Return the streams of all roles.

    Args:
        streams: streams by topic.
        frames: the frames of the robot.
        given: topics of roles by the user; empty text: none.
        calibrated: topics of the cameras in Kalibr's file, in its order.

    Raises:
        InputError: several topics fit a role equally well, none has pictures, or a given topic is not in the bag.
    """
    if unknown := sorted(given.keys() - set(ROLES)):
        raise InputError(f"--topic {unknown[0]}=...: there is no such role; use {', '.join(ROLES)}")
    measured = [s for s in streams.values() if not NOT_MEASURED.search(s.topic)]
    above = sum(1 for _ in takewhile(lambda parts: len(set(parts)) == 1, zip(*map(_parts, streams), strict=False)))

    def chosen(role: str, fits: Callable[[TopicStream], bool], rank: Rank) -> TopicStream | None:
        if (topic := given.get(role)) is not None:
            return _named(streams, topic, role)
        return _best(role, filter(fits, measured), rank)

    position = chosen(
        "position", lambda s: (s.has("place") and "GeoPoint" not in s.type) or (s.has("local") and s.rate > 1),
        lambda s: (s.has("place"), bool(FUSED.search(s.topic)), "raw" not in s.topic, "Odometry" in s.type),
    )  # fmt: skip
    on_earth = position is not None and position.has("place")

    def near(s: TopicStream) -> bool:  # of the same device, by the first part of the name that not all topics have
        return position is not None and _parts(s.topic)[above : above + 1] == _parts(position.topic)[above : above + 1]

    attitude = chosen(
        "attitude",
        lambda s: s.has_attitude and (s is position or (on_earth and (not s.has("local") or s.frame in NORTHED))),
        lambda s: (near(s), not s.has("local"), "Odometry" in s.type, s.has("sigma_attitude"), "raw" not in s.topic),
    )  # fmt: skip
    velocity = chosen(
        "velocity", lambda s: s.has("velocity") and (s.frame in NORTHED if on_earth else near(s)),
        lambda s: (near(s), s is position, "Twist" in s.type, s.has("sigma_velocity"), bool(FUSED.search(s.topic))),
    )  # fmt: skip
    turned = "" if attitude is None else attitude.child or ("" if attitude.has("local") else attitude.frame)
    body = turned or frames.base or ("base_link" if attitude else "")

    def is_mounted(s: TopicStream) -> bool:
        return not (body and s.frame) or s.frame == body or frames.between(body, s.frame) is not None

    imu = chosen(
        "imu", lambda s: s.has("force") and s.has("rates") and s.rate > 20,
        lambda s: (is_mounted(s), round(np.log2(s.rate)), "raw" in s.topic, near(s)),
    )  # fmt: skip
    body = body or (imu.frame if imu else "") or "base_link"
    left, right = (_named(streams, given[role], role) if role in given else None for role in ROLES[:2])
    if "left" not in given:
        left, second = _cameras(streams, frames, body, calibrated)
        right = right if "right" in given else second
    if left is None:
        refused = sorted(
            (bool(NO_PICTURE.search(s.topic)), f" ({s.topic}: {s.refused})") for s in streams.values() if s.refused
        )
        why = refused[0][1] if refused else ""
        raise InputError(
            f"the bag has no pictures that can be read{why}; record 8 bits a colour, such as mono8 or rgb8"
        )
    return Topics(left, right, position, attitude, velocity, imu, body)


def _parts(topic: str) -> list[str]:
    return topic.strip("/").split("/")[:-1]


def _named(streams: Mapping[str, TopicStream], topic: str, role: str) -> TopicStream | None:
    """Return the stream of the topic that the user names; None: the name is empty."""

    def fits(s: TopicStream) -> bool:
        return any(map(s.has, NEEDED[role])) if role in NEEDED else s.type in IMAGES and not s.refused

    if topic in streams and (why := streams[topic].refused):
        raise InputError(f"--topic {role}={topic}: {why} is not read; record 8 bits a colour, such as mono8 or rgb8")
    if topic and not (topic in streams and fits(streams[topic])):
        known = ", ".join(sorted(s.topic for s in streams.values() if fits(s)))[:400] or "none"
        raise InputError(f"--topic {role}={topic}: no such topic in the bag; topics of the kind: {known}")
    return streams[topic] if topic else None


def _best(role: str, found: Iterable[TopicStream], rank: Rank) -> TopicStream | None:
    """Return the stream with the highest rank; raise a question if several have it."""
    ranked = sorted(found, key=rank, reverse=True)
    if len(ranked) > 1 and rank(ranked[0]) == rank(ranked[1]):
        raise _question(role, [s for s in ranked if rank(s) == rank(ranked[0])])
    return ranked[0] if ranked else None


def _question(role: str, candidates: Sequence[TopicStream]) -> InputError:
    named = sorted(map(str, candidates))
    return InputError(
        f"which topic is {role}: {', '.join(named[:-1])} or {named[-1]}? Name it: --topic {role}={candidates[0].topic}"
    )


def _camera(stream: TopicStream) -> str:
    """Return a name of the camera: the namespace of its pictures, without their variant and transport."""
    space, _, name = re.sub(r"/compressed$", "", stream.topic).rpartition("/")
    return space if ONE_CAMERA.match(name) else f"{space}/{name}"


def _cameras(
    streams: Mapping[str, TopicStream], frames: FrameTree, body: str, calibrated: Sequence[str]
) -> tuple[TopicStream | None, TopicStream | None]:
    """Return the streams of the left and the right camera; None: there is none."""
    if calibrated and all(topic in streams for topic in calibrated):
        return streams[calibrated[0]], streams[calibrated[1]] if len(calibrated) > 1 else None
    usable = [s for s in streams.values() if s.type in IMAGES and not s.refused and not NO_PICTURE.search(s.topic)]
    usable.sort(key=lambda s: ("raw" in s.topic, "rect" not in s.topic, "compressed" not in s.topic))
    cameras = {_camera(s): s for s in usable}  # of each camera the last, which is closest to what its sensor gave
    axes = {n: at.rotation[:, 2] for n, s in cameras.items() if (at := frames.between(body, s.frame)) is not None}
    names = [n for n in cameras if n in axes and -axes[n][2] > LOWEST] or [n for n in cameras if DOWN.search(n)]
    names = sorted(names or cameras)
    if len(names) == 2:
        left, right = (cameras[n] for n in names)
        a, b = (axes.get(n, np.zeros(3)) for n in names)
        same_name = SIDE.sub("*", names[0]) == SIDE.sub("*", names[1])
        fast, slow = max(left.rate, right.rate), min(left.rate, right.rate)
        same_rate = fast - slow < 0.2 * fast or not slow  # 0: a single picture
        parallel = not (a.any() and b.any()) or a @ b > PARALLEL
        if same_name and same_rate and left.size == right.size and parallel:
            return left, right
    if len(names) > 1:
        raise _question("left", [cameras[n] for n in names])
    return (cameras[names[0]] if names else None), None
