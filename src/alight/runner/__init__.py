"""Runs over recordings: open an input, check it, replay it; judge heights; train models of appearance."""
