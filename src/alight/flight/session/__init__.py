"""A flown landing: the live lanes, the executive, and an autopilot that carries out its orders."""
