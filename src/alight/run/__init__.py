"""Running the pipeline: over a recording (`replay`), or over a flight as it comes (`live`)."""
