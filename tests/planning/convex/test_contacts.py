"""Contacts are where brute force finds them, and their linear forms are the slopes that differences see."""

import numpy as np
import pytest

from comove.dmp.basis import motion_basis
from comove.model import Scene, load_coordinates
from comove.planning.convex import contacts as c
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings
from tests import brute_force
from tests.verification.random_motions import near_contact, on_scene, random_motion, scene_data

FAR = 0.3  # m
N = 201


def smooth_programme(motion):
    """A programme on the motion's scene, with its ends, and small random weights."""
    coordinates = load_coordinates(motion.scene)
    return ConvexProgramme(motion.scene, coordinates, motion_basis(12, "jerk"), coordinates.boundary())


def drawn(seed, **options):
    """A random programme among obstacles, and weights."""
    rng = np.random.default_rng([seed, 5])
    programme = smooth_programme(near_contact(rng))
    return programme, 0.01 * rng.standard_normal(programme.curves.n)


@pytest.mark.parametrize("seed", range(20))
def test_least_distances_are_those_of_brute_force(seed):
    programme, z = drawn(seed)
    need = np.zeros(programme.load.n_owners + 2)
    scene, seen = programme.curves.scene, programme.look(programme.curves.fine.q(z), FAR, need)
    a, b, radii = brute_force.body_of(scene, seen.nodes[:, : len(scene.manipulators), : scene.n_dims])
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    points = a[:, :, None] + shares * (b - a)[:, :, None]
    for i, obstacle in enumerate(scene.file.obstacles):
        truth = min(FAR, (brute_force.obstacle_distance(obstacle, points) - radii[:, None]).min())
        # Between samples it may be nearer than at any, by what a point moves from one to the next; what is far away
        # is looked at in every fourth.
        step = np.linalg.norm(np.diff(seen.nodes, axis=0), axis=2).max()
        more = 1e-6 if truth < c.CLOSE - 2 * step else c.COARSE * step
        assert truth - step - 1e-3 <= -seen.depth[i] <= truth + more


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.few(10)
def test_rows_are_the_slopes_of_distances(seed):
    """Of rods, points, solids, borders and hands that stay apart, in every kind of coordinates."""
    programme, z = drawn(seed)
    p, need = programme, np.zeros(programme.load.n_owners + 2)
    seen = p.look(p.curves.fine.q(z), FAR, need)
    rows, bound, _ = p.linear(seen, np.zeros((N, p.curves.fine.base.shape[1])), need)
    rng = np.random.default_rng(seed)
    step = 1e-6 * rng.standard_normal(p.curves.n)
    ahead, behind = (p.curves.nodes(p.curves.fine.q(z + s * step)) for s in (1, -1))
    checked = 0
    for row, contact, least in zip(rows, seen.contacts, bound, strict=True):
        if contact[c.TAU] != 0.0 or contact[c.OTHER] >= 0:
            continue
        assert contact[c.DISTANCE] == pytest.approx(-least)
        s, point = int(contact[c.SAMPLE]), contact[c.PLACE : c.PLACE + 3]
        own = np.flatnonzero(p.load.block == int(contact[c.BLOCK]))
        moved = [carried(nodes[s, own], seen.nodes[s, own], point) for nodes in (ahead, behind)]
        if moved[0] is None:
            continue
        slope = (moved[0] - moved[1]) @ contact[c.NORMAL : c.NORMAL + 3] / 2
        assert row @ step == pytest.approx(slope, abs=1e-10)
        checked += 1
    assert checked > 0 or not len(rows)


def carried(after, before, point):
    """Where a point of a rigid body is after its nodes have moved; None where these do not tell."""
    middle = before.mean(axis=0)
    spread = before - middle
    if len(before) == 1:
        return point + after[0] - before[0] if np.allclose(point, before[0]) else None
    share, *_ = np.linalg.lstsq(spread.T, point - middle, rcond=None)
    if np.abs(spread.T @ share - (point - middle)).max() > 1e-9:
        return None
    return after.mean(axis=0) + (after - after.mean(axis=0)).T @ share


def test_what_is_far_away_costs_no_contact():
    motion = random_motion(np.random.default_rng(3), n_dims=3, load="bar")
    data = scene_data(motion.scene) | {
        "obstacles": [{"shape": "sphere", "center": [-2.5] * 3, "radius": 0.1}]
    }
    programme = smooth_programme(on_scene(motion, data))
    seen = programme.look(programme.curves.fine.q(np.zeros(programme.curves.n)), 0.1, np.zeros(3))
    assert len(seen.contacts) == 0
    np.testing.assert_array_equal(seen.depth, [-0.1] * 3)


def test_a_moving_obstacle_is_met_where_it_is_then():
    """It crosses the way of one hand at half time, and is far from it before and after."""
    scene = Scene.from_dict(
        {
            "name": "crossing",
            "duration": 2.0,
            "workspace": {"lower": [-1, -1], "upper": [2, 2]},
            "manipulators": [{"name": "a", "start": [0, 0.5], "goal": [1, 0.5]}],
            "obstacles": [
                {"shape": "circle", "center": [0.5, 1.5], "radius": 0.1, "motion": {"velocity": [0, -1.0]}}
            ],
        }
    )
    coordinates = load_coordinates(scene)
    programme = ConvexProgramme(scene, coordinates, motion_basis(12, "jerk"), coordinates.boundary())
    need = programme.need(ConvexSettings())
    seen = programme.look(programme.curves.fine.q(np.zeros(programme.curves.n)), 0.05, need)
    near = seen.contacts[seen.contacts[:, c.OWNER] == 0]
    assert len(near) > 0
    assert np.abs(near[:, c.SAMPLE] / (N - 1) - 0.5).max() < 0.1
    assert near[:, c.DISTANCE].min() == pytest.approx(-0.1, abs=1e-3)
