"""Courses in time: costs by brute force over all courses, and nearness by distances of points on capsules."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from comove.control.safety.qp_workspace import Sighting
from comove.geometry.distances import CENTER
from comove.model import Scene
from comove.robots.online.courses import (
    WAIT,
    Movers,
    Places,
    SlotCosts,
    dangers,
    dangers_along,
    fewer,
    instants_near,
    least_costs,
)
from comove.robots.online.roadmap import Roadmap
from comove.robots.search.links import place_links
from tests.robots.online.test_link_rows import at_start

COSTS = SlotCosts(met=0.02, near=0.1, depth=0.03, hitting=300.0, meeting=100.0, nearness=10.0)
BALL = {"shape": "sphere", "radius": 0.08}
UPRIGHT = {"shape": "capsule", "radius": 0.08, "length": 0.3}


def network():
    """A triangle with its goal at 2: 0 to 1 takes two slots, with sample 3 on the way, 1 to 2 one, and 0 to 2 takes
    three, by samples 4, 5.
    """
    ways = [
        (0, 1, 2, 3, 1),
        (1, 0, 2, 3, -1),
        (1, 2, 1, 0, 1),
        (2, 1, 1, 0, 1),
        (0, 2, 3, 4, 1),
        (2, 0, 3, 5, -1),
    ]
    source, target, slots, begin, stride = (np.array(column) for column in zip(*ways, strict=True))
    nowhere = np.zeros((6, 1))
    return Roadmap(nowhere, nowhere, np.arange(3), 2, source, target, slots, begin, stride)


def cheapest(net, cost, left, node, slot):
    """Least cost by trying everything."""
    last = cost.shape[0] - 1
    if slot == last:
        return left[node]
    found = [cost[slot + 1, net.nodes[node]] + (node != net.goal) + cheapest(net, cost, left, node, slot + 1)]
    for e in range(len(net.source)):
        d, there = int(net.slots[e]), int(net.target[e])
        if net.source[e] == node and slot + d <= last:
            inside = sum(cost[slot + 1 + s, net.begin[e] + s * net.stride[e]] for s in range(d - 1))
            rest = cheapest(net, cost, left, there, slot + d)
            found.append(d + inside + cost[slot + d, net.nodes[there]] + rest)
    return min(found)


@pytest.mark.parametrize("seed", range(6))
def test_no_course_is_cheaper_than_the_one_that_is_chosen(seed):
    net, rng = network(), np.random.default_rng(seed)
    cost = rng.choice([0.0, 0.5, 100.0], (7, 6), p=[0.5, 0.2, 0.3])
    left = np.array([4.0, 1.0, 0.0])
    value, choice = least_costs(net, cost, left)
    for node, slot in product(range(3), range(7)):
        assert value[slot, node] == pytest.approx(cheapest(net, cost, left, node, slot))
    assert ((choice == WAIT) | (net.source[choice] == np.arange(3))).all()


def ball(center, velocity, shape=BALL):
    """A sighting of a ball, or of something else that moves."""
    scene = Scene.from_dict(
        {
            "name": "ball",
            "duration": 5.0,
            "workspace": {"lower": [-2, -2, -2], "upper": [2, 2, 2]},
            "obstacles": [{**shape, "center": list(center)}],
            "manipulators": [{"name": "a", "start": [-1, -1, -1], "goal": [-1, -1, 1]}],
        }
    )
    return Sighting.still(scene)._replace(velocity=np.array([velocity]))


@pytest.mark.parametrize(
    ("shape", "half", "spin"),
    [(BALL, 0.0, [0, 0, 0]), (UPRIGHT, 0.15, [0, 0, 0]), (UPRIGHT, 0.15, [1.5, -0.8, 0.4])],
)
@pytest.mark.parametrize("seed", range(8))
def test_what_comes_how_near_is_as_points_on_capsules_say(seed, shape, half, spin):
    rng = np.random.default_rng(seed)
    start, end, radius = (
        rng.uniform(-0.5, 0.5, (5, 4, 3)),
        rng.uniform(-0.5, 0.5, (5, 4, 3)),
        rng.uniform(0, 0.1, 4),
    )
    begins, times = rng.uniform(-1, 1, 3), np.linspace(0.3, 4.0, 30)
    seen = ball(begins, (rng.uniform(-0.3, 0.3, 3) - begins) / 2, shape)
    seen = seen._replace(spin=np.array([spin], dtype=float))
    found = dangers(Places(start, end, radius), Movers.of(seen), times, COSTS).T
    center = seen.table[0, CENTER : CENTER + 3] + times[:, None] * seen.velocity[0]
    points = start[..., None, :] + np.linspace(0, 1, 400)[:, None] * (end - start)[..., None, :]
    off = points[:, None] - center[:, None, None]
    axis = Rotation.from_rotvec(times[:, None] * seen.spin[0]).apply([0.0, 0.0, 1.0])[:, None, None]
    off -= np.clip((off * axis).sum(axis=-1, keepdims=True), -half, half) * axis
    apart = np.linalg.norm(off, axis=-1).min(axis=-1)
    h = (apart - radius - 0.08).min(axis=-1)
    wanted = np.interp(h, [-0.01, 0.02], [300.0, 100.0])
    wanted = np.where(h < 0.02, wanted, 10.0 * (np.clip(0.1 - h, 0, None) / 0.08) ** 2)
    sure = np.abs(h - 0.02) > 1e-3
    assert 0 < (wanted > 0).sum() < wanted.size
    np.testing.assert_allclose(found[sure], wanted[sure], atol=0.1, rtol=0.01)
    rows = np.array([0, 3, 4, 1, 2])
    bodies = Places(start[rows], end[rows], radius)
    alone = dangers_along(bodies, Movers.of(seen), times[:5], COSTS)
    np.testing.assert_allclose(alone, found[rows, np.arange(5)])


@given(
    arrays(float, 3, elements=st.floats(-1, 1)),
    arrays(float, 3, elements=st.sampled_from([0.0, 1e-12, 0.01, -0.03, 0.2])),
    st.floats(0.01, 1.0),
)
def test_the_instants_of_nearness_are_those_that_distances_tell(off, step, far):
    first, last = instants_near(off, step, far, 30)
    away = np.linalg.norm(off + np.arange(30)[:, None] * step, axis=1)
    sure, among = np.abs(away - far) > 1e-6, np.arange(30)
    np.testing.assert_array_equal(((among >= first) & (among < last))[sure], (away <= far)[sure])
    assert 0 <= first <= last <= 30


def test_what_stands_is_as_near_at_all_times():
    rng = np.random.default_rng(3)
    bodies = Places(*rng.uniform(-0.3, 0.3, (2, 4, 3, 3)), np.full(3, 0.05))
    still = Movers.of(ball([0.2, 0.1, 0.0], [0.0, 0.0, 0.0]))
    found = dangers(bodies, still, np.linspace(0, 2, 9), COSTS)
    np.testing.assert_array_equal(found, np.repeat(found[:1], 9, axis=0))


def test_fewer_links_hold_all_of_them():
    carrier, q, _ = at_start()
    links = carrier.arms.links
    which, radius = fewer(links, 0.015)
    assert len(which) < len(links.moving)
    assert (radius <= links.radius[which] + 0.015 + 1e-12).all()
    a, b = links.start.copy(), links.end.copy()
    place_links(carrier.arms.chains, links, q, a, b)
    rng = np.random.default_rng(0)
    for i in links.moving:
        away = rng.normal(size=(40, 3))
        away *= links.radius[i] / np.linalg.norm(away, axis=1, keepdims=True)
        surface = a[i] + rng.uniform(size=(40, 1)) * (b[i] - a[i]) + away
        along = b[which] - a[which]
        share = np.einsum("pka,ka->pk", surface[:, None] - a[which], along)
        share = np.clip(share / np.maximum((along**2).sum(axis=1), 1e-18), 0, 1)
        off = np.linalg.norm(surface[:, None] - a[which] - share[..., None] * along, axis=-1)
        assert ((off - radius).min(axis=1) <= 1e-9).all()
