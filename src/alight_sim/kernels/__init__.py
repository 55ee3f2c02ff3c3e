"""The simulator's compiled loops, on bare arrays like those of the stages."""
