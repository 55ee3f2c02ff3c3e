"""The core: events in, a landing decision out. Without file, clock or thread, it is the same in replay and flight."""

from alight.pipeline.judging import Verdict, without_water
from alight.pipeline.lanes import PipelineOptions
from alight.pipeline.navigation import TimedPoses
from alight.pipeline.pipeline import Pipeline
from alight.pipeline.policy import FlightPolicy, ScheduledPolicy
from alight.records import Decision
