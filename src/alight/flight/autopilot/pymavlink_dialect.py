"""The package's only import of pymavlink: its messages and its framing, imported when they are first needed."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from alight.records import MissingExtraError


@cache
def dialect() -> Any:
    """Return pymavlink's module of MAVLink 2 with ArduPilot's dialect, which contains the common messages.

    Raises:
        MissingExtraError: pymavlink is not installed.
    """
    try:
        return import_module("pymavlink.dialects.v20.ardupilotmega")
    except ImportError as e:
        raise MissingExtraError("pymavlink", "fly") from e


def message(name: str, **fields: Any) -> Any:
    """Make a message by its name, such as HEARTBEAT, and its fields in MAVLink's units.

    Raises:
        MissingExtraError: pymavlink is not installed.
    """
    return getattr(dialect(), f"MAVLink_{name.lower()}_message")(**fields)


def message_id(name: str) -> int:
    """Return the number of a message by its name, such as HEARTBEAT."""
    return int(getattr(dialect(), f"MAVLINK_MSG_ID_{name}"))
