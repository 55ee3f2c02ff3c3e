"""Training of the appearance model from labelled pictures, and its test on held-out sites."""
