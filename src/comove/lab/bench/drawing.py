"""Scenes sampled around a movement, which proves them feasible.

The choice favours no planner. First the payload is sampled, then the openings of the walls and an orientation in
which the payload fits each of them; then poses: the start, one before and one behind each wall, the goal; then walls
around the openings; then clutter that stays clear of the volume swept by the payload. Scenes that fail the
verification are sampled again.

The movement, the witness, is a few poses of the payload. Between two of them the payload moves by minimum jerk, from
rest to rest: its centre on the straight line, its orientation on the shortest rotation. The duration of a segment is
proportional to its length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import SceneError
from comove.geometry.rotations import conjugate, exponential, logarithm, matrices, quaternion_product
from comove.lab.examples import scene_contents, wall
from comove.model.scene import Scene
from comove.model.shapes import spatial
from comove.planning.seeds import minimum_jerk
from comove.verification.record import ExecutionReport, RecordSamples, verify_execution

Range = tuple[float, float]

TILTS = (np.pi, 0.6, 0.4, 0.25, 0.15, 0.08, 0.03, 0.0)  # rad, tried around the pose that fits an opening best
NAMES = "abcd"
WHERE_NOTHING_MOVES = 1e-9  # m, added to the way of every segment of a witness


@dataclass(frozen=True)
class Difficulty:
    """Ranges from which scenes are sampled.

    Attributes
    ----------
    ratio : size of an opening in bar lengths; for a frame, the narrow side of a window in widths of the frame
    width : width of an opening for a frame, in widths of the frame across its narrowest direction
    walls, clutter, manipulators : smallest and largest number
    thickness : thickness of walls [m]
    corridor : distance between walls in addition to the space in which the payload rotates [m]
    size : size of clutter [m]
    spare : smallest clearance of the witness [m]
    bar : length of bars [m]
    radius : radius of payloads in space [m]
    height : size of the workspace across the path [m]
    room : room besides the payload where it rotates [m]
    ends : length of the workspace before the first wall and behind the last, besides that of the payload [m]
    tries : positions that are tried for an obstacle before a restart
    """

    ratio: Range
    width: Range
    walls: tuple[int, int]
    clutter: tuple[int, int]
    manipulators: tuple[int, int]
    thickness: Range
    corridor: Range
    size: Range
    spare: float
    bar: float = 0.2
    radius: float = 0.005
    height: float = 1.0
    room: float = 0.01
    ends: float = 0.05
    tries: int = 60


DIFFICULTIES = {
    "easy": Difficulty(
        (1.1, 1.6), (1.5, 2.0), (1, 1), (0, 2), (2, 2), (0.02, 0.06), (0.05, 0.15), (0.02, 0.06), 0.006
    ),
    "hard": Difficulty(
        (0.45, 0.9), (1.15, 1.5), (1, 3), (2, 6), (2, 3), (0.02, 0.08), (0.02, 0.12), (0.02, 0.07), 0.006
    ),
    "extreme": Difficulty(
        (0.15, 0.45), (1.1, 1.3), (2, 4), (8, 16), (2, 4), (0.01, 0.15), (0.0, 0.08), (0.02, 0.09), 0.004
    ),
}


@dataclass(frozen=True, eq=False)
class Witness:
    """Sequence of payload poses that proves a scene feasible.

    Attributes
    ----------
    center : array, shape (n_poses, 3), origin of the payload's frame, the mean of the end effectors [m]
    quaternion : array, shape (n_poses, 4), w x y z; the payload rotates the shorter way from one to the next
    held : array, shape (n_manipulators, 3), end effectors in the payload's frame [m]
    """

    center: Array
    quaternion: Array
    held: Array

    @classmethod
    def from_rows(cls, rows: list[list[float]], scene: Scene) -> Witness:
        """Build a witness from a file's poses, beginning at the scene's start.

        Parameters
        ----------
        rows : a pose each: x, y [m] and an angle [rad] in the plane; x, y, z [m] and a quaternion w, x, y, z in space
        """
        center, quaternion = poses(np.array(rows, dtype=float))
        return cls(center, quaternion, (spatial(scene.start) - center[0]) @ matrices(quaternion[0]))

    @property
    def reach(self) -> float:
        """Return the distance of the farthest end effector from the centre [m]."""
        return float(np.linalg.norm(self.held, axis=1).max())

    def hands(self, n_samples: int = 801) -> Array:
        """Return the end effectors at even times of the movement. Array, shape (n_samples, n_manipulators, 3) [m]."""
        turns = np.stack(
            [
                logarithm(quaternion_product(conjugate(before), after))
                for before, after in zip(self.quaternion, self.quaternion[1:], strict=False)
            ]
        )
        moves = np.diff(self.center, axis=0)
        ways = np.linalg.norm(moves, axis=1) + self.reach * np.linalg.norm(turns, axis=1)
        ends = np.cumsum(np.append(0.0, ways + WHERE_NOTHING_MOVES))
        s = np.linspace(0.0, ends[-1], n_samples)
        k = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(moves) - 1)
        share = minimum_jerk((s - ends[k]) / (ends[k + 1] - ends[k]))[:, None]
        center = self.center[k] + share * moves[k]
        rotation = matrices(quaternion_product(self.quaternion[k], exponential(share * turns[k])))
        return center[:, None] + np.einsum("tij,nj->tni", rotation, self.held)

    def judged(self, scene: Scene) -> ExecutionReport:
        """Return the continuous-time verification report on the witness."""
        hands = self.hands()[:, :, : scene.n_dims]
        return verify_execution(RecordSamples(scene, np.linspace(0.0, scene.duration, len(hands)), hands))


def poses(rows: Array) -> tuple[Array, Array]:
    """Return centres and quaternions of poses in a file's rows. Arrays, shapes (n_poses, 3) and (n_poses, 4)."""
    if rows.shape[1] == 7:
        return rows[:, :3], rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    zero, half = np.zeros(len(rows)), 0.5 * rows[:, 2]
    center = np.stack([rows[:, 0], rows[:, 1], zero], axis=1)
    return center, np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)


def drawn(name: str, difficulty: Difficulty, n_dims: int, seed: list[int]) -> tuple[dict[str, Any], Array]:
    """Sample a scene; return its file contents and its witness's poses.

    Parameters
    ----------
    seed : seed of all random numbers, one or several

    Returns
    -------
    data : contents of a scene file
    rows : array, shape (n_poses, 3 or 7), in the format of `Witness.from_rows`
    """
    rng = np.random.default_rng(seed)
    while True:
        draft = _Draft(name, difficulty, n_dims, rng)
        if draft.feasible() and draft.cluttered():
            return draft.data(), draft.rows


class _Draft:
    """Scene during sampling."""

    def __init__(self, name: str, difficulty: Difficulty, n_dims: int, rng: np.random.Generator):
        self.name, self.difficulty, self.n_dims, self.rng = name, difficulty, n_dims, rng
        self.radius = difficulty.radius if n_dims == 3 else 0.0
        low, high = difficulty.manipulators
        self.held = _held(rng, int(rng.integers(low, high + 1)), difficulty.bar)
        self.reach = float(np.linalg.norm(self.held, axis=1).max()) + self.radius
        self.aside = self.reach + difficulty.spare + difficulty.room
        self.obstacles: list[dict[str, Any]] = []
        self.length, self.rows = self._around_walls()

    def _around_walls(self) -> tuple[float, Array]:
        """Sample the walls; return the workspace length [m] and the poses."""
        d, rng, aside = self.difficulty, self.rng, self.aside
        x, found = 2 * aside + d.ends + rng.uniform(*d.corridor), [self._end(aside)]
        for k in range(int(rng.integers(d.walls[0], d.walls[1] + 1))):
            thickness = round(rng.uniform(*d.thickness), 3)
            x += (rng.uniform(*d.corridor) if k else 0.0) + thickness / 2
            middle = round(x, 3)
            opening, turn, off = self._opening()
            at = np.round(rng.uniform(aside, d.height - aside, self.n_dims - 1), 3)
            self.obstacles += _wall(middle, thickness, at, opening, d.height)
            for side in (-1, 1):
                found.append(self._row(middle + side * (thickness / 2 + aside), at - off, turn))
            x = middle + thickness / 2 + 2 * aside
        length = round(x + d.ends + rng.uniform(*d.corridor), 2)
        found.append(self._end(length - aside))
        return length, np.array(found)

    def _end(self, x: float) -> list[float]:
        at = self.rng.uniform(self.aside, self.difficulty.height - self.aside, self.n_dims - 1)
        return self._row(x, at, _any_turn(self.rng, self.n_dims, np.pi))

    def _row(self, x: float, at: Array, turn: Array) -> list[float]:
        center = np.round([x, *at], 4)
        if self.n_dims == 2:
            return [*center, round(2 * float(np.arctan2(turn[3], turn[0])), 4)]
        return [*center, *np.round(turn, 5)]

    def _opening(self) -> tuple[Array, Array, Array]:
        """Sample an opening and an orientation in which the payload fits.

        Returns
        -------
        opening : array, shape (n_dims - 1,), its sizes across the direction of travel [m]
        turn : array, shape (4,), an orientation of the payload
        off : array, shape (n_dims - 1,), middle of the payload's extent in this orientation, relative to its centre
            [m]
        """
        d, rng = self.difficulty, self.rng
        need = 2 * (self.radius + d.spare) + 0.001
        narrowest, along = _narrowest(self.held)
        if len(self.held) == 2:
            opening = d.bar * rng.uniform(*d.ratio, self.n_dims - 1)
        else:
            opening = np.array([narrowest * rng.uniform(*d.width) + need])
            if self.n_dims == 3:
                opening = rng.permutation(np.append(opening, narrowest * rng.uniform(*d.ratio)))
        opening = np.maximum(opening, need + 0.003).round(3)
        for tilt in TILTS:
            for _ in range(16):
                turn = quaternion_product(_any_turn(rng, self.n_dims, tilt), self._best(along, opening))
                # As the file will hold it.
                turn = poses(np.array([self._row(0.0, np.zeros(self.n_dims - 1), turn)]))[1][0]
                across = (self.held @ matrices(turn).T)[:, 1 : self.n_dims]
                if (np.ptp(across, axis=0) + need <= opening).all():
                    return opening, turn, 0.5 * (across.max(axis=0) + across.min(axis=0))
        raise AssertionError("the best pose fits")

    def _best(self, along: float, opening: Array) -> Array:
        """Return an orientation of least width along x and the opening."""
        rng = self.rng
        turn = np.array([np.cos(along / 2), 0, 0, np.sin(along / 2)])
        flip = np.array([0.0, 0, 0, 1]) if rng.random() < 0.5 else np.array([1.0, 0, 0, 0])
        turn = quaternion_product(flip, turn)
        if self.n_dims == 3 and (len(self.held) == 2 or opening[0] < opening[1]):
            quarter = np.sqrt(0.5) * np.array([1.0, rng.choice([-1.0, 1.0]), 0, 0])
            turn = quaternion_product(quarter, turn)
        return turn

    def data(self) -> dict[str, Any]:
        """Return the contents of a scene file."""
        center, quaternion = poses(self.rows)
        hands = [
            np.round(center[end] + self.held @ matrices(quaternion[end]).T, 10)[:, : self.n_dims]
            for end in (0, -1)
        ]
        names = list(NAMES[: len(self.held)])
        edges = [[a, b] for a, b in zip(names, names[1:] + names[:1], strict=True)]
        load = (
            {"shape": "bar", "length": self.difficulty.bar}
            if len(names) == 2
            else {"shape": "frame", "edges": edges}
        )
        return scene_contents(
            self.name,
            [self.length, *[self.difficulty.height] * (self.n_dims - 1)],
            self.obstacles,
            load | ({"radius": self.radius} if self.radius else {}),
            hands,
        )

    def feasible(self, obstacles: list[dict[str, Any]] | None = None) -> bool:
        """Return whether the witness is verified with a margin. `obstacles` replaces those of the draft."""
        data = self.data()
        try:
            scene = Scene.from_dict(data if obstacles is None else data | {"obstacles": obstacles})
        except SceneError:  # an end in an obstacle
            return False
        report = Witness.from_rows(self.rows.tolist(), scene).judged(scene)
        return not report.reasons and report.clearance_min >= self.difficulty.spare

    def cluttered(self) -> bool:
        """Add clutter clear of the path; return False without room for it."""
        d, rng = self.difficulty, self.rng
        scene = Scene.from_dict(self.data())
        swept = Witness.from_rows(self.rows.tolist(), scene).hands().mean(axis=1)[:, : self.n_dims]
        for _ in range(int(rng.integers(d.clutter[0], d.clutter[1] + 1))):
            for _ in range(d.tries):
                near = swept[rng.integers(len(swept))] + rng.normal(0.0, 0.8 * self.reach, self.n_dims)
                center = np.round(np.clip(near, 0.02, scene.upper - 0.02), 3)
                obstacle = clutter(rng, center, rng.uniform(*d.size))
                if self.feasible([obstacle]):
                    self.obstacles.append(obstacle)
                    break
            else:
                return False
        return self.feasible()


def _held(rng: np.random.Generator, n_hands: int, bar: float) -> Array:
    """Sample the end effectors of a bar, triangle or rectangle."""
    if n_hands == 2:
        return np.array([[-bar / 2, 0.0, 0.0], [bar / 2, 0.0, 0.0]])
    long, wide = round(rng.uniform(0.16, 0.22), 3), round(rng.uniform(0.08, 0.13), 3)
    corners = [[0, -wide / 2], [0, wide / 2], [long, 0]]
    if n_hands == 4:
        corners = [[0, -wide / 2], [0, wide / 2], [long, wide / 2], [long, -wide / 2]]
    points = np.array([[*corner, 0.0] for corner in corners], dtype=float)
    return points - points.mean(axis=0)


def _narrowest(held: Array) -> tuple[float, float]:
    """Return the payload's least width across x [m], and its angle. The angle is about z [rad]."""
    angles = np.linspace(-np.pi, np.pi, 721)
    across = held[:, 0] * np.sin(angles)[:, None] + held[:, 1] * np.cos(angles)[:, None]
    widths = np.ptp(across, axis=1)
    return float(widths.min()), float(angles[np.argmin(widths)])


def _any_turn(rng: np.random.Generator, n_dims: int, most: float) -> Array:
    """Sample a rotation by at most `most` [rad]; array, shape (4,). In the plane it is about z."""
    if n_dims == 2:
        return exponential(np.array([0.0, 0.0, rng.uniform(-most, most)]))
    if most == np.pi:
        turn = rng.standard_normal(4)
        return turn / np.linalg.norm(turn)
    axis = rng.standard_normal(3)
    return exponential(rng.uniform(0.0, most) * axis / np.linalg.norm(axis))


def _wall(x: float, thickness: float, at: Array, opening: Array, height: float) -> list[dict[str, Any]]:
    """Return boxes of a wall across x with an opening around `at`. Numbers are rounded for files."""
    low, high = np.round(at - opening / 2, 4), np.round(at + opening / 2, 4)
    return [
        box | {key: [round(value, 5) for value in box[key]] for key in ("center", "size")}
        for box in wall(x, thickness, low, high, height)
    ]


def clutter(rng: np.random.Generator, center: Array, size: float) -> dict[str, Any]:
    """Sample a sphere, a rotated box, or a rotated capsule."""
    shape = str(rng.choice(["sphere", "box", "capsule"]))
    found: dict[str, Any] = {"shape": shape, "center": center.tolist()}
    if shape == "sphere":
        return found | {"radius": round(size, 3)}
    if shape == "box":
        found["size"] = np.round(size * rng.uniform(0.6, 2.0, len(center)), 3).tolist()
    else:
        found |= {"radius": round(0.4 * size, 3), "length": round(size * rng.uniform(1.5, 3.0), 3)}
    if len(center) == 2:
        return found | {"rotation_deg": round(rng.uniform(-90.0, 90.0), 1)}
    return found | {"quaternion_wxyz": np.round(_any_turn(rng, 3, np.pi), 4).tolist()}
