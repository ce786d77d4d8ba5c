"""Feasible random scenes for benchmarks and tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import SceneError
from comove.lab.examples import scene_contents
from comove.lab.examples import wall as wall_boxes
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.configurations import configuration_space
from comove.planning.planner import plan

Array = NDArray[np.float64]

SPARE = 0.006  # m, that the kept scenes leave
BAR = 0.2  # m
TRIANGLE = 0.16  # m, its sides
DURATION, SPEED, ACCELERATION = 5.0, 0.5, 2.0  # s, m/s, m/s^2, of scenes with obstacles that move
TRIES = 12  # plans before a scene is given up


def planar_scene(seed: int, *, central: bool = False) -> Scene:
    """Sample a planar scene with a bar, walls and discs. There are one to three walls (gap 0.45 to 1.4 bar lengths)
    and up to two discs. Gaps and ends lie anywhere across the workspace, or nearer to its middle if `central`, which
    makes the paths shorter."""
    return _first_passable(np.random.default_rng([seed, 2]), lambda rng: _planar(rng, seed, central))


def spatial_bar_scene(seed: int) -> Scene:
    """Sample a spatial scene with a bar, walls and bodies. There are one or two walls with a window narrower than
    the bar, and up to four bodies."""
    return _first_passable(np.random.default_rng([seed, 3]), lambda rng: _spatial(rng, seed, 2))


def spatial_triangle_scene(seed: int) -> Scene:
    """Sample a scene with a triangle held by three end effectors. There are one or two walls with a window, and up
    to four bodies."""
    return _first_passable(np.random.default_rng([seed, 4]), lambda rng: _spatial(rng, seed, 3))


def moving_scene(seed: int, share: float = 1.0) -> Scene:
    """Sample a scene with one to four moving obstacles. They have up to `share` of the end effectors' speed, besides
    up to two static obstacles. Planar and spatial scenes alternate, and every other pair of them has three end
    effectors instead of two. The scene may have no solution."""
    rng = np.random.default_rng([seed, 5])
    n_dims, n_hands = 2 + seed % 2, 2 + seed // 2 % 2
    while True:
        try:
            scene = Scene.from_dict(_moving(rng, seed, n_dims, n_hands, share * SPEED))
        except SceneError:  # an end in an obstacle: draw again
            continue
        if scene.clearance_at(scene.nodes_at("start"))[0] > 2 * SPARE:
            return scene


def _moving(rng: np.random.Generator, seed: int, n_dims: int, n_hands: int, fastest: float) -> dict[str, Any]:
    still = [_ball(rng, n_dims, 0.25, 0.75) for _ in range(int(rng.integers(0, 3)))]
    moving = [_ball(rng, n_dims, 0.1, 0.9) for _ in range(int(rng.integers(1, 5)))]
    for obstacle in moving:
        obstacle["motion"] = _motion(rng, np.array(obstacle["center"]), fastest)
    side = BAR if n_hands == 2 else TRIANGLE
    angles = np.pi / n_hands + 2 * np.pi / n_hands * np.arange(n_hands)
    held = (
        side / (2 * np.sin(np.pi / n_hands)) * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    )
    ends = []
    for x in (0.16, 0.84):
        if n_dims == 3:
            ends.append(_spatial_hands(rng, held, x))
        else:
            turn = rng.uniform(-np.pi, np.pi)
            c, s = np.cos(turn), np.sin(turn)
            ends.append(np.array([x, rng.uniform(0.2, 0.8)]) + held[:, :2] @ np.array([[c, s], [-s, c]]))
    edges = [["a", "b"], ["b", "c"], ["c", "a"]]
    load: dict[str, Any] = {"shape": "frame", "edges": edges, "radius": 0.005}
    if n_hands == 2:
        load = {"shape": "bar", "length": BAR, "radius": 0.005}
    data = scene_contents(f"moving-{seed}", [1.0] * n_dims, still + moving, load, ends)
    return {**data, "duration": DURATION, "limits": {"speed": SPEED, "acceleration": ACCELERATION}}


def _ball(rng: np.random.Generator, n_dims: int, low: float, high: float) -> dict[str, Any]:
    """Sample a sphere, a box, or a capsule."""
    center = rng.uniform(low, high, n_dims).tolist()
    shape, size = rng.choice(["sphere", "box", "capsule"]), rng.uniform(0.03, 0.09)
    if shape == "sphere":
        return {"shape": "sphere", "center": center, "radius": size}
    if shape == "box":
        return {"shape": "box", "center": center, "size": rng.uniform(0.06, 0.18, n_dims).tolist()}
    return {"shape": "capsule", "center": center, "radius": size / 2, "length": 2 * size}


def _motion(rng: np.random.Generator, center: Array, fastest: float) -> dict[str, Any]:
    """Sample a constant velocity, a path between points, or a circle. The speed is a fifth of the largest or more."""
    speed, kind = fastest * rng.uniform(0.2, 1.0), rng.integers(3)
    if kind == 0:
        direction = rng.standard_normal(len(center))
        return {"velocity": (speed * direction / np.linalg.norm(direction)).tolist()}
    if kind == 1:
        points = [center, *rng.uniform(0.1, 0.9, (int(rng.integers(1, 5)), len(center)))]
        times = np.cumsum([0.0, *(np.linalg.norm(np.diff(points, axis=0), axis=1) / speed)])
        return {"waypoints": [p.tolist() for p in points], "times": times.tolist()}
    radius = rng.uniform(0.08, 0.25)
    return {"circle": {"radius": radius, "period_s": 2 * np.pi * radius / speed}}


def _first_passable(rng: np.random.Generator, draw: Callable[[np.random.Generator], dict[str, Any]]) -> Scene:
    while True:
        try:
            scene = Scene.from_dict(draw(rng))
        except SceneError:  # an end in an obstacle: draw again
            continue
        coordinates = load_coordinates(scene)
        space, ends = configuration_space(scene, coordinates), coordinates.boundary()
        clear = min(scene.clearance_at(scene.nodes_at(end))[0] for end in ("start", "goal"))
        if clear < 2 * SPARE:
            continue
        if any(plan(space, ends[0], ends[2], SPARE, rng, max_nodes=3000) is not None for _ in range(TRIES)):
            return scene


def _planar(rng: np.random.Generator, seed: int, central: bool) -> dict[str, Any]:
    walls = int(rng.integers(1, 4))
    obstacles: list[dict[str, Any]] = []
    for wall in range(walls):
        x = 0.5 + (wall - (walls - 1) / 2) * 0.2 + rng.uniform(-0.02, 0.02)
        gap, thickness = BAR * rng.uniform(0.45, 1.4), rng.uniform(0.02, 0.08)
        middle = rng.uniform(0.25, 0.75) if central else rng.uniform(gap / 2 + 0.05, 0.95 - gap / 2)
        obstacles += wall_boxes(x, thickness, np.array([middle - gap / 2]), np.array([middle + gap / 2]))
    for _ in range(int(rng.integers(0, 3))):
        center = rng.uniform([0.25, 0.1], [0.75, 0.9])
        obstacles.append(
            {"shape": "circle", "center": center.tolist(), "radius": float(rng.uniform(0.02, 0.06))}
        )
    aside = 0.2 if central else 0.35
    hands = [_planar_hands(rng, 0.14, aside), _planar_hands(rng, 0.86, aside)]
    return scene_contents(f"planar-{seed}", [1.0] * 2, obstacles, {"shape": "bar", "length": BAR}, hands)


def _planar_hands(rng: np.random.Generator, x: float, aside: float) -> Array:
    angle = rng.uniform(-np.pi, np.pi)
    center = np.array([x, 0.5 + rng.uniform(-aside, aside)])
    along = BAR / 2 * np.array([np.cos(angle), np.sin(angle)])
    return np.stack([center - along, center + along])


def _spatial(rng: np.random.Generator, seed: int, n_hands: int) -> dict[str, Any]:
    obstacles: list[dict[str, Any]] = []
    walls = int(rng.integers(1, 3))
    side, narrowest, widest = (BAR, 0.5, 0.9) if n_hands == 2 else (TRIANGLE, 0.9, 1.3)
    for wall in range(walls):
        x = 0.5 + (wall - (walls - 1) / 2) * 0.26
        obstacles += _window(rng, x, side * rng.uniform(narrowest, widest, 2), rng.uniform(0.02, 0.06))
    for _ in range(int(rng.integers(0, 5))):
        center = rng.uniform([0.25, 0.1, 0.1], [0.75, 0.9, 0.9]).tolist()
        if rng.random() < 0.5:
            obstacles.append({"shape": "sphere", "center": center, "radius": float(rng.uniform(0.02, 0.06))})
        else:
            turn = rng.standard_normal(4)
            obstacles.append(
                {
                    "shape": "box",
                    "center": center,
                    "size": rng.uniform(0.04, 0.12, 3).tolist(),
                    "quaternion_wxyz": (turn / np.linalg.norm(turn)).tolist(),
                }
            )
    if n_hands == 2:
        held = np.array([[-BAR / 2, 0, 0], [BAR / 2, 0, 0]])
        load: dict[str, Any] = {"shape": "bar", "length": BAR, "radius": 0.005}
    else:
        angles = np.pi / 2 + 2 * np.pi / 3 * np.arange(3)
        held = side / np.sqrt(3) * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        load = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], "radius": 0.005}
    hands = [_spatial_hands(rng, held, x) for x in (0.14, 0.86)]
    return scene_contents(f"spatial-{n_hands}-{seed}", [1.0] * 3, obstacles, load, hands)


def _spatial_hands(rng: np.random.Generator, held: Array, x: float) -> Array:
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    rotation = q * np.sign(np.diag(r))
    rotation *= np.sign(np.linalg.det(rotation))
    return np.array([x, *rng.uniform(0.2, 0.8, 2)]) + held @ rotation.T


def _window(rng: np.random.Generator, x: float, size: Array, thickness: float) -> list[dict[str, Any]]:
    """Return boxes of a wall across x with a window. Its size is (y, z)."""
    middle = rng.uniform(0.2 + size / 2, 0.8 - size / 2)
    return wall_boxes(x, thickness, middle - size / 2, middle + size / 2)
