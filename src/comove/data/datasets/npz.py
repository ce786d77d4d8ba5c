"""Episodes as NumPy archives, one a file."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from comove.data.datasets.samples import EpisodeSamples
from comove.data.episode import packed


def write(folder: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write `episode_NUMBER.npz` for every episode; return their number.

    The arrays are ``time (T,)`` [s], ``manipulators (N,)``, ``position`` and ``action (T, N, n_dims)`` [m],
    ``environment (T, K)`` [m] with ``environment_names (K,)``, and ``about``, JSON: scene, seed, checksums and
    certified figures. Of a robot there are also ``joint_names (J,)``, ``joint_position`` and ``joint_action (T, J)``
    [rad or m], and ``orientation (T, N, 4)``, the end effectors' quaternions w x y z; of cameras ``CAMERA_image (T,
    height, width, 3)``.
    """
    count = 0
    for episode in episodes:
        arrays = {
            "time": episode.time,
            "manipulators": np.array(episode.scene.manipulators),
            "position": episode.position,
            "action": episode.action,
            "environment": episode.environment,
            "environment_names": np.array(episode.environment_names),
            "about": np.array(json.dumps(episode.about, allow_nan=False)),
        }
        if (joints := episode.joints) is not None:
            arrays |= {
                "joint_names": np.array(joints.names),
                "joint_position": joints.measured,
                "joint_action": joints.wanted,
                "orientation": joints.orientation,
            }
        arrays |= {f"{name}_image": video.pictures for name, video in episode.videos.items()}
        (folder / f"episode_{episode.run.number:06d}.npz").write_bytes(packed(arrays))
        count += 1
    return count
