"""Recordings of movements: reading, cleaning, cutting and writing them.

A file becomes a :class:`Demonstration`, which is clean by construction: finite, starting at time zero,
every instant once. Its `notes` report every change that was made.
"""

from comove.demonstrations.csv import read_csv, write_csv
from comove.demonstrations.demonstration import Demonstration
from comove.demonstrations.hdf5 import hdf5_episodes, read_hdf5, write_aloha, write_robomimic
from comove.demonstrations.lasa import lasa_names, read_lasa
from comove.demonstrations.lerobot import lerobot_episodes, read_lerobot, write_lerobot
from comove.demonstrations.npz import read_npz, write_npz
from comove.demonstrations.rosbag import read_rosbag, rosbag_topics, write_rosbag
from comove.demonstrations.segmentation import segment

__all__ = [
    "Demonstration",
    "hdf5_episodes",
    "lasa_names",
    "lerobot_episodes",
    "read_csv",
    "read_hdf5",
    "read_lasa",
    "read_lerobot",
    "read_npz",
    "read_rosbag",
    "rosbag_topics",
    "segment",
    "write_aloha",
    "write_csv",
    "write_lerobot",
    "write_npz",
    "write_robomimic",
    "write_rosbag",
]
