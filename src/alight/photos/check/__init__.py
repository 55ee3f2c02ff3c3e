"""Whether a set of photos will do, before a run."""
