"""Verified episodes as samples at an even rate, with column names."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from comove.arrays import Array
from comove.data.datasets.sizes import obstacle_names, obstacle_sizes, payload_size
from comove.data.episode import DAMAGED, restored, sample_times
from comove.data.runs import MEASURES, RUNS, StoredMotion, StudyRun, StudyStore
from comove.data.variety import passing_class
from comove.data.videos import Video
from comove.dmp.demonstrations.samples import AXES, QUATERNION
from comove.errors import OptionError, ResultError
from comove.geometry.rotations import matrices, same_hemisphere
from comove.model.coordinates import HandPoses, load_coordinates, poses_at
from comove.model.files.keys import canonical
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.results.sealed import checksum, finite
from comove.results.solution import motion_arrays
from comove.verification.bounds import largest_jerk, node_bounds
from comove.verification.verify import VerifiedMotion, verify

if TYPE_CHECKING:
    from comove.data.datasets.joints import EpisodeJoints
    from comove.data.generation import Study

LEAST_RATE, USUAL_RATE, LARGEST_RATE = 1, 50, 1000
"""Samples a second [Hz]."""


@dataclass(frozen=True, eq=False)
class EpisodeSamples:
    """Verified episode at an even rate, at rest in its last sample.

    Attributes
    ----------
    run : row of the episode in its run database, with measures of the motion verified again
    motion : the motion, verified again
    rate : samples a second [Hz]
    joints : joints of the robot at the same samples; None without one
    videos : videos of cameras, a picture at each sample, by camera name
    """

    run: StudyRun
    motion: VerifiedMotion
    rate: int
    joints: EpisodeJoints | None = None
    videos: Mapping[str, Video] = field(default_factory=dict)

    @property
    def scene(self) -> Scene:
        """Return the scene that was solved."""
        return self.motion.motion.scene

    @cached_property
    def time(self) -> Array:
        """Return the times of the samples; array, shape (n_steps,) [s]."""
        return sample_times(self.scene, self.rate)

    @cached_property
    def position(self) -> Array:
        """Return the end effectors, a robot's by its joints. Array, shape (n_steps, n_manipulators, n_dims) [m]."""
        if self.joints is not None:
            return self.joints.hands
        share = np.minimum(self.time / self.scene.duration, 1.0)
        return self.motion.motion.hands(share)[0]

    @cached_property
    def group_poses(self) -> HandPoses:
        """Return the poses of the rigid groups, a robot's by its joints. Arrays, shape (n_steps, ...)."""
        motion, scene, grasp = self.motion.motion, self.scene, self.scene.grasp
        if self.joints is None and motion.coordinates.kind == "load":
            return poses_at(motion.coordinates, motion.at(np.minimum(self.time / scene.duration, 1.0))[0])
        load = load_coordinates(scene)
        poses = poses_at(load, load.from_hands(self.position))
        if self.joints is None or grasp is None or not grasp.keypoints:
            return poses
        g = next(g for g, group in enumerate(scene.groups) if set(grasp.holders) <= set(group.members))
        group = scene.groups[g]  # two hands leave its roll open, but for their orientation
        hands, nodes = matrices(self.joints.orientation), scene.nodes_at("start")
        turns = grasp.payload_rotations(hands, nodes, group.start.rotation)
        middle = self.position[:, list(group.members)].mean(axis=1)
        poses.center[:, g] = middle - turns @ group.grasps.mean(axis=0)
        turned = Rotation.from_matrix(turns).as_quat(scalar_first=True)
        poses.quaternion[:, g] = same_hemisphere(turned)
        return poses

    @property
    def action(self) -> Array:
        """Return the end effectors at the next sample; array like `position` [m]. The last sample is repeated."""
        return np.concatenate([self.position[1:], self.position[-1:]])

    @property
    def state(self) -> Array:
        """Return a robot's joints, else the end effectors. Array, shape (n_steps, n_values) [rad or m]."""
        return self.position.reshape(len(self.time), -1) if self.joints is None else self.joints.measured

    @property
    def command(self) -> Array:
        """Return the commanded state of the next sample; array like `state`."""
        return self.action.reshape(len(self.time), -1) if self.joints is None else self.joints.wanted

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the values in `state`."""
        if self.joints is None:
            return self.hand_names
        return tuple(f"{name}.pos" for name in self.joints.names)

    @property
    def robot(self) -> str:
        """Return the name of the robot, "comove" without one."""
        return "comove" if self.joints is None else self.joints.robot

    @property
    def poses(self) -> tuple[tuple[str, ...], Array] | None:
        """Return names and values of a robot's end-effector poses. Values are positions and quaternions w x y z,
        shape (n_steps, n_values) [m]. Without a robot, return None: the end effectors are the state then."""
        if self.joints is None:
            return None
        names = tuple(f"{hand}_{axis}" for hand in self.scene.manipulators for axis in (*AXES, *QUATERNION))
        both = np.concatenate([self.joints.hands, self.joints.orientation], axis=2)
        return names, both.reshape(len(both), -1)

    @cached_property
    def environment(self) -> Array:
        """Return the goals, the obstacles' poses and sizes, and the payload. Array, shape (n_steps, n_values) [m];
        angles [rad], quaternions w x y z, mass [kg] (0 where it is not given), duration [s]. Every shape is
        described by the same values, so that studies may sample shapes too."""
        scene, n_steps = self.scene, len(self.time)
        centers = np.zeros((n_steps, 0))
        if scene.file.obstacles:
            centers = scene.centers_at(self.time)[..., : scene.n_dims].reshape(n_steps, -1)
        fixed = np.concatenate([payload_size(scene), [scene.load_mass or 0.0, scene.duration]])
        still = [np.tile(values, (n_steps, 1)) for values in (scene.goal.ravel(), fixed)]
        return np.concatenate([still[0], centers, *obstacle_sizes(scene, self.time), still[1]], axis=1)

    @cached_property
    def hand_names(self) -> tuple[str, ...]:
        """Return the names of the end effectors' coordinates."""
        axes = AXES[: self.scene.n_dims]
        return tuple(f"{hand}_{axis}" for hand in self.scene.manipulators for axis in axes)

    @cached_property
    def environment_names(self) -> tuple[str, ...]:
        """Return the names of the values in `environment`."""
        scene = self.scene
        axes = AXES[: scene.n_dims]
        names = obstacle_names(scene)
        turned = ("angle",) if scene.n_dims == 2 else QUATERNION
        measures = (*(f"size_{axis}" for axis in axes), *turned)
        return (
            *(f"goal_{name}" for name in self.hand_names),
            *(f"{name}_{axis}" for name in names for axis in axes),
            *(f"{name}_{measure}" for name in names for measure in measures),
            *(f"payload_size_{axis}" for axis in axes),
            "payload_mass",
            "duration",
        )

    @cached_property
    def about(self) -> dict[str, Any]:
        """Return the episode's scene, seed, checksums and certified figures."""
        figures = {name: getattr(self.run, name) for name in MEASURES}
        names = ("number", "seed", "scene", "scene_sha256", "motion_sha256", "passing")
        contents = {"scene_file": json.loads(canonical(self.scene.file))}
        robot = {} if self.joints is None else {"joints": dict(self.joints.figures)}
        return {name: getattr(self.run, name) for name in names} | figures | robot | contents


def episodes_of(
    folder: Path, scenes: Path, rate: int | None = None, study: Study | None = None
) -> Iterator[EpisodeSamples]:
    """Yield the verified episodes of a study, verified again, in order.

    Their figures are those of this verification, not those of the run database.

    Parameters
    ----------
    folder : folder of the study
    scenes : folder to which paths in the scenes are relative
    rate : samples a second [Hz]; by `chosen_rate` unless given
    study : the study, whose scenes are sampled again and must equal those of the run database; that of the database
        unless given

    Raises
    ------
    ResultError
        If there is no study or no verified episode, a motion was damaged or fails the verification, a motion or scene
        differs from the run database or the study, or a robot's simulation does not deliver its payload any more.
    OptionError
        If the rate is out of range, or not that of the cameras.
    """
    store = StudyStore.open(folder / RUNS)
    described = (store.description() if study is None else study.described) or {}
    found, simulate, cameras = False, described.get("simulate"), described.get("cameras")
    rate = chosen_rate(rate, cameras)
    for run, kept in store.motions():
        verified = _verified(restored(kept, scenes, store.path), run, store.path, study)
        run = replace(run, **_figures(verified))
        joints = None
        if verified.motion.scene.file.robot is not None and kept.carry is None:
            raise ResultError(f"episode {run.number} has no joints", file=store.path, way_out=DAMAGED)
        if kept.carry is not None:
            from comove.data.datasets.joints import joint_samples

            time = sample_times(verified.motion.scene, rate)
            joints = joint_samples(run, kept.carry, verified, time, simulate, store.path)
        yield EpisodeSamples(run, verified, rate, joints, _videos(run, kept, cameras, store.path))
        found = True
    if not found:
        raise ResultError("it holds no verified episode", file=store.path, way_out="run the study first")


def chosen_rate(rate: int | None, cameras: Mapping[str, Any] | None) -> int:
    """Return a dataset's samples a second. It is `rate`, else that of the cameras, else `USUAL_RATE`.

    Parameters
    ----------
    cameras : settings of the study's cameras; None without them
    """
    taken = None if cameras is None else cameras["rate"]
    if rate is None:
        return taken or USUAL_RATE
    if not LEAST_RATE <= rate <= LARGEST_RATE:
        raise OptionError(
            f"rate = {rate}", key="--rate", way_out=f"give {LEAST_RATE} to {LARGEST_RATE} samples a second"
        )
    if taken is not None and rate != taken:
        raise OptionError(
            f"rate = {rate}, and the cameras of the study take {taken} pictures a second",
            key="--rate",
            way_out=f"leave it out, or write rate: {rate} in the study's cameras before it is run",
        )
    return rate


def _videos(
    run: StudyRun, kept: StoredMotion, cameras: Mapping[str, Any] | None, store: Path
) -> dict[str, Video]:
    """Return the videos of an episode, by the cameras' names."""
    taken = dict(kept.videos)
    views = () if cameras is None else tuple(cameras["views"])
    missing = next((name for name in views if name not in taken), None)
    if missing is not None:
        raise ResultError(
            f"episode {run.number} has no video of the camera '{missing}'", file=store, way_out=DAMAGED
        )
    return {name: Video(taken[name], f"the video '{name}' of episode {run.number}", store) for name in views}


def _verified(
    motion: CoordinatedMotion, run: StudyRun, file: Path, study: Study | None = None
) -> VerifiedMotion:
    """Verify an episode's motion again, and check its checksums."""
    verdict = verify(motion)
    if verdict.verified is None:
        raise ResultError(
            f"the motion of episode {run.number} does not stand the check any more: {verdict.reasons[0]}",
            file=file,
            way_out=DAMAGED,
        )
    right = {"motion_sha256": checksum(motion_arrays(motion)), "scene_sha256": motion.scene.sha256}
    for key, own in right.items():
        if getattr(run, key) != own:
            raise ResultError(
                f"the {key.partition('_')[0]} of episode {run.number} is not that of its row: its checksum differs",
                file=file,
                way_out=DAMAGED,
            )
    if study is not None:
        drawn = study.draw(run.number).scene if run.key == study.key(run.number) else None
        if drawn is None or motion.scene.sha256 not in {
            choice.sha256 for choice in _solved_on(drawn, motion)
        }:
            raise ResultError(
                f"the scene of episode {run.number} is not the one that the study draws",
                file=file,
                way_out=DAMAGED,
            )
    return verdict.verified


def _solved_on(drawn: Scene, motion: CoordinatedMotion) -> Iterator[Scene]:
    """Yield the scenes that a solution of a sampled scene may have. The solution's duration and payload goal fill in
    what the sampled scene leaves open."""
    hasty = drawn.file.objective is not None and drawn.file.objective.type == "least_time"
    if hasty or not drawn.is_timed:
        drawn = drawn.with_limits().timed(motion.scene.duration)
    load = motion.scene.file.load
    yield from (drawn, *drawn.ways_to(None if load is None else load.goal))


def _figures(verified: VerifiedMotion) -> dict[str, Any]:
    """Return the certified measures of a motion, by column name."""
    motion, report = verified.motion, verified.report
    measures = ("clearance_min", "distance_error_max", "end_error", "speed_max", "acceleration_max")
    return {
        "scene": motion.scene.name,
        "duration": motion.scene.duration,
        "jerk_max": finite(largest_jerk(motion, node_bounds(motion).jerk)),
        "passing": passing_class(motion),
        **{name: finite(getattr(report, name)) for name in measures},
    }


def require_alike(episode: EpisodeSamples, first: EpisodeSamples) -> None:
    """Refuse an episode whose columns differ from those of the first."""
    for one, other in (
        (episode.state_names, first.state_names),
        (episode.environment_names, first.environment_names),
    ):
        if one != other:
            raise ResultError(
                f"episode {episode.run.number} has {len(one)} values ({', '.join(one[:4])}, ...), and episode "
                f"{first.run.number} has {len(other)}",
                file=episode.scene.name,
                way_out="let all episodes have the same robot, hands and obstacles, or export as npz or mcap",
            )
