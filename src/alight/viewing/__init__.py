"""A flight to look at: what a recording holds over time, drawn as a film, or in three dimensions with Rerun."""
