"""The files of a campaign: campaign.json, and landings.jsonl, to which a line is added whenever a landing ends."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from alight.outputs.atomic_write import output_error, write_whole
from alight.records import InputError, OutputError
from alight.records.campaign import CampaignHead, LandingRecord

LINES, HEAD, PAGE = "landings.jsonl", "campaign.json", "campaign.html"


class CampaignFolder:
    """One campaign's folder.

    Args:
        out: the folder; made by `begin`.
    """

    def __init__(self, out: Path) -> None:
        self.out, self._path = out, out / LINES

    def head(self) -> CampaignHead | None:
        """What makes this campaign; None: the folder holds none.

        Raises:
            InputError: campaign.json is none of ours.
        """
        try:
            tree = json.loads((self.out / HEAD).read_text(encoding="utf-8"))
            return CampaignHead(**{name: tree.get(name) for name in CampaignHead.model_fields})
        except FileNotFoundError:
            return None
        except (OSError, ValueError, AttributeError) as e:
            raise InputError(f"{self.out / HEAD}: is not a campaign's; choose another folder with --out") from e

    def begin(self, head: CampaignHead) -> None:
        """Make the folder, or see that it is this campaign's, and mend the last line where it is torn.

        Raises:
            OutputError: the folder holds another campaign or other files, or may not be written.
        """
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            if (there := self.head()) is None and any(self.out.iterdir()):
                raise OutputError(
                    f"{self.out}: holds files that are not a campaign's; choose another folder with --out"
                )
        except OSError as e:
            raise output_error(self.out, e) from e
        if there is not None and (other := there.differing(head)) is not None:
            raise OutputError(f"{self.out}: holds a campaign with {other}; choose another folder with --out")
        self.write_head(head, {})
        self._mend()

    def write_head(self, head: CampaignHead, more: dict[str, Any]) -> None:
        """Write campaign.json whole: the head first, then what was found."""
        text = json.dumps(head.model_dump(mode="json") | more, indent=1)
        write_whole(self.out / HEAD, (text + "\n").encode())

    def _mend(self) -> None:
        """Cut off a last line that was not written whole."""
        if not self._path.exists():
            return
        data = self._path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        last = whole[:-1].rpartition(b"\n")[2]
        if whole and not _is_json(last):
            whole = whole[: len(whole) - len(last) - 1]
        if whole != data:
            write_whole(self._path, whole)

    def read(self) -> dict[int, LandingRecord]:
        """All landings that ended, by number; a torn last line is left out.

        Raises:
            InputError: a line before the last is damaged.
        """
        if not self._path.exists():
            return {}
        found: dict[int, LandingRecord] = {}
        lines = self._path.read_bytes().split(b"\n")
        for k, line in enumerate(lines, 1):
            try:
                if line:
                    record = LandingRecord.model_validate_json(line)
                    found[record.number] = record
            except ValidationError as e:
                if k >= len(lines) - 1:
                    continue
                raise InputError(f"{self._path}: line {k} is damaged; remove it, and its landing is flown again") from e
        return dict(sorted(found.items()))

    def append(self, record: LandingRecord, picture: bytes | None = None) -> None:
        """Add a landing; when this returns it is on the disk. The picture comes first.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            if picture is not None and record.picture is not None:
                write_whole(self.out / record.picture, picture)
            with self._path.open("ab") as f:
                f.write(record.model_dump_json().encode() + b"\n")
                f.flush()
                os.fsync(f.fileno())
        except OSError as e:
            raise output_error(self._path, e) from e


def _is_json(line: bytes) -> bool:
    try:
        json.loads(line)
    except ValueError:
        return False
    return True
