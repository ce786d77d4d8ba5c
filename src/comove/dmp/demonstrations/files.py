"""Functions that read and write recordings in one format each."""

from comove.dmp.demonstrations.demonstration import each, each_episode
from comove.dmp.demonstrations.formats import csv, hdf5, lasa, lerobot, npz, register, rosbag, tables

read_csv = each(tables.read)
read_npz = each(npz.read)
read_rosbag = each(rosbag.read)
read_hdf5 = each_episode(hdf5.read)
read_lerobot = each_episode(lerobot.read)
lasa_names = lasa.names
write = register.write
write_csv, write_npz, write_lerobot, write_rosbag = csv.write, npz.write, lerobot.write, rosbag.write
write_aloha, write_robomimic = hdf5.write_aloha, hdf5.write_robomimic
