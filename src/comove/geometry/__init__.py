"""Geometry that knows no scene: rotations, shapes, meshes, and the distances between them."""
