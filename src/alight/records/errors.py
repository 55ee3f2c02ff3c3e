"""Errors that a user can fix."""

from __future__ import annotations


class AlightError(Exception):
    """Error that a user can fix; the message names the cause and the remedy."""


class InputError(AlightError):
    """The input cannot be used: a folder without images, a malformed calibration, a missing stream."""


class SettingsError(AlightError):
    """A setting is unknown or out of range."""


class OutputError(AlightError):
    """The result cannot be written: disk full, no permission, or the folder exists."""


class MissingExtraError(AlightError):
    """An optional package is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; mend it with: pip install 'alight[{extra}]'")
