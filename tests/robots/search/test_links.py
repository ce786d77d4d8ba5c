"""Links as capsules: where they are, and how far they are from everything."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from comove.contacts.displaced import RESTING
from comove.errors import ComoveWarning
from comove.model import Scene
from comove.robots import Robot
from comove.robots.search.capsules import PROUDEST, capsules_of
from comove.robots.search.chains import chains_of
from comove.robots.search.links import (
    ENOUGH,
    ROUGH,
    LinkSurroundings,
    all_links,
    body_distances,
    links_clearance,
    links_of,
    pair_distances,
    place_links,
    recalled,
)
from tests.robots import small_robots
from tests.robots.known_carry import TABLE, posts, scene_data
from tests.robots.small_robots import BUNDLED, RANDOM, robot, urdf, written


def around(obstacles, edges, radii):
    """LinkSurroundings in which nothing is held."""
    return LinkSurroundings(obstacles, edges, radii, clearance=0.0, eased=0.0)


NOTHING = around(np.zeros((0, 16)), np.zeros((0, 2), dtype=np.int64), np.zeros(0))


def start_and_end(links):
    return links.start.copy(), links.end.copy()


@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM, "gantry"])
@pytest.mark.few(2)
def test_capsules_go_along_with_their_bodies(name):
    machine, rng = robot(name), np.random.default_rng(4)
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    columns = np.concatenate([arm.columns for arm in machine.arms])
    data, (start, end) = machine.model.createData(), start_and_end(links)
    capsules = [
        (item, *capsule)
        for item in machine.collision.geometryObjects
        for capsule in capsules_of(item.geometry, item.parentJoint > 0)
    ]
    assert len(links.radius) == len(capsules)
    for q in rng.uniform(machine.lower, machine.upper, (5, len(machine.lower))):
        place_links(chains, links, q[columns], start, end)
        pin.forwardKinematics(machine.model, data, q)
        poses = [data.oMi[item.parentJoint] * item.placement for item, *_ in capsules]
        wanted = [
            np.hstack([pose.act(a), pose.act(b), r])
            for pose, (_, a, b, r) in zip(poses, capsules, strict=True)
        ]
        numbers_of(np.reshape(wanted, (-1, 7)), np.column_stack([start, end, links.radius]))


def numbers_of(wanted, found):
    """Numbers of the rows that equal wanted ones, each of them once."""
    left = list(range(len(found)))
    for row in wanted:
        at = min(left, key=lambda k: np.abs(found[k] - row).max())
        np.testing.assert_allclose(found[at], row, atol=1e-12)
        left.remove(at)
    return [k for k in range(len(found)) if k not in left]


def test_an_arm_that_carries_nothing_stands_at_home():
    machine = robot("baxter")
    left, _ = machine.arms
    links, chains = links_of(machine, (left,)), chains_of(machine, (left,))
    both = links_of(machine, machine.arms)
    start, end = start_and_end(both)
    place_links(chains_of(machine, machine.arms), both, machine.home, start, end)
    mine = numbers_of(np.hstack([start, end])[both.arm == 1], np.hstack([links.start, links.end]))
    assert (links.joint[mine] < 0).all()
    a, b = start_and_end(links)
    place_links(chains, links, left.home + 0.1, a, b)
    np.testing.assert_array_equal(a[mine], links.start[mine])


def test_a_robot_without_collision_bodies_has_no_links(tmp_path):
    text = urdf(
        '<link name="tip"/><joint name="j" type="revolute"><parent link="base"/><child link="tip"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    )
    description = {"models": [{"urdf": "r.urdf"}], "arms": {"left": {"tip": "tip"}}}
    with pytest.warns(ComoveWarning):  # of what the model leaves out
        machine = Robot.load(written(tmp_path, {"r.urdf": text}, description))
    links = links_of(machine, machine.arms)
    assert links_clearance(links, NOTHING, RESTING, *start_and_end(links), np.zeros((2, 3)), 0.3) == 0.3


def solid(a, b, radius):
    """A capsule for coal: its shape, and where it is."""
    along = b - a
    length = np.linalg.norm(along)
    turn = pin.Quaternion.FromTwoVectors(
        np.array([0, 0, 1.0]), along / length if length > 1e-12 else np.eye(3)[2]
    )
    shape = coal.Capsule(radius, length) if length > 1e-12 else coal.Sphere(radius)
    return shape, coal.Transform3s(turn.matrix(), 0.5 * (a + b))


def between(one, other):
    """Distance by coal; negative inside."""
    result = coal.DistanceResult()
    return coal.distance(*one, *other, coal.DistanceRequest(), result)


def obstacle(part):
    """An obstacle of the scene for coal."""
    shape = {
        "box": lambda: coal.Box(*part.size),
        "cylinder": lambda: coal.Cylinder(part.radius, part.height),
        "sphere": lambda: coal.Sphere(part.radius),
    }[part.shape]()
    return shape, coal.Transform3s(np.eye(3), np.array(part.center))


def surrounded():
    """The benchmark's scene with something at the height of the elbows."""
    ball = {"shape": "sphere", "center": [0.4, 0.6, 0.3], "radius": 0.1}
    high = {"shape": "box", "center": [0.5, -0.7, 0.4], "size": [0.1, 0.2, 0.3]}
    return Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.3), ball, high)))


def test_clearances_are_those_of_the_capsules_in_coal():
    machine, scene = robot("baxter"), surrounded()
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    body, rng, (start, end), told = scene.body, np.random.default_rng(5), start_and_end(links), []
    things = [obstacle(part) for part in scene.file.obstacles]
    for _ in range(60):
        q = machine.home + rng.uniform(-0.6, 0.6, len(machine.home))
        place_links(chains, links, q, start, end)
        nodes = scene.nodes_at("start") + rng.uniform(-0.3, 0.3, 3)
        capsules = [solid(*capsule) for capsule in zip(start, end, links.radius, strict=True)]
        load = [
            solid(nodes[a], nodes[b], radius)
            for (a, b), radius in zip(body.edges, body.radii, strict=True)
            if a != b
        ]
        cap = 0.1
        wanted = [between(capsules[i], thing) for i in links.moving for thing in things]
        wanted += [between(capsules[i], rod) for i in np.flatnonzero(~links.holds) for rod in load]
        wanted += [between(capsules[i], capsules[j]) for i, j in links.pairs]
        scenery = around(scene.obstacles, body.edges, body.radii)
        found = links_clearance(links, scenery, RESTING, start, end, nodes, cap)
        told.append(found)
        if min(wanted) > -0.01:
            assert found == pytest.approx(min(cap, *wanted), abs=2 * ROUGH)
        else:
            assert found < 0.0
    assert min(told) < 0.0 < max(told) <= cap


def test_a_search_never_takes_links_for_freer_than_they_are_by_more_than_what_sticks_out():
    machine, scene = robot("baxter"), surrounded()
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    body, rng, (start, end) = scene.body, np.random.default_rng(6), start_and_end(links)
    columns = np.concatenate([arm.columns for arm in machine.arms])
    data, far = machine.model.createData(), np.full((scene.body.n_nodes, 3), 10.0)
    things = [obstacle(part) for part in scene.file.obstacles]
    pairs = links.some(np.zeros(len(links.pairs), dtype=bool))
    for _ in range(60):
        q = machine.home + rng.uniform(-0.6, 0.6, len(machine.home))
        place_links(chains, links, q[columns], start, end)
        pin.forwardKinematics(machine.model, data, q)
        exact = min(
            between((item.geometry, coal.Transform3s(pose.rotation, pose.translation)), thing)
            for item in machine.collision.geometryObjects
            if item.parentJoint > 0
            for pose in [data.oMi[item.parentJoint] * item.placement]
            for thing in things
        )
        scenery = around(scene.obstacles, body.edges, body.radii)
        found = links_clearance(pairs, scenery, RESTING, start, end, far, 0.1)
        assert found <= max(exact, 0.0) + PROUDEST + ROUGH


def clearance_of_links(machine, links, q):
    """Least distance of the links from each other at joints of all arms [m]."""
    start, end = start_and_end(links)
    place_links(chains_of(machine, machine.arms), links, q[small_robots.columns(machine.arms)], start, end)
    return links_clearance(links, NOTHING, RESTING, start, end, np.zeros((2, 3)), 0.2)


@pytest.mark.parametrize("name", ["ur5_and_panda", "two_ur10", "random 0"])
def test_no_pair_of_bodies_of_two_arms_is_left_out_that_can_meet(name):
    machine, rng = robot(name), np.random.default_rng(11)
    every, bodies = all_links(machine, machine.arms)
    across = every.some(every.arm[every.pairs[:, 0]] != every.arm[every.pairs[:, 1]])
    across = across.some((across.arm[across.pairs] >= 0).all(axis=1))
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    columns, met = small_robots.columns(machine.arms), 0
    for q in rng.uniform(machine.lower, machine.upper, (12000, len(machine.lower))):
        apart = pair_distances(chains, across, q[None, columns])
        if (pairs := bodies[across.pairs[apart < -0.02]]).size:
            exact = body_distances(machine, machine.arms, q[columns], pairs).min()
            if exact < 0.0:
                met += 1
                assert clearance_of_links(machine, links, q) <= PROUDEST
    assert met > 1


@pytest.mark.parametrize("name", ["gantry", "two_pandas", "g1"])
@pytest.mark.few(1)
def test_pairs_are_left_out_by_proof_alone(name):
    machine, rng = robot(name), np.random.default_rng(12)
    chains, (every, _) = chains_of(machine, machine.arms), all_links(machine, machine.arms)
    kept = {tuple(pair) for pair in links_of(machine, machine.arms).pairs.tolist()}
    out = every.some(np.array([tuple(pair) not in kept for pair in every.pairs.tolist()], dtype=bool))
    samples = rng.uniform(chains.lower, chains.upper, (600, len(chains.lower)))
    assert not (pair_distances(chains, out, samples) < ENOUGH).any()


def test_clearances_are_those_of_all_pairs_one_by_one():
    machine, rng = robot("g1"), np.random.default_rng(13)
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    columns = small_robots.columns(machine.arms)
    for q in rng.uniform(machine.lower, machine.upper, (200, len(machine.lower))):
        one_by_one = pair_distances(chains, links, q[None, columns]).min()
        assert min(clearance_of_links(machine, links, q), ENOUGH) == pytest.approx(min(one_by_one, ENOUGH))


def test_capsules_that_meet_at_home_are_told_as_far_apart_as_their_bodies():
    """The shoulders' capsules of a G1 are in that of its trunk, which the shoulders can meet."""
    machine, rng = robot("g1"), np.random.default_rng(14)
    links, columns = links_of(machine, machine.arms), small_robots.columns(machine.arms)
    _, bodies = all_links(machine, machine.arms)
    wide = links.some(links.wider > 0.0)
    exact = body_distances(machine, machine.arms, machine.home[columns], bodies[wide.pairs])
    told = pair_distances(chains_of(machine, machine.arms), wide, machine.home[None, columns])
    assert exact.min() > 0.0 and (told[np.isfinite(told)] <= exact[np.isfinite(told)] + 1e-9).all()
    for q in rng.uniform(machine.lower, machine.upper, (200, len(machine.lower))):
        exact = body_distances(machine, machine.arms, q[columns], bodies[wide.pairs])
        if exact.min() <= -0.01:
            again = recalled(machine, machine.arms, links, q[columns], 0.01)
            assert (again.wider <= links.wider).all()
            assert clearance_of_links(machine, again, q) <= exact.min() + PROUDEST
            assert clearance_of_links(machine, again, machine.home) <= clearance_of_links(
                machine, links, machine.home
            )
            break
    else:
        raise AssertionError("nothing met")


def test_links_count_as_farther_from_each_other_by_what_they_need_less():
    machine = robot("two_pandas")
    chains, links = chains_of(machine, machine.arms), links_of(machine, machine.arms)
    home, (a, b) = np.concatenate([arm.home for arm in machine.arms]), start_and_end(links)
    place_links(chains, links, home, a, b)
    plain, eased = (
        links_clearance(links, NOTHING._replace(eased=less), RESTING, a, b, np.zeros((2, 3)), 0.5)
        for less in (0.0, 0.004)
    )
    assert eased == pytest.approx(plain + 0.004)
