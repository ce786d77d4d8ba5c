"""Online runs of robots, in MuJoCo and in ROS 2."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.model import Scene
    from comove.robots.online.executor import JointExecutor
    from comove.sim.grasps import GraspModel
    from comove.sim.live_record import OnlineRecord
    from comove.sim.settings import Perturbation

RUN_LONGEST = 4.0  # times the plan's duration, that a run may last unless it is said
LEAST_RATE, USUAL_RATE, LARGEST_RATE = 50.0, 250.0, 500.0  # Hz, of control steps
IN_ROS = "Robots in ROS 2"


@dataclass(frozen=True)
class StreamOptions:
    """Options of a run of a robot in ROS 2."""

    ros: Annotated[
        int | None,
        typer.Option(
            metavar="2",
            rich_help_panel=IN_ROS,
            help="Run the robot in ROS 2 instead of a simulated one: its joints are measured, and commands streamed.",
        ),
    ] = None
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            rich_help_panel=IN_ROS,
            help="Result of `comove solve` whose motion is followed first; planned unless given.",
        ),
    ] = None
    commands: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            rich_help_panel=IN_ROS,
            help="Command topic of each {arm}'s controller, or one for all arms: positions (Float64MultiArray) or "
            "short trajectories (JointTrajectory); as the robot's description says unless given, else "
            "/{arm}_position_controller/commands.",
        ),
    ] = None
    joint_states: Annotated[str | None, typer.Option(rich_help_panel=IN_ROS, **o.JOINT_STATES)] = None
    obstacles: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            rich_help_panel=IN_ROS,
            help="Topic that tells where moving obstacles are: centres (PoseArray, MarkerArray, CollisionObject, "
            "PlanningScene), or a cloud without points of the robot and its payload (PointCloud2); where the scene "
            "has them unless given.",
        ),
    ] = None
    frame: Annotated[
        str, typer.Option(rich_help_panel=IN_ROS, help="Frame of the scene in the messages of obstacles.")
    ] = "world"
    noise: Annotated[
        float,
        typer.Option(
            rich_help_panel=IN_ROS,
            help="Standard deviation of the obstacles' coordinates, or of a cloud's [m].",
        ),
    ] = 0.005

    def wanted(self) -> bool:
        """Return whether the robot is in ROS; refuse options that say nothing without."""
        if self.ros not in (None, 2):
            raise OptionError(f"robots run in ROS 2, not in ROS {self.ros}", key="--ros", way_out="give 2")
        if self.ros is None:
            o.require_defaults(self, "no robot runs in ROS", "give --ros 2 as well")
        elif self.obstacles is None:
            for name in ("frame", "noise"):
                if getattr(self, name) != StreamOptions.__dataclass_fields__[name].default:
                    raise OptionError(
                        "no topic tells obstacles", key=f"--{name}", way_out="give --obstacles TOPIC as well"
                    )
        return self.ros is not None


@dataclass(frozen=True)
class SimulatedRun:
    """Options of a robot's simulated run.

    Attributes
    ----------
    rate : control rate [Hz]
    grasp : name of the grasp
    perturbed : seed of the perturbation; None for none
    budget : limit of simulated time [s]; None for `RUN_LONGEST` times the plan's duration
    pictures, film : whether a sheet of pictures, and a film, are drawn
    """

    rate: float = USUAL_RATE
    grasp: str = "weld"
    perturbed: int | None = None
    budget: float | None = None
    pictures: bool = True
    film: bool = False


def run_joints(
    loaded: Scene,
    scene: Path,
    out: Path,
    robot: str | None,
    how: SimulatedRun,
    *,
    seed: int,
    json: bool,
) -> int:
    """Run a robot in MuJoCo, record and verify the run. Return the exit code.

    Parameters
    ----------
    loaded, scene : the scene, and its file
    out : folder for the record
    robot : name or description; that of the scene unless given
    """
    import numpy as np

    from comove.cli.progress import progress_bar
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.sim import GRASPS, Perturbation
    from comove.sim.engine import engine
    from comove.sim.live import run_live, steps_of

    o.require_one_of(how.grasp, tuple(GRASPS), "grasp")
    _require_possible(how, out)
    settings, hold = OnlineSettings(period=1.0 / how.rate), GRASPS[how.grasp]()
    carrier, named = o.robot_named(robot, loaded, scene)
    engine()
    steps_of(settings.period)
    o.require_carried(carrier, loaded.standing(), scene)
    hold.moving([carrier.arm(name) for name in loaded.manipulators])
    with progress_bar():
        _ready(loaded)
        executor = JointExecutor(loaded, carrier, seed=seed, settings=settings)
        drawn = None
        if how.perturbed is not None:
            drawn = Perturbation.drawn(np.random.default_rng(how.perturbed), len(carrier.joint_names))
        record = run_live(executor, _longest(how, executor), hold, drawn)
    run = RecordedRun(record, executor, named, seed, GRASPS[how.grasp](), drawn)
    return run.written(out, how, json=json)


def run_in_ros(
    loaded: Scene,
    scene: Path,
    out: Path,
    robot: str | None,
    how: SimulatedRun,
    ros: StreamOptions,
    *,
    seed: int,
    json: bool,
) -> int:
    """Run a robot in ROS 2, record and verify the run; see `run_joints`. Return the exit code."""
    from comove.cli.progress import progress_bar
    from comove.cli.texts import say
    from comove.control import Observed, Sensor
    from comove.robots.files import verified_against
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.ros.online import await_obstacles, moving_names, run_streamed
    from comove.ros.streams import CommandStream, StreamNames, StreamSettings
    from comove.sim import GRASPS
    from comove.sim.robot_runs import MEASURED, streamed

    if how.perturbed is not None or how.grasp != SimulatedRun.grasp:
        key = "--grasp" if how.perturbed is None else "--perturbed"
        raise OptionError("that is of simulated robots", key=key, way_out="leave it out with --ros")
    _require_possible(how, out)
    settings = OnlineSettings(period=1.0 / how.rate)
    carrier, named = o.robot_named(robot, loaded, scene)
    o.require_carried(carrier, loaded.standing(), scene)
    plan = None if ros.plan is None else verified_against(ros.plan, scene=loaded, robot=named)[0]
    names = StreamNames.of(
        carrier,
        commands=ros.commands,
        joint_states=ros.joint_states,
        obstacles=ros.obstacles,
        frame=ros.frame,
    )
    moving = {} if ros.obstacles is None else moving_names(loaded)
    if ros.obstacles is not None and not moving:
        raise OptionError(
            f"no obstacle of '{loaded.name}' moves",
            key="--obstacles",
            way_out="give those a motion in the scene whose places are told, or leave it out",
        )
    streamed_as = StreamSettings(settings.period, noise=ros.noise)
    with CommandStream(carrier, names, streamed_as, obstacles=moving, scene=loaded) as stream:
        with progress_bar():
            _ready(loaded)
            observer, zero = None, None
            if ros.obstacles is not None:
                observer = Observed(loaded, Sensor(noise=ros.noise))
                zero = await_obstacles(stream, observer, stream.settings.connect)
            executor = JointExecutor(loaded, carrier, observer, plan=plan, seed=seed, settings=settings)
        run = run_streamed(executor, stream, _longest(how, executor), zero=zero, tell=say)
    timing = {name: 1e3 * value for name, value in vars(run.timing).items()}
    more = {
        "executed": "ros2",
        "obstacles": "scene" if ros.obstacles is None else MEASURED,
        "stops": list(run.stops),
        "timing_ms": timing,
    }
    return RecordedRun(streamed(run), executor, named, seed, GRASPS["weld"](), None, more).written(
        out, how, json=json
    )


@dataclass(frozen=True)
class RecordedRun:
    """A run to be written.

    Attributes
    ----------
    record, executor : its record, and its executor
    source : the robot's description
    seed : seed of the plans
    grasp, perturbation : how it was simulated, for pictures
    more : further entries of the summary
    """

    record: OnlineRecord
    executor: JointExecutor
    source: str | Path
    seed: int
    grasp: GraspModel
    perturbation: Perturbation | None
    more: Mapping[str, Any] | None = None

    def written(self, out: Path, how: SimulatedRun, *, json: bool) -> int:
        """Verify the run, and write and print it. Return the exit code."""
        from comove.cli.progress import time_spent
        from comove.cli.simulate import draw_robot_pictures
        from comove.cli.texts import robot_run_text
        from comove.io.folders import whole_folder
        from comove.results import RESULT
        from comove.results.inputs import write_inputs
        from comove.sim.live_record import judge_run
        from comove.sim.pictures import FilmedRun
        from comove.sim.robot_runs import write_robot_run
        from comove.sim.settings import PLAN
        from comove.view.figures import Joints, draw_joints, save

        record, log, robot = self.record, self.executor.log, self.executor.robot
        report = judge_run(record)
        with whole_folder(out, RESULT) as draft:
            failed = " (not as it should)" if report.reasons else ""
            title = f"{record.scene.name}, {robot.name}, online{failed}"
            save(draw_joints(Joints.of(robot, record.motion), title=title), draft / "joints.png")
            summary = write_robot_run(
                draft,
                record,
                report,
                log,
                seed=self.seed,
                wall_time_s=time_spent(),
                source=self.source,
                more=self.more,
            )
            write_inputs(draft, record.scene, files=robot.files, command=command_words())
            if len(record.time) > 1 and (how.pictures or how.film):
                filmed = FilmedRun.of(record, self.grasp, self.perturbation or PLAN)
                draw_robot_pictures(filmed, draft, "robot_run", how.pictures, how.film)
        if json:
            print((out / "robot_run.json").read_text(encoding="utf-8"), end="")
        else:
            print(robot_run_text(summary, out))
        if record.interrupted:
            return INTERRUPTED
        return NOT_VERIFIED if report.reasons else VERIFIED


def _require_possible(how: SimulatedRun, out: Path) -> None:
    """Refuse a rate, a budget or a target that is not possible."""
    from comove.io.folders import check_target
    from comove.results import RESULT

    if not LEAST_RATE <= how.rate <= LARGEST_RATE:
        raise OptionError(
            f"{how.rate:g} Hz are not possible",
            key="--rate",
            way_out=f"give {LEAST_RATE:g} to {LARGEST_RATE:g}",
        )
    if how.budget is not None:
        o.check_budget(how.budget)
    check_target(out, RESULT)


def _ready(loaded: Scene) -> None:
    """Refuse what cannot be run, and load all kernels."""
    from comove.model.resting import require_no_rest
    from comove.planning import SceneKind
    from comove.robots.kernels import load_robot_kernels

    require_no_rest(loaded.require_free_ends())
    load_robot_kernels(SceneKind.of(loaded), "robot executions")


def _longest(how: SimulatedRun, executor: JointExecutor) -> float:
    return how.budget or RUN_LONGEST * executor.plan.scene.duration
