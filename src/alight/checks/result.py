"""What one check says: a verdict, the numbers that it stands on, and the mend."""

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
    evidence: str  # numbers with units, or why nothing can be said
    mend: str = ""  # one sentence that says what to do; empty unless bad

    @property
    def line(self) -> str:
        """The result as one line of text."""
        more = f"; mend: {self.mend}" if self.mend else ""
        return f"{self.verdict.upper():<11}  {self.name}: {self.evidence}{more}"


def good(name: str, evidence: str) -> CheckResult:
    """A check that found nothing wrong."""
    return CheckResult(name, Judged.GOOD, evidence)


def bad(name: str, evidence: str, mend: str) -> CheckResult:
    """A check that found a fault."""
    return CheckResult(name, Judged.BAD, evidence, mend)


def warning(name: str, evidence: str, mend: str) -> CheckResult:
    """A check that found something that is not as it should be, and holds nothing up."""
    return CheckResult(name, Judged.WARNING, evidence, mend)


def unknown(name: str, why: str) -> CheckResult:
    """A check that the recording does not allow."""
    return CheckResult(name, Judged.UNKNOWN, why)
