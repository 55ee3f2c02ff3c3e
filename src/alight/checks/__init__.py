"""Faults of a rig, found from some seconds of recording: each with its evidence and a remedy."""
