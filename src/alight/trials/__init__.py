"""The product against the simulator: single landings, campaigns of landings, the demo, rehearsals."""
