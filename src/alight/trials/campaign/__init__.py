"""Campaigns: closed-loop landings over worlds, winds and faults, drawn from a seed, one line of a file per landing."""
