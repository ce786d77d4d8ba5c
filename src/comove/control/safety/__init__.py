"""Safety filter (CBF-QP): the collision-free velocities nearest to the desired ones."""
