"""The recorder of a live run: all events, the schedule and every decision, as MCAP.

A thread writes the messages without chunks and flushes the file to the disk every half second. So however the run ends,
only its last second may be lost. A disk that is full or too slow costs messages, but never the flight. Lost messages
are counted and reported.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from alight import __version__
from alight.outputs.atomic_write import output_error
from alight.outputs.folder import RUN_JSON, is_run
from alight.outputs.vectors import plain
from alight.records import Event, Motion, Sites, Telemetry
from alight.records.codec import (
    CAMERAS,
    IMU,
    LANDING,
    MOTION,
    NAV,
    NOTES,
    ORDERS,
    SCHEDULE,
    SITES,
    TELEMETRY,
    FlightHead,
    pack,
)
from alight.records.events import Spot
from alight.records.executive import LookRecord, Transition

log = logging.getLogger(__name__)

HEAD = "alight"  # name of the metadata record
TOPICS = (CAMERAS, NAV, IMU, SCHEDULE, NOTES, MOTION, SITES, TELEMETRY, ORDERS, LANDING)  # all but CAMERAS are JSON
SYNC = 0.5  # s between two flushes to the disk

Message = tuple[str, int, "list[bytes | memoryview]"]  # topic, stamp in ns, parts


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

    Raises:
        OutputError: the file cannot be created.
    """

    def __init__(self, path: Path, head: FlightHead, waiting_mb: float = 256) -> None:
        self.path = path
        self.lost: Counter[str] = Counter()  # number of messages by reason
        self._room, self._most = 0, waiting_mb * 1_000_000  # bytes in the queue
        self._waiting, self._changed = deque[Message](), threading.Condition()
        self._closed, self._broken = False, ""
        try:
            self._file = path.open("wb")
        except OSError as e:
            raise output_error(path, e) from e
        try:
            self._writer = Writer(self._file, use_chunking=False)
            self._writer.start("alight", f"alight {__version__}")
            self._writer.add_metadata(HEAD, {"head": head.to_json()})
            json_form = "json", self._writer.register_schema("alight", "jsonschema", b'{"type": "object"}')
            self._channels = {
                topic: self._writer.register_channel(topic, *(("alight.frame", 0) if topic == CAMERAS else json_form))
                for topic in TOPICS
            }
            self._file.flush()
        except OSError as e:
            with suppress(OSError):
                self._file.close()
            raise output_error(path, e) from e
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    # -- called by a live run (`alight.flight.live.Diary`)

    def event(self, event: Event) -> None:
        """Record an event of a sensor, stamped by its own time."""
        topic, parts = pack(event)
        self.put(topic, event.t_ns, parts)

    def entry(self, kind: str, t_ns: int, value: int = 0, about: Spot | None = None) -> None:
        """Record that a lane used the exposure `t_ns`: `kind` and `value` of its work, and the position it judged."""
        tree = {"kind": kind, "t_ns": t_ns, "value": value, "about": about}
        self._put_json(SCHEDULE, t_ns, tree)

    def note(self, lane: str, words: str) -> None:
        """Record a note about a lane, as text."""
        self._put_json(NOTES, 0, {"lane": lane, "note": words})

    def motion(self, motion: Motion) -> None:
        """Record an estimated motion."""
        body = motion.world_from_body
        tree = {
            "t_ns": motion.t_ns, "position": body.translation.tolist(), "rotation": body.rotation.tolist(),
            "sigma": [float(v) ** 0.5 for v in motion.covariance.diagonal()], "state": motion.state.name,
            "frame_id": motion.frame_id, "tracks": motion.tracks,
        }  # fmt: skip
        self._put_json(MOTION, motion.t_ns, tree)

    def sites(self, t_ns: int, sites: Sites) -> None:
        """Record the sites and candidates of a map."""
        listed = [{"kind": s.kind, "east": s.east, "north": s.north, "up": s.up, "p_safe": s.p_safe}
                  for s in sites.listed]  # fmt: skip
        tree = {"t_ns": t_ns, "frame_id": sites.frame_id, "reason": sites.reason, "listed": listed}
        self._put_json(SITES, t_ns, tree)

    def telemetry(self, t_ns: int, report: Telemetry) -> None:
        """Record a telemetry report of the autopilot."""
        place, gps = report.place, report.gps
        tree = {
            "t_ns": t_ns, "mode": report.mode_name, "armed": report.armed, "landed": report.landed.name,
            "place": None if place is None else [place.latitude, place.longitude, place.altitude_msl, place.above_home],
            "velocity": report.velocity_world.tolist(), "wind": report.wind_world.tolist(),
            "battery": report.battery.share, "voltage": report.battery.voltage, "fix": gps.fix,
            "gps_sigma": [gps.horizontal, gps.vertical, gps.speed], "estimator_flags": report.estimator_flags,
        }  # fmt: skip
        self._put_json(TELEMETRY, t_ns, plain(tree))

    def order(self, t_ns: int, state: str, words: str) -> None:
        """Record an order to the vehicle, as text, with the state of the flight."""
        self._put_json(ORDERS, t_ns, {"t_ns": t_ns, "state": state, "order": words})

    def landing(self, t_ns: int, entry: Transition | LookRecord) -> None:
        """Record an entry of the landing's diary: a change of state, or a look at a place."""
        self._put_json(LANDING, t_ns, {"t_ns": t_ns, **entry.as_tree()})

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
                self._writer.finish()
                self._file.flush()
            except OSError as e:
                self._break(e)
        with suppress(OSError):
            self._file.close()

    def _put_json(self, topic: str, t_ns: int, tree: dict[str, Any]) -> None:
        self.put(topic, t_ns, [json.dumps(tree).encode()])

    # -- the thread

    def put(self, topic: str, t_ns: int, parts: list[bytes | memoryview]) -> None:
        """Queue a message of a topic, as parts of bytes, for the thread that writes."""
        size = sum(len(p) for p in parts)
        with self._changed:
            if self._broken:
                self.lost[self._broken] += 1
            elif self._room + size > self._most:
                self.lost["the disk is too slow"] += 1
            else:
                self._waiting.append((topic, t_ns, parts))
                self._room += size
                self._changed.notify()

    def _write_all(self) -> None:
        synced = time.monotonic()
        number = 0
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed, timeout=SYNC)
                if not self._waiting and self._closed:
                    return
                message = self._waiting.popleft() if self._waiting else None
                self._room -= 0 if message is None else sum(len(p) for p in message[2])
            if self._broken:
                self.lost[self._broken] += message is not None
                continue
            try:
                if message is not None:
                    topic, t_ns, parts = message
                    stamp = min(max(t_ns, 0), 2**63 - 1)  # stamps of MCAP are unsigned; the message has its own
                    self._writer.add_message(self._channels[topic], time.time_ns(), b"".join(parts), stamp, number)
                    number += 1
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
