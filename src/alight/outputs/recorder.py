"""The recorder of a live run: all events, the schedule and every decision, as messages of ROS 2 in an MCAP file.

A thread writes the messages in small chunks and flushes the file to the disk every half second. So however the run
ends, only its last second may be lost. A disk that is full or too slow costs messages, but never the flight. Lost
messages are counted and reported.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

import numpy as np

from alight.outputs import ros_messages as ros
from alight.outputs.atomic_write import output_error
from alight.outputs.folder import RUN_JSON, is_run
from alight.outputs.ros_file import RosFile
from alight.outputs.ros_messages import RosMessage
from alight.outputs.vectors import plain
from alight.pipeline import Verdict
from alight.records import (
    Decision,
    ElevationMap,
    Event,
    Frame,
    HazardMap,
    ImuSample,
    Motion,
    Telemetry,
    TerrainMap,
)
from alight.records.codec import CAMERAS, FORMAT, HEAD, IMU, LANDING, NAV, NOTES, ORDERS, SCHEDULE, FlightHead
from alight.records.events import Spot
from alight.records.executive import LookRecord, Transition

log = logging.getLogger(__name__)

SYNC = 0.5  # s between two flushes to the disk


def make_room(path: Path) -> Path | None:
    """Make room for a recording: delete a finished run's recording and run.json, and rename any other recording.

    So a run.json never lies next to the recording of a later run that did not finish.

    Returns:
        the new path of the recording that was kept; None: no recording was kept.

    Raises:
        OutputError: the old recording can neither be removed nor renamed.
    """
    try:
        if is_run(path.parent):
            path.unlink(missing_ok=True)
            (path.parent / RUN_JSON).unlink()
            return None
        if not path.exists():
            return None
        free = (path.with_stem(f"{path.stem}-{k}") for k in count(1))
        return path.rename(next(p for p in free if not p.exists()))
    except OSError as e:
        raise output_error(path, e) from e


class Recorder:
    """Writer of one recording.

    Args:
        path: its file.
        head: facts about the flight.
        waiting_mb: most data that may wait for the disk, MB.
        map_share: most bytes of maps, as a share of all bytes, twice as much at the end; a map beyond it is left out.

    Raises:
        OutputError: the file cannot be created.
    """

    def __init__(self, path: Path, head: FlightHead, waiting_mb: float = 256, map_share: float = 0.02) -> None:
        self.path = path
        self.lost: Counter[str] = Counter()  # number of messages by reason
        self._room, self._most = 0, waiting_mb * 1_000_000  # bytes in the queue
        self._waiting = deque[tuple[int, Sequence[RosMessage]]]()  # bytes and messages
        self._changed = threading.Condition()
        self._closed, self._broken = False, ""
        self._local = head.local if head.georeferenced else None
        self._newest_ns = 0  # stamp of the newest exposure
        self._bytes, self._map_bytes, self._map_share = 0, 0, map_share
        try:
            self._file = path.open("wb")
        except OSError as e:
            raise output_error(path, e) from e
        try:
            self._ros = RosFile(self._file)
            self._ros.add_metadata(HEAD, {"format": FORMAT, "head": head.to_json()})
            self._file.flush()
        except OSError as e:
            with suppress(OSError):
                self._file.close()
            raise output_error(path, e) from e
        frames = {f"cam{k}": c for k, c in enumerate(head.rig.cameras)}
        self._infos = [ros.camera_info(frame, camera) for frame, camera in frames.items()]
        self.put(ros.transforms("/tf_static", 0, {(ros.BODY, f): c.body_from_cam for f, c in frames.items()}))
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    # -- called by a live run (`alight.flight.live.Diary`)

    def event(self, event: Event) -> None:
        """Record an event of a sensor, stamped by its own time."""
        if not -(2**31) <= event.t_ns // 10**9 < 2**31:  # s, in a message of ROS 2
            self.lost["their stamps are later than the year 2038"] += 1
        elif isinstance(event, Frame):
            images = [(f"cam{k}", np.asarray(i)) for k, i in enumerate(event.images) if i is not None]
            messages = [ros.image(frame, event.t_ns, image) for frame, image in images]
            seen = [i is not None for i in event.images]
            messages += [ros.at(info, event.t_ns) for info, here in zip(self._infos, seen, strict=False) if here]
            tree = {"t_ns": event.t_ns, "name": event.name, "images": seen}
            self.put(*messages, ros.json_text(CAMERAS, event.t_ns, tree))
            self._newest_ns = event.t_ns
        elif isinstance(event, ImuSample):
            self.put(ros.imu(IMU, event))
        else:
            fixes = [] if self._local is None else ros.gps_fix("/fix", event, self._local)
            self.put(ros.json_text(NAV, event.t_ns, vars(event)), *fixes)

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """Record that a lane used the exposure `t_ns`: `kind` and `value` of its work, and the position it judged."""
        tree = {"kind": kind, "t_ns": t_ns, "value": value, "about": about}
        self.put(ros.json_text(SCHEDULE, t_ns, tree))

    def note(self, lane: str, words: str) -> None:
        """Record a note about a lane, as text."""
        self.put(ros.log_line(NOTES, 0, lane, words))

    def motion(self, motion: Motion) -> None:
        """Record an estimated motion."""
        self.put(*ros.motion_messages(motion))

    def verdict(self, t_ns: int, verdict: Verdict) -> None:
        """Record the sites and candidates of a verdict in the world, and its map if maps have not taken their share."""
        self.put(*ros.sites_messages("/sites", t_ns, verdict.sites))
        self._put_map(t_ns, verdict.elevation, verdict.land_cover, verdict.hazards)

    def decision(self, decision: Decision) -> None:
        """Record the results of the whole flight: sites, route, and the map if maps have not taken their share."""
        t_ns = self._newest_ns
        self.put(*ros.sites_messages("/sites", t_ns, decision.sites))
        if decision.route is not None:
            self.put(ros.route_poses("/route", t_ns, decision.route))
        self._map_share *= 2
        if decision.elevation is not None:
            self._put_map(t_ns, decision.elevation, decision.terrain, decision.hazards)

    def _put_map(
        self, t_ns: int, elevation: ElevationMap, land_cover: TerrainMap | None, hazards: HazardMap | None
    ) -> None:
        size = elevation.height.nbytes * (2 + (land_cover is not None) + (hazards is not None))
        if self._map_bytes + size <= self._map_share * self._bytes:
            self._map_bytes += size
            self.put(ros.grid_map("/map", t_ns, elevation.grid, ros.map_layers(elevation, land_cover, hazards)))

    def telemetry(self, t_ns: int, report: Telemetry) -> None:
        """Record a telemetry report of the autopilot."""
        place, gps = report.place, report.gps
        tree = {
            "armed": report.armed, "landed": report.landed.name,
            "place": None if place is None else [place.latitude, place.longitude, place.altitude_msl, place.above_home],
            "velocity": report.velocity_world.tolist(), "wind": report.wind_world.tolist(),
            "battery": report.battery.share, "voltage": report.battery.voltage, "fix": gps.fix,
            "gps_sigma": [gps.horizontal, gps.vertical, gps.speed], "estimator_flags": report.estimator_flags,
        }  # fmt: skip
        level = 2 if report.failsafe else 0
        self.put(ros.diagnostics("/diagnostics", t_ns, "autopilot", level, report.mode_name, plain(tree)))

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Record an order to the vehicle, as text, with the state of the flight."""
        self.put(ros.log_line(ORDERS, t_ns, state, words))

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Record an entry of the landing's diary: a change of state, or a look at a place."""
        self.put(ros.json_text(LANDING, t_ns, {"line": entry.line.strip(), **entry.as_tree()}))

    @property
    def behind(self) -> float:
        """Queued data that is not yet written, MB."""
        return self._room * 1e-6

    @property
    def warnings(self) -> list[str]:
        """Warning about messages missing from the recording, with the reasons; empty if no message is missing."""
        total = sum(self.lost.values())
        why = ", ".join(f"{n} because {reason}" for reason, n in self.lost.items())
        return [f"recording: {total} messages are missing ({why}); a replay gives other results"] if total else []

    def close(self) -> None:
        """Write the queued messages and close the file; a second call has no effect."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self._changed.notify()
        self._thread.join()
        if not self._broken:
            try:
                self._ros.finish()
                self._file.flush()
            except OSError as e:
                self._break(e)
        with suppress(OSError):
            self._file.close()

    # -- the thread

    def put(self, *messages: RosMessage) -> None:
        """Queue messages for the thread that writes, all or none."""
        size = sum(m.size for m in messages)
        with self._changed:
            if self._broken:
                self.lost[self._broken] += 1
            elif self._room + size > self._most:
                self.lost["the disk is too slow"] += 1
            else:
                self._waiting.append((size, messages))
                self._room += size
                self._bytes += size
                self._changed.notify()

    def _write_all(self) -> None:
        synced = time.monotonic()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed, timeout=SYNC)
                if not self._waiting and self._closed:
                    return
                size, messages = self._waiting.popleft() if self._waiting else (0, ())
                self._room -= size
            if self._broken:
                self.lost[self._broken] += bool(messages)
                continue
            try:
                for message in messages:
                    self._ros.write(message, time.time_ns())
                if time.monotonic() - synced > SYNC:
                    self._file.flush()
                    os.fdatasync(self._file.fileno())
                    synced = time.monotonic()
            except OSError as e:
                self._break(e)

    def _break(self, error: OSError) -> None:
        self._broken = str(output_error(self.path, error)).partition(": ")[2].partition(";")[0]
        self.lost[self._broken] += 1
        log.warning("recording: %s; the flight goes on without it", self._broken)
