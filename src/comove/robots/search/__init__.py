"""Numba kernels of chains and links that a search uses; `comove.robots.judge` shares no code with them."""
