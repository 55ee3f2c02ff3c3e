"""The files of a campaign: campaign.json, and landings.jsonl, to which a line is added whenever a landing ends."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any

from alight.documents import LARGEST_JSON, LONGEST, DocumentError, parse_json, read_bytes, read_text, validated
from alight.outputs.atomic_write import output_error, write_whole
from alight.outputs.folder_lock import LOCK, lock_folder, release_folder
from alight.records import InputError, OutputError
from alight.records.campaign import CampaignHead, LandingRecord

log = logging.getLogger(__name__)

LINES, HEAD, PAGE = "landings.jsonl", "campaign.json", "campaign.html"


class CampaignFolder:
    """The folder of one campaign.

    Args:
        out: path of the folder; it is made by `begin`.
    """

    def __init__(self, out: Path) -> None:
        self.out, self._path = out, out / LINES

    def head(self) -> CampaignHead | None:
        """Read campaign.json; None: the folder holds no campaign.

        Raises:
            InputError: campaign.json is damaged, or is not of a campaign.
        """
        path = self.out / HEAD
        try:
            return validated(CampaignHead, parse_json(read_text(path, LARGEST_JSON)))
        except FileNotFoundError:
            return None
        except (OSError, DocumentError) as e:
            raise InputError(f"{path}: is not a campaign's ({_why(e)}); name another folder") from e

    def begin(self, head: CampaignHead) -> None:
        """Make the folder, or check that it is of this campaign; lock it, and remove an incomplete last line.

        Raises:
            OutputError: the folder holds another campaign or other files, another process writes there, or it cannot
                be written.
        """
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            if (there := self.head()) is None and any(p.name != LOCK for p in self.out.iterdir()):
                raise OutputError(
                    f"{self.out}: holds files that are not a campaign's; choose another folder with --out"
                )
        except OSError as e:
            raise output_error(self.out, e) from e
        if there is not None and (other := there.differing(head)) is not None:
            raise OutputError(f"{self.out}: holds a campaign with {other}; choose another folder with --out")
        try:
            lock_folder(self.out)
        except OSError as e:
            raise output_error(self.out, e) from e
        self.write_head(head, {})
        lines, torn = self._lines()
        if torn:
            write_whole(self._path, b"".join(line + b"\n" for line in lines))

    def end(self) -> None:
        """Unlock the folder."""
        release_folder(self.out)

    def write_head(self, head: CampaignHead, more: dict[str, Any]) -> None:
        """Write the whole campaign.json: first the head, then the results `more`."""
        text = json.dumps(head.model_dump(mode="json") | more, indent=1)
        write_whole(self.out / HEAD, (text + "\n").encode())

    def _lines(self) -> tuple[list[bytes], str]:
        """Return the complete lines of landings.jsonl, and what is wrong with an incomplete last line (else empty)."""
        try:
            *lines, rest = read_bytes(self._path, 1_000_000_000).split(b"\n")
        except FileNotFoundError:
            return [], ""
        except (OSError, DocumentError) as e:
            raise InputError(f"{self._path}: cannot be read ({_why(e)}); mend it or name another folder") from e
        if lines and isinstance(error := _record(lines[-1]), DocumentError):
            return lines[:-1], str(error)
        return lines, "it does not end" if rest else ""

    def read(self) -> dict[int, LandingRecord]:
        """Return all landings that ended, by number; an incomplete last line is left out.

        Raises:
            InputError: the file cannot be read, or a line before the last is damaged.
        """
        found: dict[int, LandingRecord] = {}
        lines, torn = self._lines()
        for k, line in ((k, line) for k, line in enumerate(lines, 1) if line):
            record = _record(line)
            if isinstance(record, DocumentError):
                raise InputError(
                    f"{self._path}: line {k} is damaged ({record}); remove it, and its landing is flown again"
                )
            found[record.number] = record
        if torn:
            log.warning("%s: its last line is not whole (%s) and is left out", self._path, torn)
        return dict(sorted(found.items()))

    def write_picture(self, name: str | None, picture: bytes | None) -> None:
        """Write a picture or film of a landing; before its line, so that a line never names a missing file."""
        if name is not None and picture is not None:
            write_whole(self.out / name, picture)

    def append(self, record: LandingRecord, picture: bytes | None = None) -> None:
        """Append a landing; when this returns, the line is on the disk. The picture is written first.

        Raises:
            OutputError: the folder cannot be written.
        """
        try:
            self.write_picture(record.picture, picture)
            with self._path.open("ab") as f:
                f.write(record.model_dump_json().encode() + b"\n")
                f.flush()
                os.fsync(f.fileno())
        except OSError as e:
            raise output_error(self._path, e) from e


def _record(line: bytes) -> LandingRecord | DocumentError:
    if len(line) > LONGEST:
        return DocumentError(f"longer than {LONGEST} characters")
    try:
        return validated(LandingRecord, parse_json(line))
    except DocumentError as e:
        return e


def _why(error: OSError | DocumentError) -> str:
    return str(error) if isinstance(error, DocumentError) else str(error.strerror or error)
