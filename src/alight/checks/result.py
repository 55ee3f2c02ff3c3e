"""Result of one check: a verdict, the numbers behind it, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Judged(StrEnum):
    """Outcome of a check. "Cannot tell" is an answer: the recording does not show enough."""

    GOOD = "good"
    BAD = "bad"
    WARNING = "warning"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True)
class CheckResult:
    """One check of a rig."""

    name: str
    verdict: Judged
    evidence: str  # numbers with units, or the reason why the check cannot tell
    mend: str = ""  # remedy in one sentence; empty where none is needed

    @property
    def line(self) -> str:
        """The result as one line of text."""
        more = f"; mend: {self.mend}" if self.mend else ""
        return f"{self.verdict.upper():<11}  {self.name}: {self.evidence}{more}"


def good(name: str, evidence: str) -> CheckResult:
    """Result of a check that found no fault."""
    return CheckResult(name, Judged.GOOD, evidence)


def bad(name: str, evidence: str, mend: str) -> CheckResult:
    """Result of a check that found a fault."""
    return CheckResult(name, Judged.BAD, evidence, mend)


def warning(name: str, evidence: str, mend: str) -> CheckResult:
    """Result of a check that found a defect with which a run is still possible."""
    return CheckResult(name, Judged.WARNING, evidence, mend)


def unknown(name: str, why: str) -> CheckResult:
    """Result of a check that the recording does not allow."""
    return CheckResult(name, Judged.UNKNOWN, why)
