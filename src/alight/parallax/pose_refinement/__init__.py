"""Refinement of the keyframe poses against the map: poses, map plane and heights in one solve."""
