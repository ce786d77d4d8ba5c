"""Scenes with sampled states over time and verification results.

Motions, robots, runs and simulations are sampled for display in one class, which the workbench and pages of their
own show alike. The contents of folders are verified again from their files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import ComoveError, ExtraError
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning import Solution
from comove.results.reference import SCENE
from comove.results.solution import StoredResult
from comove.stored import ResultPart, Row, Verification, joint_rows, motion_rows, verify_part
from comove.verification.certificate import Clearance, certify
from comove.verification.record import Record, clearance_of, verify_execution
from comove.verification.verify import Report, VerifiedMotion, verify
from comove.view.workbench.bodies import poses_of, robot_of
from comove.view.workbench.shelf import Item, parts_of, read_scene

if TYPE_CHECKING:
    from comove.robots import JointMotion, JointReport, Robot
    from comove.sim.live_record import OnlineRecord


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """States and measures of a motion at even times. Proved measures are in its report, not here.

    Attributes
    ----------
    time : array, shape (n_steps,) [s]
    nodes : array, shape (n_steps, n_nodes, 3), end effectors first, then corners of the payload [m]
    offsets : array, shape (n_steps, n_obstacles, 3), of the obstacles' centres from their positions at 0 s [m]
    speed, acceleration : arrays, shape (n_steps, n_manipulators) [m/s], [m/s^2]
    clearance : array, shape (n_steps,), of payload and end effectors from obstacles and border, inf without any [m]
    error : array, shape (n_steps,), error of the worst constraint as a share of its tolerance
    links : array, shape (n_steps, n_joints, 7), poses of a robot's joints, x y z [m] and w x y z; no joints without
    tightest : array, shape (2,), time of the least clearance [s], and number of the nearest obstacle, -1: the border
    """

    time: Array
    nodes: Array
    offsets: Array
    speed: Array
    acceleration: Array
    clearance: Array
    error: Array
    links: Array
    tightest: Array

    @cached_property
    def moved(self) -> NDArray[np.bool_]:
        """Return which obstacles move; array of bool, shape (n_obstacles,)."""
        return np.asarray(self.offsets.any(axis=(0, 2)))

    @classmethod
    def of(cls, motion: CoordinatedMotion) -> RecordedMotion:
        """Sample a motion, with the tightest instant of its certificate."""
        scene, duration = motion.scene, motion.scene.duration
        s = np.linspace(0.0, 1.0, _n_states(duration))
        states = motion.coordinates.motion(motion.at(s))
        _, velocity, acceleration = states[:, :, : len(scene.manipulators)]
        return cls.of_states(
            scene,
            s * duration,
            np.ascontiguousarray(states[0]),
            velocity / duration,
            acceleration / duration**2,
            certificate=certify(motion),
        )

    @classmethod
    def of_run(cls, record: Record) -> RecordedMotion:
        """Sample an execution, with velocities averaged over its steps."""
        scene, hands = record.scene, record.nodes[:, : len(record.scene.manipulators)]
        n_states = _n_states(float(record.time[-1]))
        steps = np.unique(np.linspace(0, len(record.time) - 1, n_states).round().astype(int))
        period = np.diff(record.time)[:, None, None]
        velocity = np.diff(hands, axis=0, prepend=hands[:1])
        velocity[1:] /= period
        acceleration = np.diff(velocity, axis=0, append=velocity[-1:])
        acceleration[:-1] /= period
        return cls.of_states(
            scene,
            record.time[steps],
            np.ascontiguousarray(record.nodes[steps]),
            velocity[steps],
            acceleration[steps],
            offsets=record.obstacles[steps] - scene.centers,
            certificate=clearance_of(record),
        )

    @classmethod
    def of_states(
        cls,
        scene: Scene,
        time: Array,
        nodes: Array,
        velocity: Array,
        acceleration: Array,
        *,
        offsets: Array | None = None,
        links: Array | None = None,
        certificate: Clearance | None = None,
    ) -> RecordedMotion:
        """Return a recording of given states.

        Parameters
        ----------
        time, nodes, links : as the attributes
        velocity, acceleration : arrays, shape (n_steps, n_manipulators, 3) [m/s], [m/s^2]
        offsets : as the attribute; those of the scene's obstacles unless given
        certificate : certificate with the tightest instant; that of the states unless given
        """
        clearance = scene.clearances(nodes, time)
        if certificate is None:
            step = int(clearance.argmin())
            tightest = float(time[step]), scene.nearest_at(nodes[step], float(time[step]))[1]
        else:
            tightest = certificate.time, certificate.nearest
        return cls(
            time=time,
            nodes=nodes,
            offsets=scene.offsets(time) if offsets is None else offsets,
            speed=np.linalg.norm(velocity, axis=2),
            acceleration=np.linalg.norm(acceleration, axis=2),
            clearance=clearance,
            error=_errors(scene, nodes),
            links=np.zeros((len(time), 0, 7)) if links is None else links,
            tightest=np.array(tightest, dtype=float),
        )

    def index_at(self, time: float) -> int:
        """Return the number of the state nearest to an instant [s]."""
        return int(np.abs(self.time - time).argmin())

    @property
    def center(self) -> Array:
        """Return the end effectors' centre; array, shape (n_steps, 3) [m]."""
        return self.nodes[:, : self.speed.shape[1]].mean(axis=1)


def _n_states(duration: float, rate: float = 25.0, fewest: int = 61, most: int = 301) -> int:
    """Return the bounded number of states at `rate` [Hz]."""
    return int(np.clip(round(duration * rate) + 1, fewest, most))


def _errors(scene: Scene, nodes: Array) -> Array:
    """Return the worst constraint's error as a share of its tolerance. Array, shape (n_steps,)."""
    hands = nodes[:, : len(scene.manipulators)]
    # 1e-12 m or rad in place of a tolerance of 0
    shares = [c.error(hands, scene.n_dims) / max(c.allowed, 1e-12) for c in scene.constraints]
    return np.maximum(np.max(shares, axis=0), 0.0) if shares else np.zeros(len(nodes))


@dataclass(frozen=True)
class Touch:
    """Unwanted contact.

    Attributes
    ----------
    time : of the first contact [s]
    obstacle : number of the obstacle, -1 for something else
    words : names of the two bodies
    """

    time: float
    obstacle: int
    words: str


@dataclass(frozen=True, eq=False)
class Playback:
    """Recording for playback.

    Attributes
    ----------
    scene : the scene
    verdict : verification result, such as "verified at every instant"
    holds : whether the verification succeeded
    recording : states over time; None for a scene alone
    rows : measures: name, value, and requirement
    reasons : reasons why the verification failed
    robot : robot that holds the payload, None for end effectors alone
    touches : contacts of a simulation
    proved : whether the measures are proved, and not only measured
    against : scene and robot of the verification of a stored result, in words
    """

    scene: Scene
    verdict: str
    holds: bool = True
    recording: RecordedMotion | None = None
    rows: tuple[Row, ...] = ()
    reasons: tuple[str, ...] = ()
    robot: Robot | None = None
    touches: tuple[Touch, ...] = ()
    proved: bool = True
    against: tuple[str, ...] = ()

    @property
    def told(self) -> str:
        """Return the verification result, in capitals if negative."""
        return self.verdict if self.holds else self.verdict.upper()


def playback_of_scene(scene: Scene) -> Playback:
    """Return a scene alone, with its robot at home if installed."""
    try:
        robot = robot_of(scene)
    except ComoveError as error:
        return Playback(scene, "no motion yet", reasons=(str(error),))
    return Playback(scene, "no motion yet", robot=robot)


def playback_of_motion(motion: CoordinatedMotion, report: Report, reasons: tuple[str, ...] = ()) -> Playback:
    """Return an end-effector motion with measures and verification reasons."""
    rows = motion_rows({**report.asdict(), "duration": motion.scene.duration}, motion.scene)
    recording = RecordedMotion.of(motion)
    return Playback(motion.scene, _verdict(reasons), not reasons, recording, tuple(rows), tuple(reasons))


def _verdict(reasons: tuple[str, ...]) -> str:
    return "not verified" if reasons else "verified at every instant"


def playback_of_run(record: Record, blocker: str = "") -> Playback:
    """Return an execution, verified with its obstacles' true motions."""
    report = verify_execution(record, blocker)
    verdict = "not verified" if report.reasons else "executed, and verified at every instant"
    rows = motion_rows({**report.asdict(), "duration": float(record.time[-1])}, record.scene)
    recording = RecordedMotion.of_run(record)
    return Playback(record.scene, verdict, not report.reasons, recording, tuple(rows), report.reasons)


def playback_of_joints(
    robot: Robot,
    motion: CoordinatedMotion,
    joints: JointMotion,
    report: JointReport,
    reasons: tuple[str, ...] = (),
) -> Playback:
    """Return a robot's motion with end-effector and joint measures."""
    recording = RecordedMotion.of(motion)
    recording = replace(recording, links=poses_of(robot, joints.at(recording.time)[0]))
    hands = verify(motion).report.asdict()
    rows = motion_rows({**hands, "duration": motion.scene.duration}, motion.scene)
    rows += joint_rows(vars(report))
    return Playback(motion.scene, _verdict(reasons), not reasons, recording, tuple(rows), reasons, robot)


def verification_of(folder: Path, part: ResultPart, scene: Path) -> Verification:
    """Verify a part of a result folder again, against a scene file.

    Raises
    ------
    ResultError
        If it cannot be read.
    ExtraError
        If it needs what is not installed.
    """
    return verify_part(folder, part, None if scene == folder / SCENE else read_scene(scene))


def playback_of_item(item: Item) -> Playback:
    """Return a scene, or a verified part of a result folder. The errors are those of `verification_of`."""
    if item.result is None:
        return playback_of_scene(read_scene(item.scene))
    return playback_of_verification(verification_of(item.result, item.part, item.scene))


def playback_of(thing: Any) -> Playback:
    """Return the playback of a scene, solution, motion, execution, or folder.

    Raises
    ------
    TypeError
        If it is none of these.
    """
    if isinstance(thing, (str, Path)):
        path = Path(thing)
        item = Item(path / SCENE, path, parts_of(path)[0]) if path.is_dir() else Item(path)
        return playback_of_item(item)
    if isinstance(thing, StoredResult):
        return playback_of_item(Item(thing.folder / SCENE, thing.folder, parts_of(thing.folder)[0]))
    if isinstance(thing, Scene):
        return playback_of_scene(thing)
    if isinstance(thing, Solution):
        if (joints := thing.joints) is None:
            return playback_of_motion(thing.attempt, thing.report, thing.reasons)
        reasons = tuple(dict.fromkeys([*thing.reasons, *joints.verdict.reasons]))
        return playback_of_joints(joints.robot, thing.attempt, joints.attempt, joints.report, reasons)
    if isinstance(thing, VerifiedMotion):
        return playback_of_motion(thing.motion, thing.report)
    if isinstance(thing, CoordinatedMotion):
        verdict = verify(thing)
        return playback_of_motion(thing, verdict.report, verdict.reasons)
    if isinstance(thing, Record):
        return playback_of_run(thing)
    return _of_robot(thing)


def _of_robot(thing: Any) -> Playback:
    try:
        from comove.robots import VerifiedJointMotion
    except ExtraError:
        VerifiedJointMotion = ()  # type: ignore[assignment,misc]  # of which nothing is one
    if isinstance(thing, VerifiedJointMotion):
        return playback_of_joints(thing.robot, thing.motion.motion, thing.joints, thing.report)
    raise TypeError(
        f"a {type(thing).__name__} cannot be shown: give a scene, a solution, a motion, an execution or a folder"
    )


def playback_of_verification(checked: Verification) -> Playback:
    """Return a part of a result folder with its verification."""
    verdict = _VERDICTS[checked.part][checked.verified]
    if checked.verified and checked.is_hands_alone:
        verdict += ", the hands alone"
    recording: RecordedMotion | None = None
    touches: tuple[Touch, ...] = ()
    reasons, scene = checked.reasons, checked.scene
    if checked.record is not None:
        recording = RecordedMotion.of_run(checked.record)
    elif checked.series is not None and checked.motion is not None and checked.robot is not None:
        summary = checked.summary
        recording = _simulated(checked.robot, checked.motion, checked.series)
        reasons = (*reasons, *summary["reasons"])
        touches = tuple(_touch(scene, contact) for contact in summary["contacts"])
        verdict = verdict if not summary["reasons"] else "simulated, and not delivered"
    elif checked.motion is not None:
        recording = RecordedMotion.of(checked.motion)
        if checked.robot is not None and checked.joints is not None:
            links = poses_of(checked.robot, checked.joints.at(recording.time)[0])
            recording = replace(recording, links=links)
    elif checked.online is not None:
        recording = _of_online(checked.online)
    return Playback(
        scene,
        verdict,
        not reasons,
        recording,
        checked.rows,
        reasons,
        checked.robot,
        touches,
        proved=checked.is_proof,
        against=checked.against,
    )


def _of_online(record: OnlineRecord) -> RecordedMotion:
    """Return the states of a robot's online run, as measured. Velocities are averages over steps."""
    time = np.array(record.time)
    steps = np.unique(np.linspace(0, len(time) - 1, _n_states(float(time[-1]))).round().astype(int))
    nodes = np.array(record.nodes)[steps]
    hands = nodes[:, : len(record.scene.manipulators)]
    velocity = np.gradient(hands, time[steps], axis=0)
    return RecordedMotion.of_states(
        record.scene,
        time[steps],
        np.ascontiguousarray(nodes),
        velocity,
        np.gradient(velocity, time[steps], axis=0),
        links=poses_of(record.robot, np.array(record.measured)[steps]),
    )


def _simulated(robot: Robot, motion: CoordinatedMotion, arrays: Mapping[str, Array]) -> RecordedMotion:
    """Return a simulation's states at the planned times and afterwards."""
    planned, scene = RecordedMotion.of(motion), motion.scene
    after = np.arange(planned.time[-1], float(arrays["time"][-1]), planned.time[1])[1:]
    time = np.concatenate([planned.time, after])
    steps = np.abs(arrays["time"][:, None] - time).argmin(axis=0)
    nodes = np.concatenate([planned.nodes, np.repeat(planned.nodes[-1:], len(after), axis=0)])
    hands = arrays["hands"][steps, :, :3, 3]
    pose = arrays["load_pose"][steps]
    if np.isfinite(pose).all():
        at_start = (planned.nodes[0] - pose[0, :3, 3]) @ pose[0, :3, :3]
        nodes = np.einsum("tij,nj->tni", pose[:, :3, :3], at_start) + pose[:, None, :3, 3]
    nodes[:, : hands.shape[1]] = hands
    velocity = np.gradient(hands, time, axis=0)
    acceleration = np.gradient(velocity, time, axis=0)
    links = poses_of(robot, arrays["joints"][steps])
    return RecordedMotion.of_states(scene, time, nodes, velocity, acceleration, links=links)


def _touch(scene: Scene, contact: Mapping[str, Any]) -> Touch:
    """Return a contact of a simulation's summary."""
    names = [scene.name_of(number) for number in range(len(scene.file.obstacles))]
    found = [names.index(name) for name in contact["between"] if name in names]
    first, second = contact["between"]
    words = (
        f"{first} touched {second} at {contact['time']:.2f} s, {1e3 * contact['depth']:.1f} mm deep at most"
    )
    return Touch(float(contact["time"]), found[0] if found else -1, words)


_VERDICTS = {
    ResultPart.MOTION: ("not verified", "verified at every instant"),
    ResultPart.JOINTS: ("not verified", "verified at every instant"),
    ResultPart.RUN: ("not verified", "executed, and verified at every instant"),
    ResultPart.ROBOT_RUN: ("not as it should be", "run, and as it should be at samples"),
    ResultPart.SIMULATION: ("not verified", "simulated, and delivered"),
}
"""What is said of a part that is not verified, and of one that is."""
