"""Frozen records that the stages exchange, and the errors that a user can fix.

World ENU, body FLU, camera optical; SI units, radians, time as `int` nanoseconds. Unknown values are NaN, reasons are
flag bits.
"""

from alight.records.errors import AlightError, InputError, MissingExtraError, OutputError, SettingsError
from alight.records.events import (
    Event,
    Frame,
    ImuSample,
    NavSample,
    Pixels,
    Prediction,
    Rig,
    RigCamera,
    Schedule,
    Tracks,
)
from alight.records.evidence import MapEvidence
from alight.records.landing import (
    Doubt,
    Hazard,
    HazardMap,
    Kind,
    NearZone,
    NextView,
    Observer,
    Route,
    Site,
    Sites,
    Waypoint,
    is_site,
    keeps_margin,
    p_safe_text,
)
from alight.records.map_frame import MapFrame
from alight.records.motion import (
    GpsState,
    KeyframePosterior,
    Motion,
    MotionState,
    MovingBody,
    Odometry,
    RefinedMotions,
    View,
)
from alight.records.photos import PHOTO_COLUMNS, PhotoFacts, PhotoOutcome, PhotoRow
from alight.records.result import Decision, RunResult
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
    PriorComparison,
    PriorHeights,
    Terrain,
    TerrainMap,
    is_flagged,
    is_measured,
    is_trusted,
)
from alight.records.tally import Tally
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
from alight.records.wires import Wire, nearest_wire
from alight.records.zones import NO_ZONES, GroundZone, Zones, ZonesOnPlane
