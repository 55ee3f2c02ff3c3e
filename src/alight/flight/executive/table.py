"""The executive's transition table: the next state by present state and event. Other events change nothing."""

from __future__ import annotations

from collections.abc import Mapping

from alight.records.executive import FlightEvent, FlightState

S, E = FlightState, FlightEvent
Event = tuple[FlightEvent, str]  # an event, and its reason in words; an empty reason is the event itself

FLYING = (S.SEARCH, S.APPROACH, S.LOOK, S.DESCEND, S.COMMIT, S.ABORT, S.HOLD)
ABOVE = (S.SEARCH, S.APPROACH, S.LOOK, S.DESCEND)  # before the landing begins
AT_A_PLACE = (S.APPROACH, S.LOOK, S.DESCEND)
DOWN = (S.COMMIT, S.ABORT, S.HOLD, S.RETURN)  # the ground ends these states, and every climb in them
ENDS = (S.LANDED, S.RETURN, S.HANDED_OVER)
JUDGE_EVERY = {S.SEARCH: 2.0, S.APPROACH: 2.0, S.LOOK: 0.6, S.DESCEND: 1.5, S.COMMIT: 0.5}  # s between two verdicts


def _rows() -> Mapping[tuple[FlightState, FlightEvent], FlightState]:
    out = {(s, e): S.HANDED_OVER for s in (*FLYING, S.RETURN) for e in (E.PILOT, E.FAILSAFE, E.LINK_LOST)}
    out |= {(s, E.NAVIGATION_LOST): S.HOLD for s in ABOVE} | {(s, E.CAMERA_LOST): S.HOLD for s in ABOVE}
    out |= {(s, e): S.RETURN for s in (*ABOVE, S.HOLD) for e in (E.WIND, E.BATTERY, E.TIME)}
    out |= {(S.HOLD, E.RECOVERED): S.SEARCH, (S.HOLD, E.WAITED): S.HANDED_OVER}
    out |= {(S.SEARCH, E.SEARCHED): S.RETURN, (S.SEARCH, E.FOUND): S.APPROACH, (S.SEARCH, E.LOWER): S.SEARCH}
    out |= {(S.APPROACH, E.ARRIVED): S.LOOK, (S.DESCEND, E.ARRIVED): S.LOOK}
    out |= {(S.LOOK, E.LOWER): S.DESCEND, (S.LOOK, E.CONFIRMED): S.COMMIT}
    out |= {(s, E.GPS_LOST): S.APPROACH for s in AT_A_PLACE}
    out |= {(s, E.REFUSED): S.SEARCH for s in AT_A_PLACE}
    out |= {(s, E.WAITED): S.SEARCH for s in AT_A_PLACE}
    out |= {(s, E.NEW_FRAME): S.SEARCH for s in AT_A_PLACE}
    out |= {(S.COMMIT, E.UNFELT): S.HANDED_OVER}
    out |= {(s, E.TOUCHED_DOWN): S.LANDED for s in DOWN}
    out |= {(S.ABORT, E.CLEAR): S.SEARCH, (S.ABORT, E.WAITED): S.HANDED_OVER}
    # events that abort a landing, unless it is too low (`is_too_low_to_abort`)
    breaks_off = E.NAVIGATION_LOST, E.CAMERA_LOST, E.WIND, E.WAITED, E.REFUSED, E.NEW_FRAME
    out |= {(S.COMMIT, e): S.ABORT for e in breaks_off}
    return out


TABLE = _rows()
