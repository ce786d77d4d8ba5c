"""Recordings of movements: reading, cleaning and writing them.

A file becomes a :class:`Demonstration`, which is clean by construction: finite, starting at time zero,
every instant once. What was changed on the way is said in its `notes`.
"""

from comove.demonstrations.csv import read_csv, write_csv
from comove.demonstrations.demonstration import Demonstration
from comove.demonstrations.lasa import lasa_names, read_lasa
from comove.demonstrations.npz import read_npz, write_npz

__all__ = ["Demonstration", "lasa_names", "read_csv", "read_lasa", "read_npz", "write_csv", "write_npz"]
