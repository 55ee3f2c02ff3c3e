"""Faults of a rig, found from some seconds of recording: each with its evidence and a remedy."""

from alight.checks.checking import check_source
from alight.checks.result import CheckResult, Judged

__all__ = ["CheckResult", "Judged", "check_source"]
