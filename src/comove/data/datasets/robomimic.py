"""Episodes as one HDF5 file in robomimic's layout.

`obs/robot0_eef_pos`, `obs/robot1_eef_pos`, ... are the end effectors, planar ones at z = 0, `actions` the end
effectors at the next sample, and `obs/object` is their goal and the centres of the obstacles [m]. Of a robot there
are also `obs/robot0_eef_quat` (x y z w) and `obs/robot0_joint_pos`, and `actions` are the planned joints of all arms
at the next sample [rad]. Cameras are `obs/CAMERA_image`, RGB in bytes. The attribute `comove` of an episode is JSON
of all its other data.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from comove.data.datasets.samples import EpisodeSamples, require_alike
from comove.dmp.demonstrations.formats.hdf5 import put, put_pictures, robomimic_file, write_demo
from comove.dmp.demonstrations.samples import RecordedSamples
from comove.model.shapes import spatial


def write(path: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write a file; return the number of its episodes.

    Raises
    ------
    DemonstrationError
        If h5py is not installed.
    ResultError
        If the episodes differ in end effectors or obstacles.
    """
    count, first, data, total = 0, None, None, 0
    with robomimic_file(path) as root:
        for episode in episodes:
            first = first or episode
            require_alike(episode, first)
            if data is None:
                data = root(float(episode.rate))
            group = data.create_group(f"demo_{count}")
            write_demo(group, _hands(episode), None if episode.joints is None else episode.joints.wanted)
            if episode.joints is not None:
                for index, columns in enumerate(episode.joints.columns):
                    put(group, f"obs/robot{index}_joint_pos", episode.joints.measured[:, columns])
            put(group, "obs/object", episode.environment)
            for name, video in episode.videos.items():
                put_pictures(group, f"obs/{name}_image", video.pictures)
            group.attrs["comove"] = np.bytes_(json.dumps(episode.about, allow_nan=False))
            count, total = count + 1, total + len(episode.time)
            data.attrs["total"] = total
    return count


def _hands(episode: EpisodeSamples) -> list[RecordedSamples]:
    """Return the end effectors in space, a robot's with orientations."""
    position = spatial(episode.position)
    turned = None if episode.joints is None else episode.joints.orientation
    return [
        RecordedSamples(
            episode.time, position[:, hand], orientation=None if turned is None else turned[:, hand]
        )
        for hand in range(position.shape[1])
    ]
