"""The query agrees with obstacles that are placed first, and its normals are those of the distance.

The scene places tables and corners forward and has kernels of its own; the query carries the body back.
"""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from comove.contacts.displaced import carried_back, carried_forward, turned_forward
from comove.contacts.query import (
    Query,
    ball_of,
    least_distance,
    nearest_point,
    normal_at,
    part_apart,
    separating,
)
from comove.contacts.surroundings import corner_of, count_corners, count_parts, surroundings_of, whose
from comove.geometry.distances import point_distance
from comove.model import Scene
from comove.model.moving import Displacements
from tests.cases import examples
from tests.meshes import l_profile, write_stl
from tests.verification.random_boxes import box_near_contact
from tests.verification.random_motions import near_contact, on_scene, scene_data, with_turning_obstacles

seeds = st.integers(0, 2**32 - 1)
FAR = 1.0  # m
N_TIMES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("meshes")
    write_stl(made / "l.stl", *l_profile())
    return made


def drawn(rng, folder):
    """A random motion past obstacles that move and turn: rods, boxes; convex obstacles, a mesh; some are near."""
    while True:
        kind = rng.integers(3)
        motion = near_contact(rng, moving=0.7) if kind == 0 else box_near_contact(rng)
        if kind > 0:
            center = rng.uniform(-0.5, 0.5, 3) + motion.scene.start.mean(axis=0)
            mesh = {"shape": "mesh", "file": "l.stl", "center": center.tolist()}
            motion = with_turning_obstacles(motion, rng, [mesh] if kind == 2 else [], folder)
        if motion is None:
            continue
        n_dims = motion.scene.n_dims
        unbounded = {"lower": [-1e3] * n_dims, "upper": [1e3] * n_dims}  # the query is of obstacles alone
        motion = on_scene(motion, scene_data(motion.scene) | {"workspace": unbounded}, folder)
        if min(apart(motion.scene, *states(motion, N_TIMES)[2:], 2), default=FAR) < FAR:
            return motion


def apart(scene, nodes, times, k):
    """Distances from each obstacle at one of the times, as the scene places obstacles [m]."""
    return [scene.nearest_at(nodes[k], times[k], among=[i])[0] for i in range(len(scene.motions))]


def states(motion, n):
    """Surroundings, displacements, nodes and times of even samples."""
    s = np.linspace(0.0, 1.0, n)
    nodes = motion.coordinates.motion(motion.at(s))[0]
    times = s * motion.scene.duration
    return surroundings_of(motion.scene), motion.scene.displacements(times), nodes, times


def asked(around, scene, tolerance=1e-8):
    """A query of everything."""
    normals = separating(len(scene.body.solids), around.n_things)
    least = np.full(len(scene.motions), FAR)
    return Query(np.arange(around.n_things), normals, least, tolerance, 0.0)


@examples(36)
@given(seed=seeds)
def test_distances_are_those_of_obstacles_placed_first(folder, seed):
    rng = np.random.default_rng(seed)
    motion = drawn(rng, folder)
    scene, (around, moved, nodes, times) = motion.scene, states(motion, N_TIMES)
    for k in range(len(times)):
        query, instant = asked(around, scene), (k, k, 0.0)
        found = least_distance(around, moved, instant, nodes[k], query, FAR, -np.inf)
        each = apart(scene, nodes, times, k)
        for distance, told in zip(query.least, each, strict=True):
            assert (distance <= 0.0) == (told <= 0.0) or abs(told) < 1e-6
        told = min(each)
        if told > 0.0:
            assert found == pytest.approx(min(told, FAR), abs=1e-6)
        else:
            assert found <= 1e-9
        query = query._replace(least=np.empty(0))
        capped = least_distance(around, moved, instant, nodes[k], query, FAR, 0.5 * FAR)
        assert (capped <= 0.5 * FAR) == (found <= 0.5 * FAR)


@examples(20)
@given(seed=seeds, share=st.floats(0.0, 1.0))
def test_between_samples_offsets_and_angles_change_linearly(folder, seed, share):
    motion = drawn(np.random.default_rng(seed), folder)
    around, moved, nodes, _ = states(motion, N_TIMES)
    now = Displacements.of(
        *((1 - share) * moved.offsets[[2]] + share * moved.offsets[[3]], moved.centers),
        (1 - share) * moved.angles[[2]] + share * moved.angles[[3]],
        moved.axes,
    )
    found = least_distance(around, moved, (2, 3, share), nodes[2], asked(around, motion.scene), FAR, -np.inf)
    placed = least_distance(around, now, (0, 0, 0.0), nodes[2], asked(around, motion.scene), FAR, -np.inf)
    assert found == pytest.approx(placed, abs=1e-9)


@examples(40)
@given(seed=seeds)
def test_a_part_comes_nearer_by_as_much_as_it_is_moved_against_the_normal(folder, seed):
    """From everything that is clear of it; and bounding balls never say that it is farther away than it is."""
    rng = np.random.default_rng(seed)
    motion = drawn(rng, folder)
    around, moved, nodes, _ = states(motion, N_TIMES)
    instant, near, normal = (2, 3, 0.3), np.empty(3), np.array([1.0, 0.0, 0.0])
    checked = 0
    for part in range(count_parts(around)):
        own = [corner_of(around, part, i) for i in range(count_corners(around, part))]
        for thing in range(around.n_things):
            row, _ = whose(around, thing)

            def seen(x, row=row, own=own):
                return np.array([carried_back(moved, row, instant, *x[i]) for i in own])

            def distance(x, part=part, thing=thing, row=row):
                return nearest_point(around, part, thing, row, seen(x), FAR, 1e-10, near, normal)

            d = distance(nodes[2])
            assert (
                part_apart(around, moved, instant, nodes[2], part, thing, row, np.inf) <= d + 1e-9 or d == FAR
            )
            if not 1e-3 < d < FAR:
                continue
            normal_at(around, part, thing, row, near, normal)
            carried_forward(moved, row, instant, near)
            turned_forward(moved, row, instant, normal)
            x, y, z, reach = ball_of(around, nodes[2], part)
            assert np.linalg.norm(near - [x, y, z]) <= reach + 1e-9
            step = 0.5 * d * normal
            assert distance(nodes[2] - step) == pytest.approx(0.5 * d, abs=1e-5)
            checked += 1
    assume(checked)


@examples(40)
@given(seed=seeds)
def test_a_rod_in_an_obstacle_is_told_where_it_is_deepest(seed):
    """Along a rod the slope of the depth jumps where another face of a box becomes the nearest one."""
    scene, points = Scene.from_dict(boxed()), np.random.default_rng(seed).uniform(-0.5, 0.5, (2, 3))
    around, near, normal = surroundings_of(scene), np.empty(3), np.empty(3)
    d = nearest_point(around, 0, 0, 0, points, FAR, 1e-8, near, normal)
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    on = points[0] + share * (points[1] - points[0])
    least = min(point_distance(around.obstacles, 0, *x) for x in on) - around.radii[0]
    assert d == pytest.approx(least, abs=2e-3)
    assert point_distance(around.obstacles, 0, *near) - around.radii[0] == pytest.approx(d, abs=1e-6)


def boxed():
    """A scene with a box and a bar."""
    hands = [{"name": n, "start": [2, y, 2], "goal": [2, y, 3]} for n, y in (("a", -0.5), ("b", 0.5))]
    return {
        "name": "box",
        "duration": 5.0,
        "workspace": {"lower": [-5] * 3, "upper": [5] * 3},
        "obstacles": [{"shape": "box", "center": [0, 0, 0], "size": [0.3, 0.4, 0.5]}],
        "load": {"shape": "bar", "length": 1.0},
        "manipulators": hands,
    }
