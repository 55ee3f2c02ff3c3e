"""Training of the appearance model from labelled pictures, and its test on sites left out of the training."""
