"""Planar parallax on the world grid: posed views -> heights with sigma and flags."""
