"""Write a fitted table and the sections of its card that a fit changes."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime

from alight.learned import table_path


def version() -> str:
    """Date and commit of a fit, as a line for its card."""
    found = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return f"Date: {datetime.now(UTC):%Y-%m-%d}, commit {found.stdout.strip() or 'unknown'}."


def with_sections(card: str, sections: Mapping[str, str]) -> str:
    """The text of a card with some of its sections replaced.

    Raises:
        ValueError: the card has no section of that name.
    """
    for heading, text in sections.items():
        section = re.compile(rf"^## {re.escape(heading)}\n.*?(?=^## |\Z)", re.S | re.M)
        new = f"## {heading}\n{text.strip()}\n\n"
        card, count = section.subn(new.replace("\\", "\\\\"), card)
        if count != 1:
            raise ValueError(f"the card has no section {heading!r}")
    return card.rstrip() + "\n"


def write_table(name: str, content: bytes, sections: Mapping[str, str]) -> None:
    """Write `learned/NAME.npz` and the named sections of `learned/NAME.md`; the other sections stay as they are."""
    path = table_path(name)
    card = path.with_suffix(".md")
    text = with_sections(card.read_text(encoding="utf-8"), sections)
    path.write_bytes(content)
    card.write_text(text, encoding="utf-8")
