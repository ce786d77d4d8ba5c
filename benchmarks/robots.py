"""Robot examples, solved with several seeds and played in MuJoCo.

    python benchmarks/robots.py                          # all of it
    python benchmarks/robots.py --seeds 3 --only solve   # less of it
    python benchmarks/robots.py --seeds 5 --seed 410 --scenes g1 pr2
    python benchmarks/robots.py --only solve --open      # each as fast as its arms can
    python benchmarks/robots.py --only moving --count 100 --seed 2026 --difficulty robots-hard
    python benchmarks/robots.py --only first --seeds 9   # milliseconds to the first verified motion, and of its check
    python benchmarks/robots.py --only stages --seeds 5 --scenes two_pandas drawn/*.yaml  # and of its stages

Times are from the scene's file to the first and to the last verified joint motion, in seconds on the wall and of the
processor, which other work on the machine hardly changes; imports, compiling and the robot itself are apart.
Distances of the hands are computed by Pinocchio from the joints alone.

Scenes in which obstacles move are drawn around a motion of the joints, the witness, which the verification accepts:
one or two obstacles cross the straight motion when the payload is there, stay until then and leave, or go in circles.
Links are checked once more by dense sampling on the raw URDFs (tests/robots/raw_links.py).
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from timing import print_head, print_row

from comove import solve
from comove.data.carried import robot_of as robot_of_drawn
from comove.errors import OptionError, RobotError, SceneError
from comove.lab.bench.drawing import clutter
from comove.lab.bench.robot_drawing import JointWitness, RobotDraft
from comove.lab.bench.workplaces import ROBOT_DIFFICULTIES, WORKPLACES, RobotDifficulty
from comove.model import Scene, demonstration_of
from comove.model.motion import CoordinatedMotion
from comove.planning import SceneKind, methods, search, solver
from comove.planning.methods import Plans
from comove.planning.search import Search
from comove.planning.solution import Progress
from comove.robots import (
    JointMotion,
    Robot,
    RobotCarrier,
    VerifiedJointMotion,
    carrying,
    kernels,
    plan_transfers,
    verify_joints,
)
from comove.robots import solving as robots_solving
from comove.robots.ends import EndJoints
from comove.robots.kernels import load_robot_kernels
from comove.robots.verification import checks
from comove.robots.verification import verify as robots_verify
from comove.sim import Friction, Perturbation, Weld, simulate
from comove.verification.verify import verify

sys.path.insert(0, str(Path(__file__).parents[1]))

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENES = sorted([*EXAMPLES.glob("baxter/*.yaml"), *EXAMPLES.glob("robots/*.yaml")])
COAL = 2e-4  # m, by which its distances may be off
WITHIN = 0.4  # m, within which distances are exact; beyond, lower bounds
PERTURBED = ("gap_30", "gap_20")
N_PERTURBED = 20


@lru_cache
def robot_of(path: Path) -> Robot:
    """Return a scene's robot with meshes, links and kernels loaded."""
    scene = Scene.load(path)
    robot = robot_of_drawn(scene)
    load_robot_kernels(SceneKind.of(scene))
    for choice in scene.alternatives:
        with suppress(SceneError):  # another grasp may do
            RobotCarrier(robot, choice).require_reach()
    return robot


def solved(path: Path, seed: int, timed: bool = True) -> tuple[VerifiedJointMotion | None, dict[str, float]]:
    """Solve a file; return the motion and its measures. The duration is that of the file, or open."""
    robot = robot_of(path)
    begun, used, first = time.perf_counter(), time.process_time(), [np.nan, np.nan]

    def told(progress: Progress) -> None:
        if np.isnan(first[0]) and progress.best is not None:
            first[:] = time.perf_counter() - begun, time.process_time() - used

    scene, heard = Scene.load(path), list[VerifiedJointMotion]()
    wanted = {"demonstration": demonstration_of(scene), "seed": seed, "progress": told, "found": heard.append}
    found = solve(scene if timed else scene.timed(None), robot=robot, **wanted)
    seconds, processor = time.perf_counter() - begun, time.process_time() - used
    joints, report = found.joints.attempt, found.joints.report
    return found.joints.motion, {
        "seconds": seconds,
        "processor": processor,
        "first": first[0],
        "first processor": first[1],
        "first lasts": heard[0].joints.duration if heard else np.nan,
        "lasts": joints.duration,
        "J": found.cost.total,
        "taught": np.nan if found.followed is None else found.followed.distance,
        "distance": distance_error(robot, scene, joints.position),
        "margin": report.joint_margin_min,
        "speed": report.velocity_ratio_max,
        "torque": report.torque_ratio_max,
        "links": min(report.clearance_scene, report.clearance_load, report.clearance_self),
        "load": found.report.clearance_min,
    }


class _Heard(Exception):
    """Signal that a first joint motion is verified."""


def table_of_firsts(scenes: list[Path], seeds: range) -> None:
    """Print median processor times to the first verified motion [ms]."""
    print_head(
        ["scene", "motion lasts [s]", "scene read", "first motion", "its verification", "with tight bounds"]
    )

    def heard(motion: VerifiedJointMotion) -> None:
        raise _Heard(motion)

    for path in scenes:
        robot, times, lasts = robot_of(path), list[list[float]](), np.nan
        for seed in seeds:
            marks = [time.process_time()]
            scene = Scene.load(path)
            demonstration = demonstration_of(scene)
            marks.append(time.process_time())
            try:
                solve(scene, robot=robot, seed=seed, demonstration=demonstration, found=heard)
                continue
            except _Heard as first:
                (motion,) = first.args
            marks.append(time.process_time())
            for slack in (1.0, 0.0):
                verdict = verify_joints(robot, motion.motion, motion.joints, slack=slack)
                if verdict.verified is None:
                    raise RuntimeError(f"{path.stem}: {verdict.reasons[0]}")
                marks.append(time.process_time())
            times.append(np.diff(marks).tolist())
            lasts = motion.joints.duration
        medians = np.median(times, axis=0) if times else np.full(4, np.nan)
        print_row([path.stem, f"{lasts:.1f}", *(f"{1e3 * value:.1f}" for value in medians)])
    print()


class Stages:
    """Exclusive processor time of functions. Time within others among them does not count."""

    def __init__(self) -> None:
        self.spent, self._within, self._since = Counter[str](), ["rest"], time.process_time()

    def _turn(self) -> None:
        now = time.process_time()
        self.spent[self._within[-1]] += now - self._since
        self._since = now

    @contextmanager
    def within(self, stage: str) -> Iterator[None]:
        """Count the time inside towards a stage."""
        self._turn()
        self._within.append(stage)
        try:
            yield
        finally:
            self._turn()
            self._within.pop()

    def of(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time counts towards a stage."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            with self.within(stage):
                return function(*args, **kwargs)

        return timed


STAGES: dict[str, tuple[tuple[Any, str], ...]] = {
    "robot's set-up": (
        (robots_solving, "check_robot"),
        (kernels, "load_robot_kernels"),
        (robots_solving, "problem_of"),
        (RobotCarrier, "__init__"),
        (RobotCarrier, "_arms"),
    ),
    "joints at ends": ((EndJoints, "solved"), (EndJoints, "branches"), (EndJoints, "pairs")),
    "ends checked": (
        (robots_solving, "warn_of_buried_links"),
        (RobotCarrier, "may_be_clear_at_ends"),
        (RobotCarrier, "require_clear_ends"),
    ),
    "search's set-up": ((solver, "_search_for"), (Plans, "of")),
    "plan": ((RobotCarrier, "plan"), (RobotCarrier, "plan_in_time")),
    "fits": ((methods, "fit"), (Search, "candidates"), (Search, "worth")),
    "courses": ((RobotCarrier, "best_course"), (RobotCarrier, "strain")),
    "hands verified": ((search, "verify"), (robots_verify, "verify")),
    "joints along": ((RobotCarrier, "track"),),
    "limits, torques": ((checks, "rest"), (checks, "limits"), (checks, "payload"), (checks, "torques")),
    "hands hold": ((robots_verify, "holding_errors"), (checks, "hands"), (checks, "calibration")),
    "bodies, clearance": ((robots_verify, "bodies_of"), (checks, "clearances")),
    "rest of check": ((carrying, "verify_joints"),),
    "made smooth": ((methods, "smooth_way"), (methods, "smooth_demonstration")),
}
"""Where the functions of each stage are looked up."""


def counted(stages: Stages) -> None:
    """Replace the functions of all stages by timed ones."""
    for stage, places in STAGES.items():
        for place, name in places:
            function = vars(place)[name]
            if isinstance(function, classmethod):
                setattr(place, name, classmethod(stages.of(stage, function.__func__)))
            elif isinstance(function, property):
                setattr(place, name, property(stages.of(stage, function.fget)))
            elif isinstance(function, cached_property):
                function.func = stages.of(stage, function.func)
            else:
                setattr(place, name, stages.of(stage, function))


def table_of_stages(scenes: list[Path], seeds: range) -> None:
    """Print stages' median processor times before the first verified motion [ms]."""
    stages = Stages()
    counted(stages)
    names = [*STAGES, "rest"]
    print_head(["scene", "first motion", *names])

    def heard(motion: VerifiedJointMotion) -> None:
        raise _Heard(motion)

    every = list[list[float]]()
    for path in scenes:
        robot, rows = robot_of(path), list[list[float]]()
        for seed in (seeds.start, *seeds):  # a first solve that does not count
            scene = Scene.load(path)
            demonstration = demonstration_of(scene)
            with stages.within("rest"), suppress(_Heard):
                stages.spent.clear()
                solve(scene, robot=robot, seed=seed, demonstration=demonstration, found=heard)
            rows.append(
                [
                    1e3 * value
                    for value in (stages.spent.total(), *map(stages.spent.get, names, [0.0] * len(names)))
                ]
            )
        every.append(np.median(rows[1:], axis=0).tolist())
        print_row([path.stem, *(f"{value:.1f}" for value in every[-1])])
    print_row(["median", *(f"{value:.1f}" for value in np.median(every, axis=0))])


def distance_error(robot: Robot, scene: Scene, joints: np.ndarray) -> float:
    """Return the largest change of the end effectors' distances [m]."""
    arms = [robot.arm(name) for name in scene.manipulators]
    hands = np.array([[robot.tool_pose(q, arm)[:3, 3] for arm in arms] for q in joints])
    apart = np.linalg.norm(hands[:, :1] - hands[:, 1:], axis=-1)
    planned = np.linalg.norm(scene.start[:1] - scene.start[1:], axis=-1)
    return float(np.abs(apart - planned).max())


def table_of_solves(
    scenes: list[Path], seeds: range, timed: bool
) -> Iterator[tuple[Path, VerifiedJointMotion]]:
    """Print a row a scene; yield the motion of the first seed."""
    print_head(
        [
            *("scene", "verified", "first [s]", "of the processor", "all [s]", "of the processor"),
            *("the first lasts [s]", "the last [s]", "J", "from what was taught [m]", "distance error [m]"),
            *("margin [rad]", "speed", "torque", "links [mm]", "load [mm]"),
        ]
    )
    times = []
    for path in scenes:
        runs = [solved(path, seed, timed) for seed in seeds]
        measures = {key: np.array([m[key] for _, m in runs]) for key in runs[0][1]}
        times.append(measures["seconds"])
        times_of = "first", "first processor", "seconds", "processor", "first lasts", "lasts"
        print_row(
            [
                *(path.stem, f"{sum(v is not None for v, _ in runs)}/{len(seeds)}"),
                *(f"{np.nanmedian(measures[name]):.2f}" for name in times_of),
                *(f"{np.median(measures[name]):.3f}" for name in ("J", "taught")),
                *(f"{measures['distance'].max():.1e}", f"{measures['margin'].min():.3f}"),
                *(f"{measures[name].max():.2f}" for name in ("speed", "torque")),
                *(f"{1e3 * measures[name].min():.1f}" for name in ("links", "load")),
            ]
        )
        if (motion := next((v for v, _ in runs if v is not None), None)) is not None:
            yield path, motion
    print(f"\nmedian of all: {np.median(np.concatenate(times)):.2f} s\n")


def row(name: str, execution) -> None:
    """Print a simulation's measures."""
    m = execution.measures
    slip = "-" if m["slip_max"] is None else f"{1e3 * m['slip_max']:.2f}"
    print_row(
        [
            *(name, "yes" if execution.delivered else "no", f"{1e3 * m['end_error']:.2f}"),
            *(f"{1e3 * m['distance_error_max']:.3f}", slip, f"{m['internal_force_max']:.1f}"),
            *(f"{1e3 * m['lag_max']:.2f}", len(execution.contacts), f"{execution.steps_per_second:.0f}"),
        ]
    )


def table_of_simulations(motions: list[tuple[Path, VerifiedJointMotion]]) -> None:
    """Print a row a simulation."""
    print_head(
        [
            *("simulation", "delivered", "end [mm]", "distance [mm]", "slip [mm]"),
            *("inner force [N]", "lag [mm]", "contacts", "steps/s"),
        ]
    )
    for path, motion in motions:
        row(f"{path.stem}, weld", simulate(motion.joints, motion.scene, motion.robot, Weld()))
        if path.parent.name == "baxter":
            row(f"{path.stem}, friction", simulate(motion.joints, motion.scene, motion.robot, Friction()))
    for path, motion in motions:
        if path.stem not in PERTURBED:
            continue
        for grasp in (Weld(), Friction()):
            runs = []
            for seed in range(N_PERTURBED):
                drawn = Perturbation.drawn(np.random.default_rng(seed), len(motion.robot.joint_names))
                runs.append(simulate(motion.joints, motion.scene, motion.robot, grasp, drawn))
            name = f"{path.stem}, {type(grasp).__name__.lower()}, perturbed, worst of {N_PERTURBED}"
            worst = {
                key: max(run.measures[key] or 0.0 for run in runs)
                for key in ("end_error", "distance_error_max", "slip_max", "internal_force_max", "lag_max")
            }
            print_row(
                [
                    *(name, f"{sum(run.delivered for run in runs)}/{N_PERTURBED}"),
                    *(f"{1e3 * worst['end_error']:.2f}", f"{1e3 * worst['distance_error_max']:.3f}"),
                    *(f"{1e3 * worst['slip_max']:.2f}", f"{worst['internal_force_max']:.1f}"),
                    *(f"{1e3 * worst['lag_max']:.2f}", sum(len(run.contacts) for run in runs), ""),
                ]
            )
        joints, _ = RobotCarrier(motion.robot, motion.scene).track(CoordinatedMotion.straight(motion.scene))
        for grasp in (Weld(), Friction()):
            name = f"{path.stem}, {type(grasp).__name__.lower()}, straight line"
            row(name, simulate(joints, motion.scene, motion.robot, grasp))


def table_of_transfers(motions: list[tuple[Path, VerifiedJointMotion]]) -> None:
    """Print a row a scene on approach and release. It shows whether each was found and verified."""
    ways_last = "approach lasts [s]", "release lasts [s]"
    print_head(["from home and back", "found", "of the processor [s]", *ways_last, "why not"])
    for path, motion in motions:
        begun, found, lasts, why = time.process_time(), "yes", (np.nan, np.nan), ""
        try:
            ways = plan_transfers(motion)
            lasts = ways.approach.duration, ways.release.duration
        except (OptionError, RobotError) as error:  # the former where obstacles move
            found, why = "no", str(error)
        used = time.process_time() - begun
        print_row([path.stem, found, f"{used:.2f}", *(f"{x:.1f}" for x in lasts), why])
    print()


class MovingDraft(RobotDraft):
    """Sampled scene whose obstacles move and block the straight motion."""

    def obstructed(self, witness: JointWitness) -> bool:
        """Add obstacles; return whether they fit and block the straight motion."""
        straight = CoordinatedMotion.straight(Scene.from_dict(self.data()))
        swept, n_moving = witness.motion(straight.scene), int(self.rng.integers(1, 3))
        for _ in range(n_moving):
            if not self._moves(straight, witness):
                return False
        for _ in range(self.difficulty.obstacles[0] - n_moving):  # and at rest
            if not self._placed(swept, witness):
                return False
        return bool(verify(straight.on(Scene.from_dict(self.data()))).reasons)

    def _moves(self, motion: CoordinatedMotion, witness: JointWitness) -> bool:
        """Add an obstacle that crosses a motion, and not the witness."""
        duration, rng = self.difficulty.duration, self.rng
        for _ in range(4 * self.difficulty.tries):
            when = float(rng.uniform(0.25, 0.75))
            hands = motion.hands(np.array([when]))[0, 0]
            point = hands[0] + rng.uniform() * (hands[1] - hands[0])
            about, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.3)
            velocity = speed * np.array([np.cos(about), np.sin(about), 0.0])
            begin, kind = point - when * duration * velocity, rng.integers(3)
            obstacle = clutter(rng, point.round(3), rng.uniform(*self.difficulty.size))
            if kind == 0:
                obstacle |= {
                    "center": begin.round(3).tolist(),
                    "motion": {"velocity": velocity.round(3).tolist()},
                }
            elif kind == 1:
                until = float(np.round(when * duration + rng.uniform(0.0, 1.0), 2))
                left = (point + 3.0 * velocity / speed).round(3).tolist()
                ways = [obstacle["center"], obstacle["center"], left]
                obstacle["motion"] = {"waypoints": ways, "times": [0.0, until, round(until + 1.0 / speed, 2)]}
            else:
                radius, period = float(rng.uniform(0.1, 0.4)), float(rng.uniform(4.0, 12.0))
                angle = 2 * np.pi * when * duration / period
                shift = radius * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
                obstacle["center"] = (point - shift).round(3).tolist()
                obstacle["motion"] = {"circle": {"radius": round(radius, 3), "period_s": round(period, 2)}}
            with suppress(SceneError):  # an end in an obstacle
                if self._clear(
                    witness, Scene.from_dict(self.data() | {"obstacles": [*self.obstacles, obstacle]})
                ):
                    self.obstacles.append(obstacle)
                    return True
        return False


def drawn_moving(number: int, seed: int, difficulty: RobotDifficulty) -> Scene:
    """Sample a scene with moving obstacles, proved feasible by a witness."""
    places = [WORKPLACES[name] for name in ("baxter", "two_pandas", "two_ur10", "ur5_and_panda")]
    rng = np.random.default_rng([seed, number])
    while True:
        draft = MovingDraft(f"moving_{number:02}", difficulty, places[number % len(places)], rng)
        witness = draft.moved()
        if witness is not None and draft.obstructed(witness):
            return Scene.from_dict(draft.data())


def links_apart(robot: Robot, scene: Scene, joints: JointMotion, rate: float = 100.0) -> float:
    """Return the least sampled distance of links from moving obstacles [m]. It uses the raw URDFs."""
    from tests.robots.raw_links import RawLinks

    time = np.linspace(0.0, joints.duration, int(rate * joints.duration) + 1)
    return float(
        RawLinks(robot).distances(scene.file.obstacles, time, joints.curve(time), within=WITHIN).min()
    )


def table_of_moving(count: int, seed: int, difficulty: RobotDifficulty) -> None:
    """Sample, solve and play moving scenes; print a row each."""
    print_head(
        ["scene", "verified", "first [s]", "all [s]", "stated [mm]", "sampled [mm]", "delivered", "why not"]
    )
    solved, nearer, delivered, firsts = 0, 0, 0, list[float]()
    for number in range(count):
        scene = drawn_moving(number, seed, difficulty)
        robot = robot_of_drawn(scene)
        load_robot_kernels(SceneKind.of(scene))
        begun = time.process_time()
        found = solve(scene, robot=robot, seed=seed, budget=60.0)
        seconds, motion, cells = time.process_time() - begun, found.joints.motion, ["-", "-", "-"]
        if motion is not None:
            solved, stated = solved + 1, motion.report.clearance_scene
            firsts.append(found.effort.first_verified or np.nan)
            sampled, played = (
                links_apart(robot, scene, motion.joints),
                simulate(motion.joints, scene, robot, Weld()),
            )
            nearer += sampled < min(stated, WITHIN) - COAL
            delivered += played.delivered
            cells = [f"{1e3 * stated:.2f}", f"{1e3 * sampled:.2f}", "yes" if played.delivered else "no"]
        name = f"{scene.name}, {robot.name}"
        print_row(
            [
                *(name, "no" if motion is None else "yes", f"{firsts[-1]:.2f}" if motion else "-"),
                *(f"{seconds:.2f}", *cells, "" if motion else "; ".join(found.reasons)[:120]),
            ]
        )
    print(
        f"\nsolved {solved} of {count}, first after {np.median(firsts):.2f} s in the median; "
        f"delivered {delivered} of these; links nearer than certified in {nearer}\n"
    )


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--scenes", nargs="+", help="names of scenes, or files; all unless given")
    parser.add_argument("--only", choices=("solve", "first", "stages", "transfers", "simulate", "moving"))
    parser.add_argument("--difficulty", choices=[*ROBOT_DIFFICULTIES], default="robots-easy", help="of these")
    parser.add_argument("--count", type=int, default=25, help="of drawn scenes with moving obstacles")
    parser.add_argument("--open", action="store_true", help="leave out the durations that scenes give")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.only == "moving":
        table_of_moving(options.count, options.seed, ROBOT_DIFFICULTIES[options.difficulty])
        return
    wanted = options.scenes or [path.stem for path in SCENES]
    scenes = [path for path in SCENES if path.stem in wanted] + [
        Path(name) for name in wanted if name.endswith(".yaml")
    ]
    for path in scenes:
        robot_of(path)
    if options.only == "stages":
        table_of_stages(scenes, range(options.seed, options.seed + options.seeds))
        return
    if options.only == "first":
        table_of_firsts(scenes, range(options.seed, options.seed + options.seeds))
        return
    count = options.seeds if options.only in (None, "solve") else 1
    motions = list(table_of_solves(scenes, range(options.seed, options.seed + count), not options.open))
    if options.only in (None, "transfers"):
        table_of_transfers(motions)
    if options.only in (None, "simulate"):
        table_of_simulations(motions)


if __name__ == "__main__":
    main()
