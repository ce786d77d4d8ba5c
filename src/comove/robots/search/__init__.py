"""Numba kernels of chains and links that a search uses; `comove.robots.verification` shares no code with them."""
