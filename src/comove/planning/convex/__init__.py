"""Optimisation of motions by convex quadratic programmes with linearised clearances."""
