"""Recordings of movements: reading, cleaning, cutting and writing them.

A file becomes a :class:`Demonstration`, which is clean by construction: finite, starting at time zero,
every instant once. Its `notes` report every change that was made.
"""

from comove.dmp.demonstrations.demonstration import Demonstration, each, each_episode, segment
from comove.dmp.demonstrations.formats import hdf5, lerobot, npz, rosbag, tables, write
from comove.dmp.demonstrations.formats.csv import write as write_csv
from comove.dmp.demonstrations.formats.hdf5 import write_aloha, write_robomimic
from comove.dmp.demonstrations.formats.lasa import names as lasa_names
from comove.dmp.demonstrations.formats.lerobot import write as write_lerobot
from comove.dmp.demonstrations.formats.npz import write as write_npz
from comove.dmp.demonstrations.formats.rosbag import write as write_rosbag

read_csv = each(tables.read)
read_npz = each(npz.read)
read_rosbag = each(rosbag.read)
read_hdf5 = each_episode(hdf5.read)
read_lerobot = each_episode(lerobot.read)

__all__ = [
    "Demonstration",
    "lasa_names",
    "read_csv",
    "read_hdf5",
    "read_lerobot",
    "read_npz",
    "read_rosbag",
    "segment",
    "write",
    "write_aloha",
    "write_csv",
    "write_lerobot",
    "write_npz",
    "write_robomimic",
    "write_rosbag",
]
