"""Episodes as MCAP files with ROS 2 messages, one file each.

ROS, Foxglove and comove read them.

| topic | type | content |
|---|---|---|
| ``/HAND/point`` | PointStamped | an end effector, planar ones at z = 0 [m] |
| ``/load/pose`` | PoseStamped | the payload's frame; ``/load1``, ... where end effectors move as several bodies [m] |
| ``/NAME/point`` | PointStamped | centre of an obstacle by its name, of others ``/obstacle0/point``, ... [m] |
| ``/CAMERA/image/compressed`` | CompressedImage | picture of a camera, as JPEG |
| ``/comove/about`` | String | JSON: scene, seed, checksums and certified figures |
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from comove.data.datasets.samples import EpisodeSamples
from comove.data.datasets.sizes import obstacle_names
from comove.dmp.demonstrations.formats import rosbag
from comove.dmp.demonstrations.samples import RecordedSamples
from comove.errors import ResultError
from comove.model.shapes import spatial


def write(folder: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write `episode_NUMBER.mcap` for every episode; return their number.

    Raises
    ------
    DemonstrationError
        If rosbags is not installed.
    ResultError
        If the name of an end effector is no name in ROS, or that of another topic.
    """
    count = 0
    for episode in episodes:
        path = folder / f"episode_{episode.run.number:06d}.mcap"
        movements: dict[str, RecordedSamples] = {}
        for name, movement in movements_of(episode):
            if name in movements or not rosbag.NAME.fullmatch(name):
                raise ResultError(
                    f"the hand '{name}' cannot be a topic of ROS beside the load and the obstacles",
                    file=episode.scene.name,
                    way_out="give it another name of letters, digits and underscores, or export as npz",
                )
            movements[name] = movement
        images = {name: (episode.time, _jpegs(name, episode)) for name in episode.videos}
        rosbag.write(path, movements, about=json.dumps(episode.about, allow_nan=False), images=images)
        count += 1
    return count


def _jpegs(name: str, episode: EpisodeSamples, quality: int = 92) -> list[bytes]:
    """Return a camera's pictures as JPEG files, one a sample."""
    from PIL import Image

    files = []
    for picture in episode.videos[name].pictures:
        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="JPEG", quality=quality)
        files.append(file.getvalue())
    return files


def movements_of(episode: EpisodeSamples) -> Iterator[tuple[str, RecordedSamples]]:
    """Yield names and movements of end effectors, held bodies and obstacles."""
    scene, time, position = episode.scene, episode.time, spatial(episode.position)
    for hand, name in enumerate(scene.manipulators):
        yield name, RecordedSamples(time, position[:, hand])
    poses = episode.group_poses
    bodies = [g for g, group in enumerate(scene.groups) if len(group.members) > 1]
    loads = [f"load{number or ''}" for number in range(len(bodies))]
    for name, g in zip(loads, bodies, strict=True):
        yield name, RecordedSamples(time, poses.center[:, g], orientation=poses.quaternion[:, g])
    centers, taken = scene.centers_at(time), {*scene.manipulators, *loads}
    turned = scene.orientations(time)
    for i, name in enumerate(obstacle_names(scene)):
        is_topic = rosbag.NAME.fullmatch(name) and name not in taken
        orientation = turned[:, i] if scene.turning[i] else None
        movement = RecordedSamples(time, centers[:, i], orientation=orientation)
        yield name if is_topic else f"obstacle{i}", movement
