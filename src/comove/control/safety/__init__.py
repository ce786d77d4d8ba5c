"""Reaction to moving obstacles: the quadratic programme for twists that keeps loads rigid and everything clear."""
