"""The numbers and the page of a campaign."""

from alight.report.campaign.numbers import CampaignNumbers, campaign_numbers, unsafe_bound
from alight.report.campaign.page import render_campaign

__all__ = ["CampaignNumbers", "campaign_numbers", "render_campaign", "unsafe_bound"]
