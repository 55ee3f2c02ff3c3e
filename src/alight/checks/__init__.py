"""Checks of a rig on some seconds of recording: each result has the evidence of a fault and its remedy."""
