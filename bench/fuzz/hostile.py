"""A hostile peer on the link of a guided vehicle: forged and replayed messages, and floods, with a key and without."""

from __future__ import annotations

import random
import sys
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))

from hostile_peer import attacked

from alight.records import NoticeKind

KEY = b"k" * 32
SECONDS, MOST_LINES = 10.0, 2000  # of an attack; a line is a notice


def trial(seed: int) -> str | None:
    """Attack a flight with a key, or without; return the fault or the traceback, or None."""
    draw = random.Random(seed)
    key, count = draw.choice((KEY, None)), draw.choice((1, 20, 200))
    try:
        found = attacked(key, seed, count, SECONDS)
        if key is not None:
            alone = attacked(key, seed, 0, SECONDS)
            same = found.sent == alone.sent and found.notices_but(NoticeKind.INTERFERENCE) == alone.notices
            return None if same else "with a key: the peer has an effect"
    except Exception:
        return traceback.format_exc()
    lines = " ".join(found.of(NoticeKind.INTERFERENCE))
    if "second sender" not in lines:
        return "without a key: the second sender is not reported"
    if count == 200 and "a second" not in lines.replace("a second sender", ""):
        return "without a key: the flood is not reported"
    return None if len(found.notices) < MOST_LINES else f"without a key: {len(found.notices)} notices"
