"""Campaigns: closed-loop landings over worlds, winds and faults, drawn from a seed, one line of a file each."""

from alight.report.campaign.page import comparison
from alight.runner.campaign.folder import CampaignFolder
from alight.runner.campaign.run import (
    Campaign,
    Ended,
    again,
    continued,
    fly_campaign,
    numbers_in,
    outcome_lines,
    wanted_landings,
)

__all__ = [
    "Campaign",
    "CampaignFolder",
    "Ended",
    "again",
    "comparison",
    "continued",
    "fly_campaign",
    "numbers_in",
    "outcome_lines",
    "wanted_landings",
]
