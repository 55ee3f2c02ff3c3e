"""Wires: thin straight lines of single pictures that move by parallax against the ground."""
