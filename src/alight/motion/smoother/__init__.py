"""The batch smoother of a recorded flight."""
