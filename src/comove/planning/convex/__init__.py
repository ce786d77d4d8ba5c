"""The optimisation of motions by a sequence of convex quadratic programmes with linearised clearances."""
