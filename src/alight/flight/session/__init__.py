"""A landing that is flown: the live lanes, the executive, and an autopilot that takes its orders."""
