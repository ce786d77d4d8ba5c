"""Paths of the planner: the load keeps clear by coal, and arms follow by Pinocchio, with links that keep clear."""

from itertools import product

import coal
import numpy as np
import pinocchio as pin
import pytest

from comove.model.coordinates import load_coordinates
from comove.planning.configurations import clearance_of, configuration_space, edge_is_free
from comove.planning.planner import plan
from comove.planning.world import World, _shortens
from comove.robots.carrying import RobotCarrier
from comove.robots.search.capsules import PROUDEST
from comove.robots.search.following import MET
from comove.robots.search.links import FAT, ROUGH
from comove.robots.search.planner import LEADING, SETTINGS, CarryingArms, dense, follow_edge, follow_path
from tests.robots.search.test_links import between, obstacle, solid
from tests.robots.small_robots import POST, columns, gantry_scene, grasp_errors, robot, task

MARGIN = 0.01  # m
EXAMPLES = [
    *((name, seed, MARGIN) for name in ("gantry", "gap_26") for seed in (0, 1)),
    *((name, 0, 0.0) for name in ("two_pandas", "ur5_and_panda")),
]
WALL = {"shape": "box", "center": [0.0, 0.0, 0.2], "size": [0.1, 2.6, 0.5]}


def space_of(scene):
    return configuration_space(scene, load_coordinates(scene))


def planned(carrying, seed, margin=MARGIN, max_nodes=1000, tries=40):
    """A path of the load that the arms can follow, None where none was found."""
    boundary, rng = load_coordinates(carrying.scene).boundary(), np.random.default_rng(seed)
    for _ in range(tries):
        path = carrying.plan(
            space_of(carrying.scene), boundary[0], boundary[2], margin, rng, max_nodes=max_nodes
        )
        if path is not None:
            return path
    return None


def led(carrying, path):
    """A path with close vertices, and joints that follow it from one of the starts; two arrays."""
    space, around, n = space_of(carrying.scene), carrying.arms.around, path.shape[1]
    arms = carrying.arms._replace(around=around._replace(clearance=around.clearance - FAT))  # as lenient
    whole = np.hstack([path, np.zeros((len(path), len(carrying.robot.joint_names)))])
    for first, last in product(product(*carrying.starts), product(*carrying.goals)):
        course = np.stack([np.concatenate(first), np.concatenate(last)])
        world = World.of(space, arms=CarryingArms(arms, n, course, SETTINGS))
        if follow_path(world, fine := dense(world, whole)):
            return fine[:, :n], fine[:, n:]
    raise AssertionError("no start leads along the path")


def finely(path, step=0.01):
    """Configurations (x, y, z, heading) along a path; array, shape (n, 4)."""
    rows = [path[:1]]
    for p, q in zip(path[:-1], path[1:], strict=True):
        count = int(np.ceil((np.linalg.norm(q[:3] - p[:3]) + 0.4 * abs(q[3] - p[3])) / step)) + 1
        rows.append(p + np.linspace(0, 1, count + 1)[1:, None] * (q - p))
    return np.concatenate(rows)


@pytest.fixture(scope="module", params=EXAMPLES, ids=str)
def found(request):
    """A task and a path in its load's space."""
    name, seed, margin = request.param
    path = planned(task(name), seed, margin)
    assert path is not None
    return task(name), path, margin


def test_paths_lead_from_start_to_goal_without_jumps_of_the_heading(found):
    carrying, path, _ = found
    nodes = load_coordinates(carrying.scene).nodes(np.ascontiguousarray(path[[0, -1]].T[None]))[0]
    for end, at in zip(("start", "goal"), nodes, strict=True):
        np.testing.assert_allclose(at, carrying.scene.nodes_at(end), atol=1e-9)
    assert np.abs(np.diff(path[:, 3])).max() < np.pi


def test_the_load_keeps_clear_of_obstacles_and_inside_the_workspace(found):
    carrying, path, margin = found
    scene, space = carrying.scene, space_of(carrying.scene)
    nodes = load_coordinates(scene).nodes(np.ascontiguousarray(finely(path).T[None]))[0]
    scratch = np.empty((space.blocks.node.shape[0], 3))
    at_ends = min(clearance_of(space, q, scratch, 0.0) for q in (path[0], path[-1]))
    need = min(margin, 0.5 * at_ends) - 1e-4
    things = [obstacle(part) for part in scene.file.obstacles]
    for at in nodes:
        for (i, j), radius in zip(scene.body.edges, scene.body.radii, strict=True):
            rod = solid(at[i], at[j], max(radius, 1e-6))
            assert min(between(rod, thing) for thing in things) > need
    assert (nodes >= scene.lower).all()
    assert (nodes <= scene.upper).all()


def test_arms_follow_with_links_that_keep_clear(found):
    carrying, path, _ = found
    machine, scene = carrying.robot, carrying.scene
    fine, joints = led(carrying, path)
    assert max(np.linalg.norm(np.diff(fine[:, :3], axis=0), axis=1)) <= SETTINGS.spacing + 1e-9
    nodes = load_coordinates(scene).nodes(np.ascontiguousarray(fine.T[None]))[0]
    hands = nodes[:, : len(carrying.holders)]
    wanted = np.zeros((*hands.shape[:2], 4, 4))
    wanted[..., :3, 3], wanted[..., 3, 3] = hands, 1.0
    wanted[..., :3, :3] = scene.grasp.hand_rotations(hands)
    position = np.tile(machine.home, (len(fine), 1))
    position[:, columns(carrying.holders)] = joints
    assert grasp_errors(machine, carrying.holders, position, wanted)[1:].max() < LEADING.tolerance + 1e-6
    assert (position >= machine.lower).all()
    assert (position <= machine.upper).all()
    assert np.abs(np.diff(joints, axis=0)).max() < 2 * SETTINGS.jump  # two sub-steps an edge
    things = [obstacle(part) for part in scene.file.obstacles]
    data, geometry = machine.model.createData(), machine.collision.createData()
    corner, led_clearance = PROUDEST + ROUGH, carrying.arms.around.clearance - FAT
    for q in position[1:]:
        pin.updateGeometryPlacements(machine.model, data, machine.collision, geometry, q)
        for item, pose in zip(machine.collision.geometryObjects, geometry.oMg, strict=True):
            if item.parentJoint > 0:
                body = item.geometry, coal.Transform3s(pose.rotation, pose.translation)
                assert min(between(body, thing) for thing in things) > led_clearance - corner


@pytest.mark.parametrize("seed", [0, 5, 7, 12])
def test_motions_along_a_path_are_followed_without_contact_where_the_plan_was(seed):
    """From other joints arms may follow the same path as well, and meet each other."""
    carrying = RobotCarrier(robot("two_pandas"), task("two_pandas").scene)
    path = planned(carrying, seed, 0.002, max_nodes=200)
    nodes = load_coordinates(carrying.scene).nodes(np.ascontiguousarray(finely(path).T[None]))
    strain = carrying.strain(nodes, carrying.best_course(nodes[0]))
    assert strain.missing.max() <= MET
    assert strain.clearance[0] > carrying.arms.around.clearance - 2 * FAT


def test_the_same_seed_gives_the_same_path():
    one, other = (planned(RobotCarrier(robot("gantry"), gantry_scene()), 3) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_the_straight_way_is_taken_where_it_is_free():
    path = planned(RobotCarrier(robot("gantry"), gantry_scene(())), 0)
    np.testing.assert_allclose(path[:, 1:], np.tile(path[0, 1:], (len(path), 1)), atol=1e-12)
    assert (np.diff(path[:, 0]) > 0).all()


def test_no_path_leads_through_a_wall():
    carrying = RobotCarrier(robot("gantry"), gantry_scene((WALL,)))
    assert planned(carrying, 0, max_nodes=300, tries=2) is None


def test_no_path_leads_where_an_arm_cannot_follow_though_the_load_could():
    """The load would pass beneath a beam, but the columns that hold it would not."""
    beam = {"shape": "box", "center": [0.0, 0.0, 0.75], "size": [0.1, 2.6, 0.3]}
    carrying = RobotCarrier(robot("gantry"), gantry_scene((beam,)))
    boundary = load_coordinates(carrying.scene).boundary()
    rng = np.random.default_rng(0)
    assert plan(space_of(carrying.scene), boundary[0], boundary[2], MARGIN, rng) is not None
    assert planned(carrying, 0, max_nodes=300, tries=2) is None


def test_an_edge_is_refused_when_an_arm_is_left_behind_or_links_touch():
    scene = gantry_scene((POST,), workspace={"lower": [-2, -2, 0], "upper": [2, 2, 1]})
    carrying = RobotCarrier(robot("gantry"), scene)
    boundary, joints = load_coordinates(scene).boundary(), np.concatenate([s[0] for s in carrying.starts])
    carrying = CarryingArms(carrying.arms, len(boundary[0]), np.stack([joints, joints]), SETTINGS)
    world, begin = World.of(space_of(scene), arms=carrying), np.concatenate([boundary[0], joints])
    for shift, free in (((0.0, 0.1, 0.0), True), ((0.0, 1.0, 0.0), False), ((0.6, 0.5, 0.0), False)):
        target = begin.copy()
        target[:3] += shift
        assert follow_edge(carrying, world, begin, target) is free


def test_arms_are_led_along_no_shortcut_that_the_payload_blocks():
    carrying, rng = task("gantry"), np.random.default_rng(3)
    space, boundary = space_of(carrying.scene), load_coordinates(carrying.scene).boundary()
    n, joints = boundary.shape[1], np.concatenate([arm.home for arm in carrying.holders])
    world = World.of(space, arms=CarryingArms(carrying.arms, n, np.stack([joints, joints]), SETTINGS))
    nodes, free = np.empty((space.blocks.node.shape[0], 3)), []
    for _ in range(60):
        p, q = (
            np.append(rng.uniform(boundary.min(axis=0) - 0.1, boundary.max(axis=0) + 0.1), joints)
            for _ in range(2)
        )
        free.append(edge_is_free(space, p, q, MARGIN, np.empty(len(p)), nodes))
        assert _shortens(world, p, q, np.inf, MARGIN) == free[-1]
        assert _shortens(World.of(space), p[:n].copy(), q[:n].copy(), np.inf, MARGIN)
        assert not _shortens(world, p, q, 0.0, MARGIN)
    assert 10 < sum(free) < 50
