"""pymavlink's messages and constants of MAVLink 2, in ArduPilot's dialect, which contains the common dialect."""

from __future__ import annotations

from alight.records import MissingExtraError

try:
    from pymavlink.dialects.v20 import ardupilotmega as mavlink
except ImportError as e:
    raise MissingExtraError("pymavlink", "fly") from e

__all__ = ["mavlink"]
