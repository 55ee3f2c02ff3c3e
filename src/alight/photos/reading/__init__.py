"""Photos and films as sources: tags, lenses, poses, the choice of the pictures."""
