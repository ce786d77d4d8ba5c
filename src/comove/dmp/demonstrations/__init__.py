"""Recordings of movements: reading, cleaning, cutting and writing.

A file becomes a :class:`Demonstration`, which is clean by construction: finite, starting at time zero, every instant
once. Its `notes` report every change that was made.
"""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.dmp.demonstrations.demonstration import Demonstration as Demonstration, segment as segment
    from comove.dmp.demonstrations.files import (
        lasa_names as lasa_names,
        read_csv as read_csv,
        read_hdf5 as read_hdf5,
        read_lerobot as read_lerobot,
        read_npz as read_npz,
        read_rosbag as read_rosbag,
        write as write,
        write_aloha as write_aloha,
        write_csv as write_csv,
        write_lerobot as write_lerobot,
        write_npz as write_npz,
        write_robomimic as write_robomimic,
        write_rosbag as write_rosbag,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "dmp.demonstrations.demonstration": ["Demonstration", "segment"],
        "dmp.demonstrations.files": [
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
        ],
    },
)
