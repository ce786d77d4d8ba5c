"""How a search sees a robot: numba kernels of chains and links, which `comove.robots.judge` shares nothing with."""
