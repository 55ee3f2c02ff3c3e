"""Results of a comparison: named numbers in order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike


def rms(errors: ArrayLike) -> float:
    """Compute the root mean square of the errors; NaN without errors."""
    e = np.asarray(errors, dtype=np.float64)
    return float(np.sqrt(np.mean(e * e))) if e.size else float("nan")


@dataclass
class Evaluation:
    """Named numbers with units; `lines` formats them."""

    title: str
    values: dict[str, float | str] = field(default_factory=dict)

    def put(self, name: str, value: float | str) -> None:
        """Add one named number or text; NaN: not measurable."""
        self.values[name] = value

    def lines(self) -> list[str]:
        """Return the title and one line per number."""
        width = max((len(k) for k in self.values), default=0)
        shown = {k: v if isinstance(v, str) else f"{v:.4g}" for k, v in self.values.items()}
        return [self.title, *(f"  {k:<{width}}  {v}" for k, v in shown.items())]
