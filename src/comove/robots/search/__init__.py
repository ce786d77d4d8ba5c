"""Numba kernels of chains and links for search, separate from `comove.robots.verification`."""
