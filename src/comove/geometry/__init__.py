"""Geometry without scenes: rotations, shapes, meshes, and distances between them."""
