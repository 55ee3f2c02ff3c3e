"""The parts of a flight: the autopilot's protocol, the executive, the live lanes, and a flight from start to end."""
