"""Touchdowns under wires."""

from __future__ import annotations

SLACK = 0.7  # metres: how far a wire may be from where it was found
BEYOND = 4.0  # metres by which a wire goes on at either end of what was found of it
