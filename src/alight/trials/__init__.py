"""The product against the simulator: single landings, campaigns of them, the demo, rehearsals."""
