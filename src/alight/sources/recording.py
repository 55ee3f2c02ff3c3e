"""A recording of a live run, read as a source: the events in the order of their arrival, and the schedule."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader

from alight.documents import parse_json
from alight.records import Event, Frame, InputError, Schedule
from alight.records.codec import CAMERAS, IMU, NAV, NOTES, SCHEDULE, FlightHead, unpack
from alight.settings import Settings
from alight.sources.source import Findings, RecordedSource, Trajectory

HEAD = "alight"


class Recording(RecordedSource):
    """One recorded flight.

    Raises:
        InputError: the file is no recording of ours.
    """

    kind: Literal["flight"] = "flight"
    truth_trajectory: Trajectory | None = None

    def __init__(self, path: Path, settings: Settings) -> None:
        self._findings, self._path, self._whole = Findings(), path, True
        self._skip, self._every = settings.sources.skip, settings.sources.every
        head, entries, frames, notes = self._scan()
        self.length = frames
        self.name, self.rig, self.local, self.georeferenced = head.name, head.rig, head.local, head.georeferenced
        self.imu_noise, self.flown_with = head.imu_noise, head.settings
        self.schedule: Schedule | None = Schedule(**{k: tuple(v) for k, v in entries.items()})
        self.notes: dict[str, Any] = {
            "cameras": [c.name for c in self.rig.cameras], "focal_from": "the recording",
            **({"in flight": notes} if notes else {}),
        }  # fmt: skip
        if not frames:
            raise InputError(f"{path}: holds no exposure; there is nothing to replay")

    def events(self) -> Iterator[Event]:
        """Yield what came in, in the order of arrival."""
        exposure = -1
        for topic, data in self._messages():
            if topic not in (CAMERAS, NAV, IMU):
                continue
            try:
                event = unpack(topic, data)
            except ValueError as e:
                self._findings.lose(f"{topic[1:]} messages", f"in {self._path.name}", str(e))
                continue
            if isinstance(event, Frame):
                exposure += 1
                if exposure < self._skip or (exposure - self._skip) % self._every:
                    continue
            yield event

    def _scan(self) -> tuple[FlightHead, dict[str, list[Any]], int, list[str]]:
        head, frames, notes = None, 0, list[str]()
        entries: dict[str, list[Any]] = {k: [] for k in Schedule.__dataclass_fields__}
        for topic, data in self._messages():
            if topic == HEAD:
                head = FlightHead.from_json(data.decode())
            elif topic == CAMERAS:
                frames += 1
            elif topic == SCHEDULE:
                entry = parse_json(data)
                if entry["kind"] in entries:
                    entries[entry["kind"]].append(int(entry["t_ns"]))
                    if entry["kind"] == "mapped":
                        entries["effort"].append(int(entry["value"]))
                    elif entry["kind"] == "judged":
                        place = entry.get("about")  # recordings of before 2026-11-23 do not say
                        entries["about"].append(None if place is None else (float(place[0]), float(place[1])))
            elif topic == NOTES:
                note = parse_json(data)
                notes.append(f"{note['lane']}: {note['note']}")
        if head is None:
            raise InputError(f"{self._path}: no recording of Alight; give one that 'alight live' made")
        return head, entries, frames, notes

    def _messages(self) -> Iterator[tuple[str, bytes]]:
        """Topic and bytes of every message; a file that ends early gives what it has, and this is said."""
        topics: dict[int, str] = {}
        try:
            with self._path.open("rb") as file:
                for record in StreamReader(file).records:
                    if isinstance(record, Metadata) and record.name == HEAD:
                        yield HEAD, record.metadata["head"].encode()
                    elif isinstance(record, Channel):
                        topics[record.id] = record.topic
                    elif isinstance(record, Message):
                        yield topics[record.channel_id], record.data
        except OSError as e:
            raise InputError(f"{self._path}: cannot be read ({e.strerror or e}); check the permissions") from e
        except (McapError, ValueError, KeyError, OverflowError) as e:
            if not topics:
                raise InputError(f"{self._path}: no recording (MCAP); give one that 'alight live' made") from e
            self._findings.say("the recording ends early, as after a loss of power: what came before it is used")
