"""What is wrong with a rig, from some seconds of recording: each finding with its evidence and its mend."""

from alight.checks.checking import check_source
from alight.checks.result import CheckResult, Judged

__all__ = ["CheckResult", "Judged", "check_source"]
