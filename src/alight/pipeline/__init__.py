"""The core: events in, a landing decision out. No file, clock or thread: replay and flight run the same code."""

from alight.pipeline.decision import Decision
from alight.pipeline.judging import Verdict, without_water
from alight.pipeline.lanes import PipelineOptions
from alight.pipeline.navigation import TimedPoses
from alight.pipeline.pipeline import Pipeline
from alight.pipeline.policy import FlightPolicy, ScheduledPolicy

__all__ = [
    "Decision", "FlightPolicy", "Pipeline", "PipelineOptions", "ScheduledPolicy", "TimedPoses", "Verdict",
    "without_water",
]  # fmt: skip
