"""Training of the appearance model from pictures of known ground, and its test on places it has not seen."""
