"""The core: events in, a landing decision out. No file, clock or thread: replay and flight run the same code."""

from alight.pipeline.judging import Verdict, without_water
from alight.pipeline.lanes import PipelineOptions
from alight.pipeline.navigation import TimedPoses
from alight.pipeline.pipeline import Pipeline
from alight.pipeline.policy import FlightPolicy, ScheduledPolicy
from alight.records import Decision
