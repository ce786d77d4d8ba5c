"""Safety filter: the velocities nearest to the desired ones that lead to no collision (CBF-QP)."""
