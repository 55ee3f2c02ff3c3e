"""What goes between the stages: frozen records, and the errors a user can mend.

World ENU, body FLU, camera optical; SI, radians, `int` nanoseconds; unknown is NaN, reasons are flag bits.
"""

from alight.records.errors import AlightError, InputError, MissingExtraError, OutputError, SettingsError
from alight.records.events import Event, Frame, ImuSample, NavSample, Pixels, Prediction, Rig, RigCamera, Tracks
from alight.records.landing import Doubt, Hazard, HazardMap, Kind, NextView, Route, Site, Sites, Waypoint
from alight.records.motion import KeyframePosterior, Motion, MotionState, RefinedMotions, View
from alight.records.photos import PHOTO_COLUMNS, PhotoFacts, PhotoOutcome, PhotoRow
from alight.records.prior import PriorComparison, PriorHeights
from alight.records.result import RunResult
from alight.records.schedule import Schedule
from alight.records.surface import (
    LANDABLE,
    NOTHING_MISSING,
    REFUSED,
    Datum,
    ElevationMap,
    Flag,
    Heights,
    MissingVeto,
    PlaceSigma,
    Terrain,
    TerrainMap,
    is_trusted,
)
from alight.records.telemetry import (
    FIX_3D,
    PRE_ARM,
    Battery,
    FlightMode,
    GpsQuality,
    Home,
    Landed,
    Notice,
    NoticeKind,
    Place,
    Telemetry,
    is_absolute,
)

__all__ = [
    "FIX_3D",
    "LANDABLE",
    "NOTHING_MISSING",
    "PHOTO_COLUMNS",
    "PRE_ARM",
    "REFUSED",
    "AlightError",
    "Battery",
    "Datum",
    "Doubt",
    "ElevationMap",
    "Event",
    "Flag",
    "FlightMode",
    "Frame",
    "GpsQuality",
    "Hazard",
    "HazardMap",
    "Heights",
    "Home",
    "ImuSample",
    "InputError",
    "KeyframePosterior",
    "Kind",
    "Landed",
    "MissingExtraError",
    "MissingVeto",
    "Motion",
    "MotionState",
    "NavSample",
    "NextView",
    "Notice",
    "NoticeKind",
    "OutputError",
    "PhotoFacts",
    "PhotoOutcome",
    "PhotoRow",
    "Pixels",
    "Place",
    "PlaceSigma",
    "Prediction",
    "PriorComparison",
    "PriorHeights",
    "RefinedMotions",
    "Rig",
    "RigCamera",
    "Route",
    "RunResult",
    "Schedule",
    "SettingsError",
    "Site",
    "Sites",
    "Telemetry",
    "Terrain",
    "TerrainMap",
    "Tracks",
    "View",
    "Waypoint",
    "is_absolute",
    "is_trusted",
]
