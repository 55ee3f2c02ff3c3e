"""Check before a run whether a set of photos is suitable."""
