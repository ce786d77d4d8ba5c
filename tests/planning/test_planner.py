"""Planned paths start and end right, keep margin and distances along every edge, and are the same for the same seed.

Clearances are judged by brute force on configurations between those that the planner names.
"""

from importlib.resources import files

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.model import Scene, load_coordinates
from comove.planning.configurations import configuration_space, span
from comove.planning.planner import _fit, flat_direction, plan, quaternion_of
from tests import brute_force
from tests.solved import example, random_scene
from tests.verification.random_motions import scene_data

SCENES = ["wide", "narrow", "complex", "planar 0", "planar 3", "bar 0", "bar 1", "triangle 0"]
N_BETWEEN = 40  # configurations looked at along every edge


def scene_named(name):
    kind, _, number = name.partition(" ")
    return random_scene(kind, int(number)) if number else example(name)


def planned(scene, margin, seed, **options):
    """A path and its coordinates; several attempts, as the solver makes them."""
    coordinates = load_coordinates(scene)
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    rng = np.random.default_rng(seed)
    for _ in range(20):
        path = plan(space, ends[0], ends[2], margin, rng, **options)
        if path is not None:
            return path, coordinates
    return None, coordinates


def between(coordinates, path):
    """Configurations along all edges: centres on lines, orientations on great circles, by SciPy's rotations."""
    shares, n_dims, column = np.linspace(0.0, 1.0, N_BETWEEN), coordinates.n_dims, 0
    edges = np.repeat(path[:-1], N_BETWEEN, axis=0)
    ends = np.repeat(path[1:], N_BETWEEN, axis=0)
    f = np.tile(shares, len(path) - 1)[:, None]
    q = edges + f * (ends - edges)
    for group in coordinates.groups:
        column += n_dims
        if group.orientation in ("plane", "vertical"):
            column += 1
        elif group.orientation == "axis":
            part = slice(column, column + 3)
            axis = np.cross(edges[:, part], ends[:, part])
            sine, cosine = np.linalg.norm(axis, axis=1), (edges[:, part] * ends[:, part]).sum(axis=1)
            axis /= np.maximum(sine, 1e-300)[:, None]
            turn = Rotation.from_rotvec(axis * (f[:, 0] * np.arctan2(sine, cosine))[:, None])
            q[:, part] = turn.apply(edges[:, part])
            column += 3
        elif group.orientation == "space":
            part = [column + 1, column + 2, column + 3, column]
            first, last = Rotation.from_quat(edges[:, part]), Rotation.from_quat(ends[:, part])
            turn = (first.inv() * last).as_rotvec()
            q[:, part] = (first * Rotation.from_rotvec(f * turn)).as_quat()
            column += 4
    return q


def closed(n_dims, shape="bar"):
    """A wall without a gap."""
    rest = [0.5] * (n_dims - 1)
    hands = {"a": [0.15, 0.4, *rest[1:]], "b": [0.15, 0.6, *rest[1:]], "c": [0.25, 0.5, *rest[1:]]}
    hands = dict(list(hands.items())[: 2 if shape == "bar" else 3])
    load = {"shape": "bar", "length": 0.2}
    if shape == "frame":
        load = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]]}
    return Scene.from_dict(
        {
            "name": "closed",
            "duration": 10.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": [{"shape": "box", "center": [0.5, *rest], "size": [0.02, *[1.2] * (n_dims - 1)]}],
            "load": load,
            "manipulators": [
                {"name": name, "start": at, "goal": [at[0] + 0.6, *at[1:]]} for name, at in hands.items()
            ],
        }
    )


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("margin", [0.005, 0.002])
@pytest.mark.few(5)
def test_every_edge_keeps_the_margin(name, margin):
    scene = scene_named(name)
    path, coordinates = planned(scene, margin, seed=1)
    assert path is not None
    ends = coordinates.boundary()
    hands = brute_force.hands_of(coordinates, path)
    assert np.abs(hands[0] - scene.start).max() < 1e-12
    assert np.abs(hands[-1] - scene.goal).max() < 1e-12
    assert np.array_equal(path[0], ends[0])
    q = between(coordinates, path)
    at_ends = brute_force.configuration_clearance(scene, hands[[0, -1]]).min()
    clearance = brute_force.configuration_clearance(scene, brute_force.hands_of(coordinates, q))
    assert clearance.min() >= min(margin, 0.5 * at_ends) - 1e-6
    hands = brute_force.hands_of(coordinates, q)
    for c in scene.distances:
        apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
        assert np.abs(apart - c.distance).max() < 1e-12


@pytest.mark.parametrize("name", ["narrow", "bar 0", "triangle 0"])
def test_the_margin_comes_on_top_of_the_clearance_that_is_asked_for(name):
    data = scene_data(scene_named(name))
    scene = Scene.from_dict(data | {"limits": {"clearance": 0.004}})
    path, coordinates = planned(scene, 0.002, seed=0, required=0.004)
    assert path is not None
    hands = brute_force.hands_of(coordinates, between(coordinates, path))
    assert brute_force.configuration_clearance(scene, hands).min() >= 0.006 - 1e-6


@pytest.mark.parametrize("name", ["narrow", "complex", "bar 0", "triangle 0"])
def test_paths_are_continuous(name):
    """Neighbours are near in the plain numbers too: angles unwrapped, quaternions of one sign, units of length 1."""
    path, coordinates = planned(scene_named(name), 0.004, seed=2)
    column = coordinates.n_dims
    orientation = coordinates.groups[0].orientation
    turn = path[:, column:]
    if orientation == "plane":
        assert np.abs(np.diff(turn, axis=0)).max() <= np.pi
    else:
        assert np.abs(np.linalg.norm(turn, axis=1) - 1.0).max() < 1e-9
    if orientation == "space":
        assert ((turn[1:] * turn[:-1]).sum(axis=1) >= 0).all()


@pytest.mark.parametrize("name", ["narrow", "planar 3", "bar 0", "triangle 0"])
def test_the_same_seed_gives_the_same_path(name):
    scene = scene_named(name)
    first, second, other = (planned(scene, 0.004, seed)[0] for seed in (7, 7, 8))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(("n_dims", "shape"), [(2, "bar"), (3, "bar"), (2, "frame"), (3, "frame")])
def test_a_closed_wall_has_no_path(n_dims, shape):
    path, _ = planned(closed(n_dims, shape), 0.0005, seed=0, max_nodes=200)
    assert path is None


def test_an_empty_scene_is_crossed_on_a_straight_line():
    for n_dims in (2, 3):
        data = scene_data(closed(n_dims)) | {"obstacles": []}
        path, _ = planned(Scene.from_dict(data), 0.004, seed=0)
        assert len(path) == 2


def test_shortcuts_leave_little_to_gain():
    """A path of the narrow scene is not much longer than the best that ten attempts find."""
    scene = example("narrow")
    space = configuration_space(scene, load_coordinates(scene))
    lengths = []
    for seed in range(10):
        path, _ = planned(scene, 0.004, seed)
        lengths.append(sum(span(space, p, q) for p, q in zip(path[:-1], path[1:], strict=True)))
    assert min(lengths) >= 0.7  # the way of the centre alone
    assert np.median(lengths) < 1.25 * min(lengths)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_two_loads_at_once(n_dims):
    """Two bars that swap sides around a pillar: groups of their own, one path."""
    rest = [0.5] * (n_dims - 2)
    hands = [[0.2, 0.3], [0.2, 0.5], [0.8, 0.5], [0.8, 0.7]]
    goals = [[0.8, 0.2], [0.8, 0.4], [0.2, 0.6], [0.2, 0.8]]
    scene = Scene.from_dict(
        {
            "name": "swap",
            "duration": 10.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": [{"shape": "sphere", "center": [0.5, 0.4, *rest], "radius": 0.1}],
            "constraints": [
                {"type": "distance", "between": ["a", "b"], "distance": 0.2},
                {"type": "distance", "between": ["c", "d"], "distance": 0.2},
            ],
            "manipulators": [
                {"name": name, "start": [*start, *rest], "goal": [*goal, *rest]}
                for name, start, goal in zip("abcd", hands, goals, strict=True)
            ],
        }
    )
    path, coordinates = planned(scene, 0.004, seed=0)
    hands = brute_force.hands_of(coordinates, between(coordinates, path))
    assert brute_force.configuration_clearance(scene, hands).min() >= 0.004 - 1e-6
    for i, j in ((0, 1), (2, 3)):
        assert np.abs(np.linalg.norm(hands[:, i] - hands[:, j], axis=1) - 0.2).max() < 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_quaternions_of_rotations_are_scipys(seed):
    rotation, found = Rotation.random(random_state=seed), np.empty(4)
    quaternion_of(rotation.as_matrix(), found)
    expected = rotation.as_quat(scalar_first=True)
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-12


@pytest.mark.parametrize("seed", range(10))
def test_what_is_to_fit_a_slot_lies_flush(seed):
    """The normal of a triangle, and one of its edges, are along axes of the turned box."""
    turn = Rotation.random(random_state=seed)
    box = {
        "shape": "box",
        "center": [0.5, 0.5, 0.9],
        "size": [0.1, 0.1, 0.1],
        "quaternion_wxyz": turn.as_quat(scalar_first=True).tolist(),
    }
    data = scene_data(example("triangle")) | {"obstacles": [box]}
    scene = Scene.from_dict(data)
    space = configuration_space(scene, load_coordinates(scene))
    points, quaternion = space.blocks.point, np.empty(4)
    flat = flat_direction(points)
    np.testing.assert_allclose((points - points.mean(axis=0)) @ flat, 0.0, atol=1e-12)
    _fit(space, 0, flat, np.random.default_rng(seed), quaternion)
    placed = Rotation.from_quat(quaternion, scalar_first=True).apply(points)
    edges = [placed[i] - placed[j] for i, j in ((0, 1), (1, 2), (2, 0))]
    normal = np.cross(edges[0], edges[1])
    seen = [turn.inv().apply(v / np.linalg.norm(v)) for v in (normal, *edges)]
    assert np.abs(seen[0]).max() == pytest.approx(1.0, abs=1e-9)
    assert max(np.abs(edge).max() for edge in seen[1:]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("name", ["spatial-10", "spatial-18", "spatial-19"])
def test_frames_pass_slots_edge_on(name):
    """Each has three walls with a slot that the triangle passes in few orientations alone."""
    scene = Scene.load(str(files("comove") / "lab" / "sets" / "hard" / f"{name}.yaml"))
    assert planned(scene, 0.004, seed=0, max_nodes=3000)[0] is not None
