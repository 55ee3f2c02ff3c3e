"""The executive: states, events and orders of a landing in flight."""
