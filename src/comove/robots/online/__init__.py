"""Stepwise execution of transfer motions among moving obstacles: measured joints in, commanded joints out."""
