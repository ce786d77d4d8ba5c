"""Convex optimisation of motions: a sequence of quadratic programmes with linearised clearances."""
