"""A live run: three lanes as processes, and the threads that feed them."""
