"""Ways from home to the grasp and back home, against dense sampling that shares no code with their judge."""

import copy
import pickle
from dataclasses import replace
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import pytest

import comove
from comove import Scene
from comove.errors import OptionError, RobotError
from comove.robots import verify_joints
from comove.robots.free_space import Room
from comove.robots.transfers import Transfers, plan_transfers, possible_transfers
from comove.robots.verification.bodies import bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.kinematics import Bases
from comove.ros import parts_of
from tests.robots.known_carry import TABLE, baxter, hands_motion, known_carry, on_scene, posts, scene_data
from tests.robots.small_robots import SHELF, lifts_scene, robot

KEEP = 0.005  # m, that everything keeps where the scene says nothing
HEIGHT, GRIP_TIME = 0.08, 1.0  # m, s, where nothing else is asked for
ALONE = [TABLE, *posts(0.30)]
IN_THE_WAY = {"shape": "sphere", "center": [0.65, 0.29, 0.58], "radius": 0.03}
AT_HOME = {"shape": "sphere", "center": [0.51, 0.22, 0.25], "radius": 0.04}
PARTS = [("approach", "start"), ("release", "goal")]


BOX = {
    "shape": "box",
    "size": [0.5, 0.1, 0.04],
    "grasps": {"left": [0.3, 0.0, 0.0], "right": [-0.3, 0.0, 0.0]},
}


def carried(*more, **changes):
    scene = Scene.from_dict(scene_data(obstacles=(*ALONE, *more), **changes))
    verdict = verify_joints(baxter(), hands_motion(scene), known_carry()[1])
    assert verdict.verified is not None, verdict.reasons
    return verdict.verified


@pytest.fixture(scope="module", params=["stick", "ball", "box"])
def transfers(request):
    more = {"ball": (IN_THE_WAY,)}.get(request.param, ())
    return plan_transfers(carried(*more, **({"load": BOX} if request.param == "box" else {})))


def geometry_of(scene, end):
    """Baxter, obstacles and the stick at an end, put together for this test; which pairs are hands and stick."""
    robot = baxter()
    geometry = robot.collision.copy()
    links = range(geometry.ngeoms)
    shapes = {
        "box": lambda o: coal.Box(*o.size),
        "sphere": lambda o: coal.Sphere(o.radius),
        "cylinder": lambda o: coal.Cylinder(o.radius, o.height),
    }
    for i, o in enumerate(scene.file.obstacles):
        item = pin.GeometryObject(f"o{i}", 0, pin.SE3(np.eye(3), np.array(o.center)), shapes[o.shape](o))
        number = geometry.addGeometryObject(item)
        for link in links:
            geometry.addCollisionPair(pin.CollisionPair(link, number))
    left, right = getattr(scene, end)
    x, z, load = (left - right) / np.linalg.norm(left - right), np.array([0.0, 0.0, 1.0]), scene.file.load
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    shape = coal.Box(*load.size) if load.shape == "box" else None
    if shape is None:
        shape = coal.Capsule(load.radius, load.length + 2 * load.overhang)
        turn = turn[:, [1, 2, 0]]  # a capsule lies along z
    item = pin.GeometryObject("load", 0, pin.SE3(turn, 0.5 * (left + right)), shape)
    stick = geometry.addGeometryObject(item)
    wrists = {robot.model.getJointId(f"{side}_w2") for side in ("left", "right")}
    near = []
    for link in links:
        near.append(geometry.geometryObjects[link].parentJoint in wrists)
        geometry.addCollisionPair(pin.CollisionPair(link, stick))
    hands = np.zeros(len(geometry.collisionPairs), dtype=bool)
    hands[-len(near) :] = near
    return geometry, hands


@pytest.mark.parametrize(("part", "end"), PARTS)
@pytest.mark.few(2)
def test_nothing_comes_too_near(transfers, part, end):
    motion, robot, scene = getattr(transfers, part), baxter(), transfers.carry.scene
    geometry, of_hands = geometry_of(scene, end)
    data, placed = robot.model.createData(), geometry.createData()
    grasps = [
        robot.tool_pose(transfers.carry.joints.position[0 if end == "start" else -1], a)[:3, 3]
        for a in robot.arms
    ]
    least, least_of_hands, never = np.inf, np.inf, {}
    for time in np.arange(0.0, motion.duration, 0.02):
        q = motion.curve(time)
        pin.updateGeometryPlacements(robot.model, data, geometry, placed, q)
        away = min(
            np.linalg.norm(robot.tool_pose(q, a)[:3, 3] - g) for a, g in zip(robot.arms, grasps, strict=True)
        )
        for k, is_hand in enumerate(of_hands):
            if is_hand and away < HEIGHT - 1e-6:
                continue
            if never.get(k, 0.0) > time:
                continue
            distance = pin.computeDistance(geometry, placed, k).min_distance
            never[k] = time + max(0.0, distance - 0.05) / 4.0  # m/s, more than anything moves
            least = min(least, distance)
            least_of_hands = min(least_of_hands, distance) if is_hand else least_of_hands
    assert KEEP - 1e-4 <= transfers.clearance_min <= least + 2e-4
    assert least_of_hands < 0.2, "hands were looked at"


@pytest.mark.parametrize(("part", "end"), PARTS)
def test_they_join_home_and_the_carry(transfers, part, end):
    motion, carry = getattr(transfers, part), transfers.carry
    there = carry.joints.position[0 if end == "start" else -1]
    ends = (baxter().home, there) if part == "approach" else (there, baxter().home)
    assert (motion.position[[0, -1]] == ends).all()
    assert np.abs(motion.curve(motion.time[[0, -1]], 1)).max() < 1e-9
    assert motion.joint_names == carry.joints.joint_names


@pytest.mark.parametrize(("part", "end"), PARTS)
def test_limits_are_kept(transfers, part, end):
    motion, robot = getattr(transfers, part), baxter()
    time = np.linspace(0.0, motion.duration, 20_001)
    position, velocity, acceleration = motion.at(time)
    assert (position > robot.lower).all() and (position < robot.upper).all()
    assert (np.abs(velocity) < 0.6 * robot.velocity).all()
    assert (np.abs(acceleration) < 0.7 * robot.acceleration).all()


@pytest.mark.parametrize(("part", "end"), PARTS)
def test_hands_wait_and_go_straight_along_the_approach(transfers, part, end):
    motion, robot = getattr(transfers, part), baxter()
    rows = motion.position if part == "release" else motion.position[::-1]
    waited = int(100 * GRIP_TIME)
    assert (rows[:waited] == rows[0]).all()
    for arm in robot.arms:
        grasp = robot.tool_pose(rows[0], arm)
        far = 0.0
        for q in rows[waited:]:
            pose = robot.tool_pose(q, arm)
            offset = grasp[:3, :3].T @ (pose[:3, 3] - grasp[:3, 3])  # z is the approach
            if -offset[2] > HEIGHT - 1e-6:
                break
            assert np.abs(offset[:2]).max() < 1e-6 and np.abs(pose[:3, :3] - grasp[:3, :3]).max() < 1e-6
            assert -offset[2] >= far - 1e-9
            far = -offset[2]
        assert far > 0.9 * HEIGHT


def test_hands_keep_the_limits_of_the_scene():
    motion, joints = known_carry()
    scene = Scene.from_dict(scene_data(limits={"speed": 0.5, "acceleration": 1.0}))
    transfers = plan_transfers(verify_joints(baxter(), on_scene(motion, scene), joints).verified)
    for part in (transfers.approach, transfers.release):
        places = np.array(
            [[baxter().tool_pose(q, arm)[:3, 3] for arm in baxter().arms] for q in part.position]
        )
        speed = np.linalg.norm(np.diff(places, axis=0), axis=2) * 100.0
        assert speed.max() < 0.5


def test_hands_without_a_load_go_home_from_where_they_are():
    data = scene_data(constraints=[{"type": "relative_pose", "between": ["left", "right"]}])
    scene = Scene.from_dict({key: value for key, value in data.items() if key not in ("load", "grasp")})
    transfers = plan_transfers(verify_joints(baxter(), hands_motion(scene), known_carry()[1]).verified)
    assert (transfers.approach.position[-1] == transfers.carry.joints.position[0]).all()
    assert transfers.clearance_min >= KEEP - 1e-4


@pytest.mark.few(1)
def test_the_same_seed_gives_the_same(transfers):
    again = plan_transfers(transfers.carry)
    assert (again.approach.position == transfers.approach.position).all()
    assert (again.release.position == transfers.release.position).all()


def test_a_home_in_an_obstacle_is_told():
    with pytest.raises(RobotError, match=r"at home, left_.* and obstacles\[3\] \(sphere\) come too near"):
        plan_transfers(carried(AT_HOME))


def test_where_the_height_is_out_of_reach_a_part_of_it_is_tried():
    height = 0.3  # m; the arms reach back by less than half of it
    motion, robot = plan_transfers(carried(), height=height).release, baxter()
    for arm in robot.arms:
        grasp, turns = robot.tool_pose(motion.position[0], arm), []
        for q in motion.position:
            turns.append(np.abs(robot.tool_pose(q, arm)[:3, :3] - grasp[:3, :3]).max() < 1e-6)
        last = motion.position[np.flatnonzero(np.cumprod(turns))[-1]]
        back = (grasp[:3, 3] - robot.tool_pose(last, arm)[:3, 3]) @ grasp[:3, 2]
        assert abs(back - 0.25 * height) < 1e-6


def room_to_home():
    """Free space between the grasp at the start and home, with the load where it starts."""
    carry, robot = carried(), baxter()
    held = carry.joints.position[0]
    carried_load = Carried(carry.motion.motion)
    where = carried_load.hands(carried_load.time).positions
    bodies = bodies_of(Bases(robot, robot.description.uncertainty), robot.arms, carried_load, where, 0.0)
    bodies = bodies.placed_at(carried_load.nodes(np.array([0.0]))[0])
    nodes = carry.scene.nodes_at("start")
    return Room.for_ends(bodies, carry.scene, np.stack([held, robot.home]), nodes)


@pytest.mark.slow
def test_capsules_take_nothing_for_free_that_the_exact_bodies_do_not():
    room, robot, rng = room_to_home(), baxter(), np.random.default_rng(7)
    shares, strays = rng.random((400, 1)), rng.normal(0.0, 0.4, (400, len(robot.home)))
    q = np.clip(robot.home + shares * strays, robot.lower, robot.upper)
    quick = np.array([room.is_free(one) for one in q])
    exact = np.array([room.rigorous.is_free(one) for one in q])
    assert not (quick & ~exact).any()
    assert 20 < exact.sum() < 380 and (quick == exact).mean() > 0.9


def test_what_is_free_together_is_free_one_by_one():
    room, robot, rng = room_to_home(), baxter(), np.random.default_rng(8)
    q = np.clip(robot.home + rng.normal(0.0, 0.2, (40, len(robot.home))), robot.lower, robot.upper)
    free = np.array([room.is_free(one) for one in q])
    assert 0 < free.sum() < len(q)
    assert room.are_free(q[free]) and not room.are_free(q)


@lru_cache
def on_lifts(*shelves, goal_is_home=False, **wanted):
    """A carry of the arms on lifts, below shelves; on demand their hands at home are in the payload at its goal."""
    machine, scene = robot("lifts"), lifts_scene(tuple(map(dict, shelves)))
    found = comove.solve(scene, robot=machine, budget=20.0, **wanted)
    if not goal_is_home:
        return found
    last = found.joints.attempt.position[-1] - np.tile([0.03, 0.0, 0.0, 0.0], 2)
    arms = tuple(replace(arm, home=last[arm.columns]) for arm in machine.arms)
    return comove.solve(scene, robot=replace(machine, arms=arms), budget=20.0, **wanted)


def elbow_of_left(found):
    return np.sign(found.joints.attempt.position[0, found.joints.robot.joint_names.index("left_elbow_joint")])


def test_joints_without_an_approach_do_not_win_where_one_is_asked_for():
    below = tuple(SHELF.items())
    alone, both = on_lifts(below), on_lifts(below, approach=True, release=True)
    with pytest.raises(
        RobotError, match=r"behind the grasp at the start, left_elbow and .*solve .* with --approach"
    ):
        plan_transfers(alone.joints.motion)
    assert both.verified and not both.joints.without
    assert elbow_of_left(alone) == -elbow_of_left(both)
    assert both.joints.transfers.carry is both.joints.motion
    again = plan_transfers(both.joints.motion)
    for part in ("approach", "release"):
        assert (getattr(again, part).position == getattr(both.joints.transfers, part).position).all()


def test_a_shelf_above_all_elbows_is_told_before_anything_is_searched(monkeypatch):
    monkeypatch.setattr("comove.robots.solving.problem_of", lambda *_, **__: pytest.fail("it was searched"))
    roof = {"shape": "box", "center": [0.2, 0.0, 0.557], "size": [0.9, 1.6, 0.03]}
    with pytest.raises(
        RobotError, match=r"no joints that hold the load leave room for approach: 0.02 m behind"
    ):
        comove.solve(lifts_scene((roof,)), robot=robot("lifts"), approach=True)


def test_where_no_way_is_found_other_joints_are_tried(monkeypatch):
    refused = []

    def never_with_elbows_inwards(motion, *wanted):
        if len(refused) < 1:
            refused.append(motion.joints.position[0])
            return None, {"start": RobotError("no way")}
        return possible_transfers(motion, *wanted)

    monkeypatch.setattr("comove.robots.solving.possible_transfers", never_with_elbows_inwards)
    found = comove.solve(lifts_scene(), robot=robot("lifts"), approach=True, budget=20.0)
    assert found.verified and not found.joints.without and found.joints.transfers.release is None
    assert np.abs(found.joints.transfers.approach.position[-1] - refused[0]).max() > 0.3


def test_a_carry_without_the_approach_that_is_asked_for_says_so(monkeypatch):
    none = {"start": RobotError("no way")}
    monkeypatch.setattr("comove.robots.solving.possible_transfers", lambda *_, **__: (None, none))
    found = comove.solve(lifts_scene(), robot=robot("lifts"), approach=True, budget=20.0)
    assert found.verified and found.joints.without == ("no way",) and found.joints.transfers is None


def test_an_approach_needs_no_release():
    motion = on_lifts(goal_is_home=True).joints.motion
    with pytest.raises(
        RobotError, match=r"at home, \w+ and the load at its goal come too near .*leave the release out"
    ):
        plan_transfers(motion)
    transfers = plan_transfers(motion, release=False)
    assert transfers.release is None and (transfers.approach.position[0] == motion.robot.home).all()
    assert set(parts_of(motion, transfers)) == {"carry", "approach"}
    found, errors = possible_transfers(motion, True, True, None)
    assert list(errors) == ["goal"] and found.release is None
    assert (found.approach.position == transfers.approach.position).all()


def test_an_approach_begins_at_the_present_joints():
    motion, robot_ = on_lifts().joints.motion, robot("lifts")
    there = robot_.home + 0.1
    transfers = plan_transfers(motion, present=dict(zip(robot_.joint_names, there.tolist(), strict=True)))
    assert (transfers.approach.position[0] == there).all()
    assert (transfers.release.position[-1] == robot_.home).all()


def test_present_joints_that_touch_are_told():
    q = robot("lifts").home
    q[[1, 2]], q[[5, 6]] = (-1.2, 0.0), (1.2, 0.0)  # forearm in forearm
    scene, motion = lifts_scene(), on_lifts().joints.motion
    with pytest.raises(RobotError, match=r"present: at the present joints, .* are in each other"):
        comove.solve(scene, robot=robot("lifts"), present=q)
    with pytest.raises(RobotError, match=r"present: at the present joints, .* come too near .*--present"):
        plan_transfers(motion, present=q)


@pytest.mark.parametrize("nothing", [None, "carried", 3])
def test_what_is_no_verified_motion_is_refused(nothing):
    with pytest.raises(
        OptionError, match=f"carry: the motion is a {type(nothing).__name__}, not a verified one"
    ):
        plan_transfers(nothing)


def test_neither_approach_nor_release_is_refused():
    with pytest.raises(OptionError, match="neither approach nor release"):
        plan_transfers(on_lifts().joints.motion, approach=False, release=False)


def test_a_height_out_of_reach_is_told():
    with pytest.raises(
        RobotError, match=r"the arm '(left|right)' can draw back .* less than .*give a height below"
    ):
        plan_transfers(carried(), height=3.0)


@pytest.mark.parametrize(
    "wrong", [{"height": 0.0}, {"height": np.nan}, {"grip_time": -1.0}, {"grip_time": np.inf}]
)
def test_lengths_and_times_are_looked_at(wrong):
    with pytest.raises(OptionError, match=f"{next(iter(wrong))}: .*positive number"):
        plan_transfers(carried(), **wrong)


def test_only_the_planner_makes_them(transfers):
    with pytest.raises(TypeError, match="plan_transfers"):
        Transfers(transfers.carry, transfers.approach, transfers.release, 1.0, 1.0)
    with pytest.raises(AttributeError, match="cannot assign"):
        transfers.approach = transfers.release
    with pytest.raises(ValueError, match="read-only"):
        transfers.approach.position[0, 0] = 1.0
    with pytest.raises(TypeError, match="plan them anew"):
        pickle.dumps(transfers)
    assert copy.deepcopy(transfers) is transfers
