"""A first scene for a robot: two end effectors lift a bar over a rail. A solver proves it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import RobotError, SceneError
from comove.model.files.upgrade import as_text, upgraded
from comove.model.grasp import HELD
from comove.model.scene import Scene
from comove.planning.clock import Budget
from comove.planning.kernels import SceneKind
from comove.planning.solution import Solution
from comove.robots.carrying import RobotCarrier
from comove.robots.kernels import load_robot_kernels
from comove.robots.model import Arm, Robot
from comove.robots.proposal.bodies import scene_of
from comove.robots.proposal.examination import findings_of
from comove.robots.proposal.homes import base_of, floor_of
from comove.robots.solving import solve_joints
from comove.robots.transfers import plan_transfers

Cells = NDArray[np.bool_]
Cell = tuple[int, int]

QUARTERS = (0.0, 180.0, -90.0, 90.0)  # degrees, by which a hand is turned on the bar
ACROSS = {"down": (0.0, 180.0), "forward": (-90.0, 90.0)}  # those by which fingers close across it
WAY_OUT = "give another home or other bases: `comove robot check` says what hands reach and which links touch"


@dataclass(frozen=True)
class FirstSceneSettings:
    """Settings of the search for a first scene.

    Attributes
    ----------
    n_cells : of the grid of places of the payload, in each direction
    cells : distances of neighbouring places, finer ones where the others are not enough [reaches]
    above : height of the lowest place above the floor [reaches]
    aside : clearance about all places [reaches]
    n_seeds : random joints, from which a place is solved
    lengths : of the bar that are tried [distances of the end effectors at home]
    shortest : length of the shortest bar [reaches]
    fewest, most : least and largest number of places in a row, forwards and upwards, for a motion over a rail
    rails : heights of the rail that are tried, as shares of the payload's lift
    n_tried : scenes that are solved, of those that both end effectors reach
    n_carried : solved scenes after which one without approach and release is accepted
    rounds : work to solve each, as `Budget.work`, and duration [s], in turn: the first solves most, and a joint may
        be slow
    """

    n_cells: int = 11
    cells: tuple[float, ...] = (0.08, 0.04)
    above: float = 0.05
    aside: float = 0.16
    n_seeds: int = 12
    lengths: tuple[float, ...] = (1.0, 0.6)
    shortest: float = 0.2
    fewest: int = 3
    most: int = 5
    rails: tuple[float, ...] = (0.5, 0.2)
    n_tried: int = 8
    n_carried: int = 3
    rounds: tuple[tuple[float, float], ...] = ((3.0, 8.0), (10.0, 16.0))


SETTINGS = FirstSceneSettings()


@dataclass(frozen=True)
class SceneProposal:
    """A scene that a robot has solved.

    Attributes
    ----------
    data : contents of its file (`comove.model.files.keys.SceneFile`)
    found : its verified motion
    unreached : reason why no approach and release lead to and from home; empty where they do
    """

    data: dict[str, Any]
    found: Solution
    unreached: str = ""

    def text(self) -> str:
        """Return the scene as YAML, in version 2."""
        name = self.found.joints.robot.name
        head = f"# A first scene for {name}: a bar is lifted over a rail. Lengths are in metres.\n"
        scene = Scene.from_dict(self.data, folder=self.found.scene.folder, check_ends=False)
        return head + as_text(upgraded(scene, self.data))


@dataclass(frozen=True)
class _Place:
    """A bar between two end effectors, and its places halfway between them.

    Attributes
    ----------
    arms : the end effector at the larger coordinate along the bar first
    axis : the bar's axis, 0 for x or 1 for y
    length : of the bar [m]
    grasp : of the scene file
    lower, upper : of the places of the bar's middle that both end effectors reach, arrays, shape (3,) [m]
    reach : the smaller arm's [m]
    floor : height of the robot's floor [m]
    cell : distance of neighbouring places [m]
    aside : clearance about all places [m]
    """

    arms: tuple[Arm, Arm]
    axis: int
    length: float
    grasp: dict[str, Any]
    lower: Array
    upper: Array
    reach: float
    floor: float
    cell: float
    aside: float

    @property
    def worth(self) -> float:
        """Return the area of the places [m^2]."""
        size = self.upper - self.lower
        return float(size[1 - self.axis] * size[2])

    def _vector(self, across: float, onward: float, up: float) -> Array:
        """Return a vector by its parts along, across and above the bar; array, shape (3,) [m]."""
        x, y = (across, onward) if self.axis == 0 else (onward, across)
        return np.array([x, y, up])

    def data(
        self, named: str, rail: float, duration: float, around: Sequence[dict[str, Any]] = ()
    ) -> dict[str, Any]:
        """Return a scene file's contents, in which the bar passes a rail.

        All is relative to the arms' reach: the bar's radius is 1.2 % of it, but at most an eighth of the path; its
        mass 0.2 kg for each metre of it, if they are rated for that, and the speed 0.6 times it a second.

        Parameters
        ----------
        named : the robot's name in the scene
        rail : height of the rail, as a share of the bar's lift
        duration : of the transfer motion [s]
        around : obstacles around the robot, in a scene's format
        """
        reach, inset = self.reach, self._vector(0.0, 0.5 * self.cell, 0.5 * self.cell)
        half = self._vector(0.5 * self.length, 0.0, 0.0)
        start, goal = (np.round(corner, 3) + 0.0 for corner in (self.lower + inset, self.upper - inset))
        lift, way = goal[2] - start[2], goal[1 - self.axis] - start[1 - self.axis]
        goal[2] = start[2]
        # A quarter of the way is left beside the rail.
        radius = max(0.001, round(float(min(0.012 * reach, 0.125 * way)), 3))
        lower, upper = self.lower - self.aside - half, self.upper + self.aside + half
        lower[2] = max(lower[2], self.floor)
        lower, upper = np.round(lower, 3), np.round(upper, 3)
        top = start[2] - radius + rail * lift
        size = self._vector(0.4 * self.length, min(0.05 * reach, 0.25 * way), top - lower[2])
        center = 0.5 * (start + goal)
        center[2] = lower[2] + 0.5 * size[2]
        return {
            "version": 1,
            "name": f"first scene of {Path(named).stem}",
            "duration": duration,
            "robot": named,
            "grasp": self.grasp,
            "workspace": {"lower": lower.tolist(), "upper": upper.tolist()},
            "obstacles": [
                {"shape": "box", "center": center.round(4).tolist(), "size": size.round(4).tolist()},
                *around,
            ],
            "load": {
                "shape": "bar",
                "length": self.length,
                "radius": radius,
                "mass": float(
                    min([round(0.2 * reach, 2), *(1.9 * (arm.payload - arm.hand) for arm in self.arms)])
                ),
            },
            "manipulators": [
                {
                    "name": arm.name,
                    "start": (start + side * half).round(4).tolist(),
                    "goal": (goal + side * half).round(4).tolist(),
                }
                for arm, side in zip(self.arms, (1, -1), strict=True)
            ],
            "limits": {
                "speed": round(0.6 * reach, 2),
                "acceleration": 1.0,
                "clearance": round(min(0.005, 0.006 * reach), 4),
            },
        }


def propose_scene(
    robot: Robot,
    named: str,
    *,
    around: Sequence[dict[str, Any]] = (),
    folder: Path = Path(),
    seed: int = 0,
) -> SceneProposal:
    """Propose a first scene for a robot, solved once to prove feasibility.

    Two end effectors hold a bar between them, turned in one of the ways in which they reach the largest space about
    their home; the bar lies along x or y, as the arms stand side by side, and is moved the other way over a rail.

    Parameters
    ----------
    named : the robot's name or its description's path, for the scene
    around : obstacles around the robot, in a scene's format
    folder : folder of the scene, to which files of obstacles are relative
    seed : of the solver

    Raises
    ------
    RobotError
        If the robot has one arm only, its end effectors reach no place together, or no scene within reach is solved.
    """
    if len(robot.arms) < 2:
        raise RobotError(
            f"'{robot.name}' has one arm, and a load is held by two",
            key="arms",
            way_out="give the URDF twice to `comove robot new`, or name another arm",
        )
    load_robot_kernels(SceneKind(3))
    standing = scene_of(around, folder)
    found_by_cell = (list(_places(robot, cell, standing)) for cell in SETTINGS.cells)
    places = _ranked(next(filter(None, found_by_cell), []))
    if not places:
        raise RobotError(
            f"no place was found about home at which two hands of '{robot.name}' hold a bar between them, "
            f"hands down or level{', clear of what stands around' if around else ''}",
            key="arms",
            way_out=WAY_OUT,
        )
    reasons, first, n_carried = list[str](), None, 0
    tried = list(product(places, SETTINGS.rails))[: SETTINGS.n_tried]
    for (work, duration), (place, rail) in product(SETTINGS.rounds, tried):
        data = place.data(named, rail, duration, around)
        try:
            first_scene, budget = Scene.from_dict(data, folder=folder), Budget(work=work)
            found = solve_joints(first_scene, robot, seed=seed, budget=budget)
        except SceneError as error:
            reasons.append(str(error))
            continue
        if found.joints.motion is not None:
            try:
                plan_transfers(found.joints.motion, seed=seed)
            except RobotError as error:
                first, n_carried = first or SceneProposal(data, found, error.message), n_carried + 1
                if n_carried < SETTINGS.n_carried:
                    continue
                return first
            return SceneProposal(data, found)
        reasons += (*found.reasons, *found.joints.verdict.reasons, "none was found")[:1]
    if first is not None:
        return first
    raise RobotError(
        f"none of {len(tried)} scenes that two hands of '{robot.name}' reach was solved: {reasons[-len(tried)]}",
        key="arms",
        way_out=WAY_OUT,
    )


def _ranked(places: Sequence[_Place]) -> list[_Place]:
    """Return the places in the order in which they are tried.

    The largest are first, but where the same bar is held in the same place, one turn of the end effectors on it for
    each such place precedes any other.
    """
    known = Counter[tuple[object, ...]]()
    order = list[tuple[int, float, int]]()
    for i, place in enumerate(places):
        where = (place.grasp["orientation"], place.length, *place.lower.tolist(), *place.upper.tolist())
        order.append((known[where], -round(place.worth, 6), i))
        known[where] += 1
    return [places[i] for *_, i in sorted(order)]


def _places(robot: Robot, cell: float, standing: Scene) -> Iterator[_Place]:
    """Yield where two end effectors reach a bar, by grasp. They are the nearest to each other at home.

    Parameters
    ----------
    cell : distance of neighbouring places [reaches]
    standing : scene of the obstacles around the robot
    """
    home = {arm.name: robot.tool_pose(robot.home, arm)[:3, 3] for arm in robot.arms}
    pair = min(
        combinations(robot.arms, 2), key=lambda two: np.linalg.norm(home[two[0].name] - home[two[1].name])
    )
    bases = np.array([base_of(robot, arm) for arm in pair])
    axis = int(np.abs(bases[0] - bases[1])[:2].argmax())
    arms = pair if bases[0, axis] >= bases[1, axis] else pair[::-1]
    hands = np.array([home[arm.name] for arm in arms])
    reach = min(findings_of(robot, arm, np.random.default_rng(0)).reach for arm in arms)
    step, floor = cell * reach, floor_of(robot)
    aside = 0.5 * step * (SETTINGS.n_cells - 1) * (np.arange(3) != axis)
    around = hands.mean(axis=0) + np.array([-aside, aside])
    around[:, 2] += max(0.0, floor + SETTINGS.above * reach - around[0, 2])

    def place(turns: tuple[float, ...], lower: Array, upper: Array) -> _Place:
        offsets = {arm.name: turn for arm, turn in zip(arms, turns, strict=True)}
        grasp = {"orientation": orientation, "yaw": "load", "offset_deg": offsets}
        return _Place(arms, axis, length, grasp, lower, upper, reach, floor, step, SETTINGS.aside * reach)

    for orientation, share in product(ACROSS, SETTINGS.lengths):
        length = round(float(max(share * abs(hands[0, axis] - hands[1, axis]), SETTINGS.shortest * reach)), 3)
        ways = [ACROSS[orientation] if arm.fingers else QUARTERS for arm in arms]
        if orientation == "down":  # and as at home
            ways = [
                way if arm.fingers else (*way, _turn_at_home(robot, arm, axis))
                for way, arm in zip(ways, arms, strict=True)
            ]
        maps = {
            turn: _reached(robot, place((turn, turn), *around), standing) for turn in {*ways[0], *ways[1]}
        }
        for turns in product(*ways):
            cells = largest_rectangle(maps[turns[0]][0] & maps[turns[1]][1], SETTINGS.fewest, SETTINGS.most)
            if cells is not None:
                yield place(turns, *(_at_cell(around, axis, corner) for corner in cells))


def _turn_at_home(robot: Robot, arm: Arm, axis: int) -> float:
    """Return a downward end effector's turn on a bar at home [deg]. It is rounded to 5 degrees."""
    x, y = (robot.tool_pose(robot.home, arm)[:3, :3] @ HELD["down"].T)[:2, 0]
    turn = np.rad2deg(np.arctan2(y, x)) - 90.0 * axis
    return float(5.0 * np.round(((turn + 180.0) % 360.0 - 180.0) / 5.0))


def _at_cell(around: Array, axis: int, cell: Cell) -> Array:
    """Return the bar's middle at a grid cell, forwards and upwards; array, shape (3,) [m]."""
    shares = np.insert(np.array(cell) / (SETTINGS.n_cells - 1), axis, 0.0)
    return around[0] + shares * (around[1] - around[0])


def _reached(robot: Robot, place: _Place, standing: Scene) -> Cells:
    """Return where each end effector reaches a clear bar; array, shape (2, n_cells, n_cells), forwards and up."""
    data = place.data(robot.name, 0.0, SETTINGS.rounds[0][1]) | {
        "obstacles": [obstacle.model_dump() for obstacle in standing.file.obstacles]
    }
    scene = Scene.from_dict(data, folder=standing.folder, check_ends=False)
    found, nodes = np.zeros((2, SETTINGS.n_cells, SETTINGS.n_cells), dtype=bool), scene.nodes_at("start")
    try:
        carrier = RobotCarrier(robot, scene)
    except SceneError:  # grippers collide at this distance, however they are placed
        return found
    middle = nodes[:2].mean(axis=0)
    around = np.array([place.lower, place.upper])
    for hand, *cell in np.ndindex(found.shape):
        there = nodes + _at_cell(around, place.axis, (cell[0], cell[1])) - middle
        is_clear = standing.owners.size == 0 or scene.nearest_at(there)[0] > scene.clearance
        found[hand, cell[0], cell[1]] = is_clear and carrier.ends.reaches(hand, there, SETTINGS.n_seeds)
    return found


def largest_rectangle(free: Cells, fewest: int, most: int) -> tuple[Cell, Cell] | None:
    """Return the largest free rectangle's first and last cell. None if too small; of several, the one nearest home.

    Parameters
    ----------
    free : array of bool, shape (n, n)
    fewest, most : cells of a side
    """
    n = len(free)
    counts = np.pad(free.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    low, high = np.array([(a, b) for a in range(n) for b in range(a + fewest, min(a + most, n) + 1)]).T
    inside = counts[np.ix_(high, high)] - counts[np.ix_(low, high)] - counts[np.ix_(high, low)]
    size = np.multiply.outer(high - low, high - low)
    away = np.abs(low + high - n)
    worth = np.where(inside + counts[np.ix_(low, low)] == size, size * n**2 - np.add.outer(away, away), 0)
    i, j = np.unravel_index(worth.argmax(), worth.shape)
    if worth[i, j] <= 0:
        return None
    return (int(low[i]), int(low[j])), (int(high[i]) - 1, int(high[j]) - 1)
