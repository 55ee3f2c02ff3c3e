"""Results of a comparison: named numbers in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike


def rms(errors: ArrayLike) -> float:
    """Compute the root mean square of the errors; NaN without errors."""
    e = np.asarray(errors, dtype=np.float64)
    return float(np.sqrt(np.mean(e * e))) if e.size else float("nan")


VARIANTS = ("", ", registered", ", registered by its heights")  # ends of names: the same number, compared otherwise
SHORT = (
    "best site truly safe", "sites truly safe", "ground NMAD, m", "ground within 1.96 sigma and common tilt, %",
    "declared safe and not within", "position RMSE, m",
)  # fmt: skip


@dataclass
class Evaluation:
    """Named numbers with units; `lines` formats them."""

    title: str
    values: dict[str, float | str] = field(default_factory=dict)

    def put(self, name: str, value: float | str) -> None:
        """Add one named number or text; NaN: not measurable."""
        self.values[name] = value

    def lines(self) -> list[str]:
        """Return the title, the main numbers if some are compared in several ways, and one line per number."""
        rows: dict[str, list[str]] = {}
        for name, value in self.values.items():
            base = name
            for end in VARIANTS[1:]:
                base = base.removesuffix(end)
            row = rows.setdefault(base, [""] * len(VARIANTS))
            row[VARIANTS.index(name[len(base) :])] = value if isinstance(value, str) else f"{value:.4g}"
        if not any(any(row[1:]) for row in rows.values()):
            return [self.title, *aligned([[name, row[0]] for name, row in rows.items()])]
        short = [[name, row[1] or row[0]] for name, row in rows.items() if name.startswith(SHORT)]
        head = ["", "as it is", *(end.removeprefix(", ") for end in VARIANTS[1:])]
        table = aligned([head, *([name, *row] for name, row in rows.items())])
        return [self.title, *aligned(short), "", *table]


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines with aligned columns, indented by two spaces."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["".join(f"  {cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
