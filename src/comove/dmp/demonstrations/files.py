"""Functions that read and write recordings in one format each."""

from comove.dmp.demonstrations.demonstration import each, each_episode
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
    "lasa_names",
    "read_csv",
    "read_hdf5",
    "read_lerobot",
    "read_npz",
    "read_rosbag",
    "write",
    "write_aloha",
    "write_csv",
    "write_lerobot",
    "write_npz",
    "write_robomimic",
    "write_rosbag",
]
