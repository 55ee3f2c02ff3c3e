"""Vehicles of landings whose pictures do not matter."""

from __future__ import annotations

from functools import partial

import pytest

from alight_sim.steered import SteeredFlight


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the vehicles of campaigns have one camera of a quarter of the pixels."""
    small = partial(SteeredFlight, size=(160, 120), stereo=False)
    monkeypatch.setattr("alight.trials.campaign.flying.SteeredFlight", small)
