"""The file of a signing key, and beside it the time stamps up to which messages are old."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from pathlib import Path

from alight.flight.autopilot.signing import SigningKey, Stream
from alight.outputs.atomic_write import write_whole
from alight.records import InputError, OutputError

log = logging.getLogger(__name__)

_EPOCH = 1_420_070_400  # s, 2015-01-01, from which MAVLink counts time stamps


def read_signing_key(path: Path) -> SigningKey:
    """Read the passphrase in a file; the key is its SHA-256, as in Mission Planner, QGroundControl and MAVProxy.

    Time stamps are kept in the file with `.stamps` behind its name, so that after a restart no message of before is
    accepted again.

    Raises:
        InputError: the file is missing or empty, others than its owner may use it, or its time stamps are damaged.
        OutputError: the time stamps cannot be written.
    """
    try:
        mode, passphrase = path.stat().st_mode, path.read_bytes().strip()
    except OSError as e:
        raise InputError(f"{path}: the signing key cannot be read ({e.strerror})") from e
    if mode & 0o077:
        raise InputError(f"{path}: others than its owner may use this signing key; mend it with: chmod 600 {path}")
    if not passphrase:
        raise InputError(f"{path}: is empty; write into it the passphrase that was given to the autopilot")
    stamps = path.with_name(f"{path.name}.stamps")

    def store(old: dict[Stream, int]) -> None:
        text = json.dumps({" ".join(map(str, stream)): stamp for stream, stamp in old.items()})
        try:
            write_whole(stamps, text.encode(), durable=False)
        except OutputError as e:  # a full disk ends no flight
            log.error("%s; messages of this flight might be accepted again after a restart", e)

    old = _read_stamps(stamps)
    try:
        stamps.touch()
    except OSError as e:
        raise OutputError(f"{stamps}: cannot be written ({e.strerror}); keep the key in a folder of your own") from e
    return SigningKey(hashlib.sha256(passphrase).digest(), round((time.time() - _EPOCH) * 1e5), old, store)


def _read_stamps(path: Path) -> dict[Stream, int]:
    try:
        text = path.read_text(encoding="utf-8") or "{}"
        return {(int(a), int(b), int(c)): int(v) for k, v in json.loads(text).items() for a, b, c in [k.split()]}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, AttributeError, TypeError) as e:
        raise InputError(f"{path}: the time stamps of the signing key are damaged; use a new key and delete it") from e
