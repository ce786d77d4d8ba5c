"""Rows of links: their slopes are those of distances, by differences of distances alone."""

from functools import lru_cache

import numpy as np
import pytest

from comove.contacts.rods import nearest_shares
from comove.control.safety.cbf_qp import SafetyFilter
from comove.control.safety.qp_workspace import HANDS, Rates, Sighting
from comove.control.safety.twists import advanced, nodes_of, poses_of
from comove.geometry.closest_points import near_on_edge
from comove.model import Scene
from comove.model.coordinates import HandPoses
from comove.robots.carrying import RobotCarrier
from comove.robots.online.link_rows import LinkNeeds, empty_rows, link_rows
from comove.robots.search.links import place_links
from tests.robots.known_carry import TABLE, scene_data
from tests.robots.small_robots import robot

STEP = 1e-6
RATES = Rates(0.004, 10.0, 0.5, 0.5, 0.25, 0.5, 1.0, 0.01)
THINGS = [
    TABLE,
    {"shape": "sphere", "center": [0.9, 0.75, 0.4], "radius": 0.1},
    {"shape": "capsule", "center": [0.5, -0.75, 0.5], "radius": 0.05, "length": 0.3},
]


@lru_cache(maxsize=1)
def at_start():
    """A carrier on the known scene, joints at its start, and poses of its load."""
    carrier = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(obstacles=tuple(THINGS))))
    q = np.concatenate([starts[0] for starts in carrier.starts])
    return carrier, q, poses_of(carrier.scene, "start")


def told(q, poses, velocity=None, near=5.0, bounds=None):
    """All rows at joints and poses of the load, and the basis of the load's twists.

    With bounds of rates, those that may be broken within them.
    """
    carrier, _, _ = at_start()
    seen = Sighting.still(carrier.scene)
    if velocity is not None:
        seen = seen._replace(velocity=velocity)
    basis = SafetyFilter(carrier.scene)._freedom.basis[0]
    work = empty_rows(carrier.arms, len(seen.margin), basis.shape[1])
    needs = LinkNeeds(np.zeros(len(seen.margin)), 0.0, 0.0, near)
    count = link_rows(
        carrier.arms,
        q,
        (np.full_like(q, -1e6), np.full_like(q, 1e6)) if bounds is None else bounds,
        nodes_of(carrier.scene, poses),
        (basis, poses.center[0]),
        seen,
        (needs, RATES),
        work,
    )
    return work.rows[:count].copy(), work.low[:count].copy(), work.owner[:count].copy(), basis


def distances(q, poses):
    """Distances in the order of the rows, by geometry alone, also of what no joint and no load moves."""
    carrier, _, _ = at_start()
    (chains, links, _, around), nodes = carrier.arms, nodes_of(carrier.scene, poses)
    a, b = links.start.copy(), links.end.copy()
    place_links(chains, links, q, a, b)
    found = []
    for i in links.moving:
        found += [
            near_on_edge(around.obstacles, j, a[i], b[i], np.inf)[0] for j in range(len(around.obstacles))
        ]
    for i in np.flatnonzero(~links.holds):  # also those that do not move, as the load does
        found += [nearest_shares(a[i], b[i], nodes[c], nodes[d])[2] for c, d in around.edges if c != d]
    found += [nearest_shares(a[i], b[i], a[k], b[k])[2] for i, k in links.pairs]
    return np.array(found)


def along_joints(q, poses):
    """Slopes of all distances along the joints."""
    return np.array(
        [
            (distances(q + STEP * e, poses) - distances(q - STEP * e, poses)) / (2 * STEP)
            for e in np.eye(len(q))
        ]
    ).T


def along_load(q, poses):
    """Slopes of all distances along the load's twists."""
    carrier, _, _ = at_start()
    basis = SafetyFilter(carrier.scene)._freedom.basis[0]
    sides = [[advanced(poses, sign * twist[None], STEP) for sign in (1.0, -1.0)] for twist in basis.T]
    return np.array([(distances(q, there) - distances(q, back)) / (2 * STEP) for there, back in sides]).T


def moves(q, poses):
    """Whether something changes a distance: a row of one that nothing changes is not broken while all stands."""
    return (
        np.maximum(np.abs(along_joints(q, poses)).max(axis=1), np.abs(along_load(q, poses)).max(axis=1))
        > 1e-9
    )


def test_slopes_along_the_joints_are_those_of_the_distances():
    carrier, q, poses = at_start()
    rows, _, owner, basis = told(q, poses)
    n = basis.shape[1]
    slopes = along_joints(q, poses)[moves(q, poses)]
    assert len(rows) == len(slopes) > 100
    assert set(owner.tolist()) == {HANDS, 0, 1, 2}
    smooth = np.abs(rows[:, n:] - slopes).max(axis=1) < 1e-4
    assert smooth.mean() > 0.97  # the others change the feature that is nearest, as at edges of the table
    assert len(carrier.holders) == 2


def test_slopes_along_the_load_are_those_of_the_distances():
    carrier, q, poses = at_start()
    rows, _, _, basis = told(q, poses)
    slopes = along_load(q, poses)[moves(q, poses)]
    assert (np.abs(rows[:, : basis.shape[1]] - slopes) < 1e-4).mean(axis=0).min() > 0.97
    assert isinstance(poses, HandPoses)
    assert carrier.scene.n_dims == 3


def test_what_comes_nearer_asks_for_a_retreat():
    _, q, poses = at_start()
    still, low_still, owner_still, _ = told(q, poses)
    velocity = np.zeros((3, 3))
    velocity[1] = [0.0, -2.0, 0.0]
    rows, low, owner, _ = told(q, poses, velocity)
    moved = rows.any(axis=1)  # those that only what comes can break are told of as well
    assert (owner[~moved] == 1).all()
    rows, low, owner = rows[moved], low[moved], owner[moved]
    np.testing.assert_array_equal(rows, still)
    np.testing.assert_array_equal(owner, owner_still)
    mine = owner == 1
    np.testing.assert_array_equal(low[~mine], low_still[~mine])
    change = (low - low_still)[mine]
    assert change.max() > 0.5  # m/s, for links that the ball comes from the left to
    assert np.abs(change).max() <= 2.0 + 1e-12


def test_only_what_is_near_is_told_of():
    _, q, poses = at_start()
    everything = len(told(q, poses)[0])
    assert 0 < len(told(q, poses, near=0.2)[0]) < everything


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("near", [5.0, 0.3])
def test_what_is_left_out_holds_whatever_the_joints_do(near, seed):
    _, q, poses = at_start()
    rng = np.random.default_rng(seed)
    rates, velocity = rng.normal(0.0, 0.5, len(q)), rng.normal(0.0, 0.3, (3, 3))
    least, largest = rates - 0.05, rates + 0.05
    rows, low, owner, basis = told(q, poses, velocity, near)
    fewer, fewer_low, fewer_owner, _ = told(q, poses, velocity, near, (least, largest))
    keys = [(*row, lowest, who) for row, lowest, who in zip(rows, low, owner, strict=True)]
    kept = {(*row, lowest, who) for row, lowest, who in zip(fewer, fewer_low, fewer_owner, strict=True)}
    assert 0 < len(kept) < 0.8 * len(keys)
    assert kept <= set(keys)
    n = basis.shape[1]
    for row, lowest, key in zip(rows, low, keys, strict=True):
        worst = (np.where(row[n:] > 0.0, least, largest) * row[n:]).sum()
        of_load = row[:n].any()
        assert (key in kept) == (of_load or worst < lowest)


def test_large_tuples_enter_no_compiler_again(monkeypatch):
    """Numba's dispatcher asks for their types at every call, as at the first."""
    _, q, poses = at_start()
    found = distances(q, poses)

    def never():
        raise AssertionError("it entered the compiler")

    monkeypatch.setattr("comove.compiled.kernels.uncollected", never)
    assert (distances(q, poses) == found).all()
