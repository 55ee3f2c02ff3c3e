"""The simulator's compiled loops: bare arrays in and out, as those of the stages."""
