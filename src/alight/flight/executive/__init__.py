"""The executive: states, events and orders to the vehicle."""
