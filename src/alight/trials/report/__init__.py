"""The numbers and the page of a campaign."""

from alight.trials.report.numbers import CampaignNumbers, campaign_numbers, unsafe_bound
from alight.trials.report.page import render_campaign

__all__ = ["CampaignNumbers", "campaign_numbers", "render_campaign", "unsafe_bound"]
