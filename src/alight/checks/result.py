"""Result of one check: a verdict, its evidence, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


class Judged(StrEnum):
    """Outcome of a check. "Cannot tell" is a result: the recording does not show enough."""

    GOOD = "good"
    BAD = "bad"
    WARNING = "warning"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True)
class CheckResult:
    """Result of one check of a rig."""

    name: str
    verdict: Judged
    evidence: str  # numbers with units, or the reason why the check cannot tell
    mend: str = ""  # remedy in one sentence; empty if none is needed
    lasts: bool = False  # whether the same check, repeated, will find the same

    @property
    def line(self) -> str:
        """The result as one line of text."""
        more = f"; mend: {self.mend}" if self.mend else ""
        return f"{self.verdict.upper():<11}  {self.name}: {self.evidence}{more}"


def good(name: str, evidence: str) -> CheckResult:
    """Return the result of a check that found no fault."""
    return CheckResult(name, Judged.GOOD, evidence)


def bad(name: str, evidence: str, mend: str, lasts: bool = False) -> CheckResult:
    """Return the result of a check that found a fault; `lasts`: see `CheckResult`."""
    return CheckResult(name, Judged.BAD, evidence, mend, lasts)


def warning(name: str, evidence: str, mend: str) -> CheckResult:
    """Return the result of a check that found a defect with which a run is still possible."""
    return CheckResult(name, Judged.WARNING, evidence, mend)


def unknown(name: str, why: str) -> CheckResult:
    """Return the result of a check for which the recording does not suffice, with the reason."""
    return CheckResult(name, Judged.UNKNOWN, why)


@dataclass
class Check:
    """A check in progress: its measurements as text, and the remedies of the faults found so far."""

    name: str
    measured: list[str] = field(default_factory=list)
    remedies: list[str] = field(default_factory=list)
    incomplete: bool = False  # a part could not be measured
    separator: str = "; "

    def judge(self, *rows: tuple[bool, str] | tuple[bool, str, str]) -> None:
        """Record the remedy and the text, if any, of each row (whether it is a fault, remedy, text) that is a fault."""
        for is_fault, remedy, *words in rows:
            if is_fault:
                self.remedies.append(remedy)
                self.measured += words

    @property
    def result(self) -> CheckResult:
        """The result: bad if there is a remedy, unknown if incomplete, else good."""
        evidence = self.separator.join(self.measured)
        if self.remedies:
            return bad(self.name, evidence, "; ".join(self.remedies))
        return unknown(self.name, evidence) if self.incomplete else good(self.name, evidence)
