"""Campaigns: closed-loop landings over worlds, winds and faults, drawn from a seed, one line of a file each."""

from alight.trials.campaign.folder import CampaignFolder
from alight.trials.campaign.page import comparison
from alight.trials.campaign.run import (
    Campaign,
    Ended,
    again,
    continued,
    fly_campaign,
    numbers_in,
    outcome_lines,
    wanted_landings,
)
from alight.trials.campaign.worlds import FORM, is_factory

__all__ = [
    "FORM",
    "Campaign",
    "CampaignFolder",
    "Ended",
    "again",
    "comparison",
    "continued",
    "fly_campaign",
    "is_factory",
    "numbers_in",
    "outcome_lines",
    "wanted_landings",
]
