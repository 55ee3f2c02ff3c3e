"""Bundle adjustment of photos far apart."""
