"""The ways to run the lanes: a recording, a flight as it goes, a demonstration."""
