"""Options shared by several verbs, and the objects that they name."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli.app import WITH_ROBOT, requires_robot
from comove.cli.app import RunLimits as RunLimits
from comove.cli.app import SceneLimits as SceneLimits
from comove.errors import InputError, OptionError, ResultError, RobotError, near_name
from comove.methods import METHODS

if TYPE_CHECKING:
    from comove.dmp import DMP, Library, PoseDMP, ProMP
    from comove.model import Scene
    from comove.planning.method import Method
    from comove.planning.objectives import Criterion
    from comove.robots import Robot, VerifiedJointMotion
    from comove.robots.present import Joints

PICTURES = (".png", ".pdf", ".svg")

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")]
ResultFolder = Annotated[Path, typer.Option("--out", help="Folder for the result.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]
Budget = Annotated[
    float,
    typer.Option(
        help="Seconds of processor time after which the search takes the best so far; "
        "reading, compiling, drawing and saving do not count."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print solution.json and nothing else.")]


RobotName = Annotated[
    str | None,
    typer.Option(
        "--robot",
        help="The robot whose joints carry it out: a bundled one's name, or a description (YAML); what SCENE says "
        "unless given.",
    ),
]
HandsAlone = Annotated[
    bool,
    typer.Option(
        "--hands-alone",
        help="Look at the hands alone, though SCENE names a robot: no joint is verified, and none moves.",
    ),
]
JointFolder = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result folder of `comove solve` of a scene with a robot.")
]
CARRY = "carry"
"""The motion with the payload, among those that are exported and sent."""


class EffortMode(StrEnum):
    """Levels of effort, named as in `planning.effort.EFFORTS`."""

    quick = "quick"
    normal = "normal"
    thorough = "thorough"


ACTION: dict[str, Any] = {
    "metavar": "NAME",
    "help": "FollowJointTrajectory action of each {arm}, or one for all arms; as the robot's description says unless "
    "given, else /{arm}_controller/follow_joint_trajectory, in ROS 1 Baxter's.",
}
JOINT_STATES: dict[str, Any] = {
    "metavar": "TOPIC",
    "help": "Topic of the joint states; as the robot's description says unless given, else /joint_states, in ROS 1 "
    "Baxter's.",
}
SCENE_TOPIC: dict[str, Any] = {
    "metavar": "TOPIC",
    "help": "Topic of planning scenes; the service /get_planning_scene is asked as well.",
}
PRESENT: dict[str, Any] = {
    "metavar": "FILE",
    "help": "Where the robot's joints are now, before it approaches (YAML or JSON: {joint: value}, or a JointState "
    "of ROS) [rad, m]; home unless given.",
}
PresentFile = Annotated[Path | None, typer.Option("--present", **PRESENT)]


@dataclass(frozen=True)
class ApproachOptions:
    """Options of a robot's approach to the payload, and its release."""

    present: Annotated[Path | None, typer.Option("--present", rich_help_panel=WITH_ROBOT, **PRESENT)] = None
    transfers: Annotated[
        bool,
        typer.Option(
            "--transfers",
            rich_help_panel=WITH_ROBOT,
            help="Both --approach and --release.",
            show_default=False,
        ),
    ] = False
    approach: Annotated[
        bool,
        typer.Option(
            "--approach",
            rich_help_panel=WITH_ROBOT,
            help="Hold the payload at the start with joints that can be approached from the present ones.",
        ),
    ] = False
    release: Annotated[
        bool,
        typer.Option(
            "--release",
            rich_help_panel=WITH_ROBOT,
            help="Hold it at the goal with joints from which there is a way home.",
        ),
    ] = False

    def wanted(self, robot: Robot) -> dict[str, Any]:
        """Return the equivalent arguments of `comove.solve`."""
        from comove.robots.present import read_present

        return {
            "present": None if self.present is None else read_present(self.present, robot),
            "approach": self.approach or self.transfers,
            "release": self.release or self.transfers,
        }


def require_approach(present: Path | None, approach: bool) -> None:
    """Refuse present joints where no approach starts at them."""
    if present is not None and not approach:
        raise OptionError(
            "no approach is asked for, which would begin there", key="--present", way_out="leave it out"
        )


def present_in(folder: Path, motion: VerifiedJointMotion, file: Path | None) -> Joints | None:
    """Return the approach's start joints, from the file or the folder."""
    from comove.robots.present import read_present, stored_present

    return stored_present(folder, motion.robot) if file is None else read_present(file, motion.robot)


@dataclass(frozen=True)
class Trusted:
    """Options of the trusted scene and robot for verifying a motion."""

    scene: Annotated[
        Path | None, typer.Option(help="Scene file that you trust; the folder's own scene unless given.")
    ] = None
    robot: Annotated[
        str | None,
        typer.Option(
            help="Robot that you trust: a bundled one's name, or a description; the scene's unless given."
        ),
    ] = None

    def verified(self, folder: Path) -> VerifiedJointMotion:
        """Verify and return the joint motion in a folder; print its references."""
        from comove.cli.texts import say
        from comove.io.folders import require_folder
        from comove.model import Scene
        from comove.stored import ResultPart, parts_of

        solved = "comove solve SCENE --robot NAME --out DIR"
        if ResultPart.JOINTS not in parts_of(require_folder(folder, solved)):
            raise ResultError(
                "no robot's joints move in it", file=folder, way_out=f"solve its scene with a robot: {solved}"
            )
        from comove.robots.files import verified_against

        scene = None if self.scene is None else Scene.load(self.scene)
        motion, (against, robot) = verified_against(folder, scene=scene, robot=self.robot)
        say(f"verified against {against}, {robot}", file=sys.stderr)
        return motion


def require_defaults(options: Any, what: str, way_out: str) -> None:
    """Refuse the first option of a group that was given."""
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise OptionError(what, key="--" + field.name.replace("_", "-"), way_out=way_out)


def names_robot(scene: Scene, robot: str | None, hands_alone: bool) -> bool:
    """Return whether joints are planned, as scene or command name a robot."""
    if requires_robot():
        return True
    if hands_alone and robot is not None:
        raise OptionError("a robot, and the hands alone", key="--hands-alone", way_out="give one of the two")
    return not hands_alone and (robot is not None or scene.file.robot is not None)


def require_carried(robot: Robot, loaded: Scene, scene: Path) -> None:
    """Refuse a scene without a payload that this robot can carry."""
    from comove.robots.solving import require_carried

    try:
        require_carried(robot, loaded)
    except InputError as error:
        error.file = error.file or scene
        raise


def robot_named(name: str | None, scene: Scene, file: Path) -> tuple[Robot, str | Path]:
    """Return the robot of command line or scene, and its description."""
    from comove.robots import Robot, bundled_robots, find_description

    named = name if name is not None else scene.file.robot
    if named is None:
        raise RobotError(
            "neither the scene nor the command names a robot",
            file=file,
            key="robot",
            way_out=f"add robot: NAME to the scene or give --robot; bundled: {', '.join(bundled_robots())}",
        )
    try:
        path = find_description(named, None if name is not None else file.parent)
    except RobotError as error:
        error.file, error.key = (file, "robot") if name is None else (error.file, "--robot")
        raise
    return Robot.load(path), named if named in bundled_robots() else path


def require_one_of(name: str, known: Sequence[str], what: str) -> None:
    """Refuse an unknown name for the option `what`."""
    if name not in known:
        raise OptionError(f"unknown {what} '{name}'", key=f"--{what}", way_out=near_name(name, known))


def check_budget(budget: float) -> None:
    """Raise if a budget is not a positive, finite time."""
    if not 0 < budget < float("inf"):
        raise OptionError(f"budget = {budget}", key="--budget", way_out="give a positive number of seconds")


def method_named(name: str, known: Sequence[str] = tuple(METHODS)) -> Method:
    """Return the method with the given name, one of those `known`."""
    require_one_of(name, known, "method")
    method: Method = METHODS[name].kind()
    return method


def objective_of(
    name: str | None, resemblance: float | None, weights: str | None, scene: Scene, smooth: bool
) -> Criterion | None:
    """Return the objective named by the command line or the scene. Return None where `solve` shall choose.

    Parameters
    ----------
    smooth : whether the method finds smooth motions; otherwise smooth objectives of the scene are ignored
    """
    from comove.planning import LeastJerk, PaperCost
    from comove.planning.objectives import OBJECTIVES, objective_of_scene

    kinds = {name.replace("_", "-"): kind for name, kind in OBJECTIVES.items()}
    if name is not None:
        require_one_of(name, tuple(kinds), "objective")
    said: Any = objective_of_scene(scene.file.objective)
    if not smooth and said is not None and said.is_smooth:
        said = None
    if name is not None and not isinstance(said, kinds[name]):
        said = kinds[name]()
    if said is None and (resemblance is not None or weights is not None):
        said = LeastJerk() if smooth and weights is None else PaperCost()
    if weights is not None:
        if not isinstance(said, PaperCost):
            raise OptionError(
                "they belong to equation (4)", key="--weights", way_out="give --objective paper as well"
            )
        said = replace(said, **_weights(weights))
    if said is None or resemblance is None:
        return said
    if said.is_time:
        raise OptionError(
            "least time looks at no demonstration", key="--resemblance", way_out="leave one of the two out"
        )
    try:
        return replace(said, resemblance=resemblance)
    except OptionError as error:
        raise OptionError(error.message, key="--resemblance", way_out=error.way_out) from None


def _weights(text: str) -> dict[str, float]:
    """Return the weights of equation (4) by name."""
    try:
        goal, velocity, obstacle = map(float, text.split(","))
    except ValueError:
        raise OptionError(
            f"'{text}' is not three numbers", key="--weights", way_out="write them as 1,0.01,10"
        ) from None
    return {"goal": goal, "velocity": velocity, "obstacle": obstacle}


def movement_given(
    scene: Scene, file: Path, demonstration: Path | None, library: Path | None, resemblance: float | None
) -> tuple[Library | None, Any]:
    """Return the library and the movement that command or scene name. The scene's movement is returned beside a
    library too, since one method combines both."""
    from comove.dmp import Library
    from comove.model import demonstration_of
    from comove.planning.choice import suitable

    if resemblance and scene.file.demonstration is None and demonstration is None and library is None:
        raise OptionError(
            "the scene has no demonstration to resemble",
            file=file,
            key="--resemblance",
            way_out="add a demonstration to the scene",
        )
    known = None
    if library is not None:
        known = Library(library)
        suitable(known, scene, _plane_of(scene))
    if demonstration is not None:
        return known, demonstration_at(demonstration, scene)
    return known, demonstration_of(scene)


def _plane_of(scene: Scene) -> str | None:
    demonstration = scene.file.demonstration
    return None if demonstration is None else demonstration.plane


def from_library(
    library: Library, scene: Scene, method: Method, seed: int, budget: float
) -> tuple[str, DMP | ProMP]:
    """Return a description and the movement that a library offers.

    The paper's pipeline (III) combines several movements for one end effector in the environment, after [6], and
    gives the result to all end effectors; the paper's methods get this movement. Other methods get the most suitable
    single movement. The combination takes up to a quarter of the budget in addition.
    """
    from comove.dmp import ProMP
    from comove.lab.evolution import Paper, Printed, combine
    from comove.planning import Budget, best_movement

    plane = _plane_of(scene)
    if isinstance(method, (Paper, Printed)):
        from comove.lab.compared.single import alone

        work = Budget(work=0.25 * budget)  # the same combination on every machine
        found = combine(library, alone(scene), seed=seed, budget=work, plane=plane)
        if found.interrupted:
            raise KeyboardInterrupt
        return f"a combination of {', '.join(found.names)}", found.dmp
    best = best_movement(library, scene, plane=plane).best
    whole = library.get(best.name).followed
    is_spread = isinstance(whole, ProMP) and whole.n_dims == scene.n_dims
    return best.name, whole if is_spread and isinstance(whole, ProMP) else best.dmp


def demonstration_at(path: Path, scene: Scene) -> DMP | PoseDMP | ProMP:
    """Return the movement in a file, or distribution in a folder."""
    from comove.dmp import ProMP, read_primitive
    from comove.dmp.recordings import is_several, read_recording, read_several
    from comove.model import fitted, followed_in
    from comove.model.demonstration import require_dimension

    named = str(path)
    if is_several(named):
        recordings, _ = read_several([named])
        first = recordings[0]
        of_one = next(iter(first.values())) if isinstance(first, dict) else first
        require_dimension(of_one.n_dims, scene)
        return ProMP.fit(recordings)
    if path.suffix == ".json":
        source = scene.file.demonstration
        plane = None if source is None else source.plane
        return followed_in(scene, read_primitive(path), key="--demonstration", plane=plane)
    return fitted(scene, read_recording(named).demonstration)


def check_picture(path: Path | None) -> None:
    """Check in advance that a picture can be written to `path`."""
    from comove.io.files import require_target

    if path is None:
        return
    if path.suffix.lower() not in PICTURES:
        raise OptionError("it is no picture's name", file=path, way_out="end it in .png, .pdf or .svg")
    require_target(path, OptionError)
