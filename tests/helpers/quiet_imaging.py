"""Pictures without random effects."""

QUIET = {"gain_drift": 0.0, "white_balance": 0.0, "noise": 0.0}  # keys of `Imaging`
