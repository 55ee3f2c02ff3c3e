"""The answer after a landing: where the vehicle stands, and no other site."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from autopilot_rig import LOCAL
from pilot_rig import PLACE, flying
from session_rig import session_of
from some_run import some_run

from alight.cli import call
from alight.flight.session import flight
from alight.records.executive import FlightState

S = FlightState


def test_after_a_landing_the_answer_is_where_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """`SITE` named a place 22 m away, with `the vehicle climbs 17.2 m before it leaves`."""
    r = flying()
    session = session_of(r, monkeypatch, [])
    monkeypatch.setattr(session.run, "finish", lambda: replace(some_run(), route=object()))
    outcome = session.fly(threading.Event())
    assert outcome.state is S.LANDED
    words = outcome.why.replace(",", "").split()
    latitude, longitude = (float(words[words.index("at") + k]) for k in (1, 2))
    wrong = r.sim.estimate.now.position[:2]  # of the autopilot's own estimate
    np.testing.assert_allclose(LOCAL.to_enu(latitude, longitude, 0.0)[:2], PLACE + wrong, atol=0.5)
    assert "P(safe) 0.9" in outcome.why
    assert outcome.result is not None
    assert outcome.result.route is None


@pytest.mark.parametrize(("state", "site"), [(S.LANDED, False), (S.RETURN, True)])
def test_after_a_landing_no_other_site_is_printed(
    state: FlightState, site: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(flight, "fly_vehicle", lambda *_: flight.FlightOutcome((), "why", state, some_run()))
    monkeypatch.setattr("alight.outputs.write_run", lambda *given: None)
    call(["fly", "--link", "udp:127.0.0.1:9", "--camera", "x", "--out", str(tmp_path / "out")])
    assert ("SITE  " in capsys.readouterr().out) is site
