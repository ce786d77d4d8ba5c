"""LeRobot's own reading of a study's datasets, compared with the study.

    python benchmarks/lerobot_loads.py DIR

It runs in an environment that has lerobot and need not have comove: 0.4 reads DIR/lerobot, 0.3 DIR/lerobot-2.1. DIR
is the folder of a study, with the dataset and with DIR/npz, which every frame is compared with.
"""

from __future__ import annotations

import argparse
from importlib.metadata import version
from pathlib import Path

import numpy as np

STATES = ("observation.state", "action")


def main(folder: Path) -> None:
    """Read every frame, compare it, and print the greatest differences."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    old = version("lerobot") < "0.4"
    root = folder / ("lerobot-2.1" if old else "lerobot")
    dataset = LeRobotDataset("comove/study", root=root, video_backend="pyav")
    archives = [np.load(path) for path in sorted((folder / "npz").glob("*.npz"))]
    assert dataset.num_episodes == len(archives)
    assert len(dataset) == sum(len(archive["time"]) for archive in archives)
    cameras = [key.removeprefix("observation.images.") for key in dataset.meta.camera_keys]
    apart = dict.fromkeys((*STATES, *cameras), 0.0)
    for i in range(len(dataset)):
        frame = dataset[i]
        archive, row = archives[int(frame["episode_index"])], int(frame["frame_index"])
        names = ("joint_position", "joint_action") if "joint_names" in archive else ("position", "action")
        for key, name in zip(STATES, names, strict=True):
            apart[key] = max(apart[key], float(np.abs(frame[key].numpy() - archive[name][row].ravel()).max()))
        for camera in cameras:
            seen = 255.0 * frame[f"observation.images.{camera}"].numpy().transpose(1, 2, 0)
            wrong = float(np.abs(seen - archive[f"{camera}_image"][row]).mean())
            apart[camera] = max(apart[camera], wrong)
    print(f"lerobot {version('lerobot')} reads {len(archives)} episodes of {root}, {len(dataset)} frames")
    for key, value in apart.items():
        what = "levels of 255, mean of the worst picture" if key in cameras else "at most"
        print(f"  {key:22s} differs by {value:.2g} {what}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the study")
    main(parser.parse_args().folder)
