"""A robot as a search meets it: joints at both ends, what is possible, what is verified, what it cannot carry out."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml

import comove
from comove.errors import RobotError, SceneError
from comove.model import Scene
from comove.planning import solve
from comove.planning.kinematics import LimitedKinematics
from comove.planning.methods import UNPOLISHED
from comove.robots import Robot, VerifiedJointMotion, robot_method
from comove.robots.carrying import RobotCarrier
from comove.robots.ends import EndSettings
from comove.robots.search.following import MET
from comove.verification import verify
from tests.robots.known_carry import TABLE, known_carry, on_scene, posts, scene_data
from tests.robots.small_robots import EXAMPLES, gantry, gantry_scene, movement, robot, task

EXAMPLES_DIR = Path(__file__).parents[2] / "examples" / "robots"
NOWHERE = SimpleNamespace(clock=None, untimed=None)  # a space in which nothing is planned
NAMES = ("gantry", "gap_30", "two_pandas", "ur5_and_panda")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", ["start", "goal"])
@pytest.mark.few(3)
def test_joints_at_the_ends_hold_the_load_in_different_ways(name, end):
    carrying = task(name)
    nodes = carrying.scene.nodes_at(end)
    rotations = carrying.scene.grasp.hand_rotations(nodes[: len(carrying.holders)])
    for i, (arm, branches) in enumerate(zip(carrying.holders, getattr(carrying, f"{end}s"), strict=True)):
        assert 1 <= len(branches) <= EndSettings().n_branches
        for joints in branches:
            q = carrying.robot.home.copy()
            q[arm.columns] = joints
            pose = carrying.robot.tool_pose(q, arm)
            np.testing.assert_allclose(pose[:3, 3], nodes[i], atol=2 * MET)
            assert np.linalg.norm(pin.log3(rotations[i] @ pose[:3, :3].T)) < 1e-3
            assert (q >= carrying.robot.lower).all()
            assert (q <= carrying.robot.upper).all()
        for k, joints in enumerate(branches):
            assert all(np.abs(joints - other).max() > EndSettings().same_branch for other in branches[:k])
        away = np.abs(branches - arm.home).max(axis=1)
        assert (np.diff(away) >= -1e-6).all()  # what mirrors each other is equally far


def turns_apart(carrying, start, goal):
    """The largest difference of a joint, each as many whole turns away as is nearest and its limits allow; half of it
    for the last joint of an arm, whose turn no singularity hinders.
    """
    chains = carrying.arms.chains
    ways = goal + 2 * np.pi * np.arange(-2, 3)[:, None]
    allowed = (ways >= chains.lower) & (ways <= chains.upper) & ((ways == goal) | ~chains.slides)
    return weighted(carrying, np.where(allowed, np.abs(ways - start), np.inf).min(axis=0))


def weighted(carrying, turns):
    """The largest of some turns, of which those of the arms' last joints count half."""
    halves = np.isin(np.arange(turns.shape[-1]), carrying.arms.chains.first[1:] - 1)
    return (turns * np.where(halves, 0.5, 1.0)).max(axis=-1)


def test_goals_beyond_half_a_turn_are_known():
    """A UR5's wrist comes from 3 rad to -3: by 0.28 rad, not by 6."""
    known = task("ur5_and_panda")
    carrying = RobotCarrier(known.robot, known.scene)
    (left, right), start = carrying.goals, np.concatenate([starts[0] for starts in carrying.starts])
    wrist = known.robot.arm("left").columns.size - 1
    left = left.copy()
    left[:, wrist] = start[wrist] - 6.0 if start[wrist] > 0 else start[wrist] + 6.0
    vars(carrying)["goals"] = (left, right)
    apart = [
        abs(last[wrist] - first[wrist]) for first, last in carrying._pairs if first[wrist] == start[wrist]
    ]
    assert min(apart) == pytest.approx(2 * np.pi - 6.0)
    assert max(apart) == pytest.approx(6.0)  # which may be the way as well


@pytest.mark.parametrize("name", ["gap_30", "ur5_and_panda"])
def test_plans_are_made_between_the_nearest_joints_first_and_then_between_others(name, monkeypatch):
    """Nearest from home to the start, and from there to the goal, of those that are as clear by their capsules."""
    known = task(name)
    carrying, drawn = RobotCarrier(known.robot, known.scene), []
    home = np.concatenate([arm.home for arm in carrying.holders])

    def hopeless(space, arms, start, goal, *_, **__):
        turns = weighted(carrying, np.abs(start[1] - home)) + weighted(carrying, np.abs(goal[1] - start[1]))
        drawn.append(turns)

    monkeypatch.setattr("comove.robots.carrying.plan_with_arms", hopeless)
    for seed in range(5):
        begun, rng = RobotCarrier(known.robot, known.scene), np.random.default_rng(seed)
        begun.plan(NOWHERE, [], [], 0.0, rng)
    pairs = product(*(map(np.concatenate, product(*arms)) for arms in (carrying.starts, carrying.goals)))
    start, goal = (carrying.scene.nodes_at(end) for end in ("start", "goal"))
    _, least = min(
        (
            max(carrying.ends.tightness(p[None], start)[0], carrying.ends.tightness(q[None], goal)[0]),
            weighted(carrying, np.abs(p - home)) + turns_apart(carrying, p, q),
        )
        for p, q in pairs
    )
    assert drawn == pytest.approx([least] * 5, abs=2e-6)  # some are equally far
    for _ in range(20):
        begun.plan(NOWHERE, [], [], 0.0, rng)
    assert len(set(drawn)) > 3


def test_a_pair_of_ends_whose_plans_lead_to_nothing_gives_way_to_others(monkeypatch):
    """A plan that was found counts for its pair only once a motion along it is verified."""
    known, drawn = task("gap_30"), {}

    def found(space, arms, start, goal, *_, **__):
        drawn.setdefault(verified, []).append(tuple(np.concatenate([start[1], goal[1]])))
        return np.zeros((2, 1)), np.zeros((2, 1))

    monkeypatch.setattr("comove.robots.carrying.plan_with_arms", found)
    for verified in (False, True):
        carrying, rng = RobotCarrier(known.robot, known.scene), np.random.default_rng(0)
        for _ in range(20):
            carrying.plan(NOWHERE, [], [], 0.0, rng)
            if verified:
                carrying.kept.append((None, 0.0, (None, None)))
    first = drawn[True][0]
    assert drawn[False][0] == first
    assert drawn[False].count(first) <= 5
    assert drawn[True].count(first) >= 15


NEAR_A_POST = {  # radius and place of the post, start and goal of both hands
    "outside the elbow": (
        0.019,
        [0.309, -0.12],
        ([0.4924965382, 0.4337980657, 0.4043448697], [0.395426707, -0.1106762723, 0.1699245853]),
        ([0.3951381257, 0.0496039843, 0.3503425801], [0.3862972122, -0.5069090386, 0.1159222958]),
    ),
    "under the wrist": (
        0.052,
        [0.224, -0.003],
        ([0.3839174446, -0.1174300723, 0.3425410193], [0.2225858112, 0.1147705839, 0.2198691935]),
        ([0.4458584054, -0.5089354837, 0.2888117888], [0.4960460216, -0.1721661393, 0.1661399631]),
    ),
}


@pytest.mark.parametrize("name", NEAR_A_POST)
def test_an_arm_that_touches_something_near_its_home_holds_the_load_otherwise(name):
    """At the goal the left wrist is less than the 10 mm from the post near home that are to be kept, and its capsules
    everywhere; elsewhere there is room.
    """
    radius, place, *ends = NEAR_A_POST[name]
    data = {
        "version": 1,
        "name": "near_a_post",
        "duration": 10,
        "robot": "two_xarm7",
        "grasp": {"orientation": "down", "yaw": "load"},
        "workspace": {"lower": [0.15, -0.6, 0.05], "upper": [0.75, 0.6, 0.45]},
        "obstacles": [{"shape": "cylinder", "radius": radius, "height": 0.4, "center": [*place, 0.25]}],
        "load": {"shape": "bar", "length": 0.4, "radius": 0.012, "mass": 0.3},
        "manipulators": [
            {"name": hand, "start": start, "goal": goal}
            for hand, (start, goal) in zip(("left", "right"), ends, strict=True)
        ],
        "limits": {"speed": 0.5, "acceleration": 1, "clearance": 0.01},
    }
    machine, scene = robot("two_xarm7"), Scene.from_dict(data)
    post, there = coal.Cylinder(radius, 0.4), [*place, 0.25]
    keeps = [
        from_post(machine, joints, post, there) > 0.01 for joints in RobotCarrier(machine, scene).goals[0]
    ]
    assert keeps[0] and keeps == sorted(keeps, reverse=True)
    assert comove.solve(scene, robot=machine, method=replace(robot_method(), n_ways=1)).verified


def from_post(machine, joints, shape, place):
    """The distance of the first arm's bodies from a shape, by coal, where the other arm is at home [m]."""
    q, arm, data = machine.home.copy(), machine.arms[0], machine.model.createData()
    q[arm.columns] = joints
    placed = machine.collision.createData()
    pin.updateGeometryPlacements(machine.model, data, machine.collision, placed, q)
    there, least = coal.Transform3s(np.eye(3), np.array(place)), np.inf
    for k, item in enumerate(machine.collision.geometryObjects):
        if item.name.startswith(arm.name) and "base" not in item.name:
            at = coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation)
            asked, found = coal.DistanceRequest(), coal.DistanceResult()
            least = min(least, coal.distance(item.geometry, at, shape, there, asked, found))
    return least


@pytest.mark.parametrize("name", ["gap_30", "two_pandas", "ur5_and_panda"])
def test_joints_that_turn_least_are_tried_early_even_where_capsules_meet(name):
    """Of pairs of ends, the k that turn least are among the first 4 k; of those with room, among 3 k of every 4 k."""
    known = task(name)
    at = [known.scene.nodes_at(end) for end in ("start", "goal")]
    home = np.concatenate([arm.home for arm in known.holders])
    turns = np.array(
        [
            (weighted(known, np.abs(first - home)) + weighted(known, np.abs(first - last))).round(6)
            for first, last in known._pairs
        ]
    )
    room = np.array(
        [
            min(known.ends.clearances(q[None], nodes)[0] for q, nodes in zip(p, at, strict=True))
            for p in known._pairs
        ]
    )
    keeps = room > known.scene.clearance
    for some, most in ((np.ones(len(turns), dtype=bool), 1), (keeps, 3)):
        least = np.sort(turns[some])
        for k in range(1, len(turns) // 4 + 1):
            early, count = np.sort(turns[: 4 * k][some[: 4 * k]]), min(most * k, len(least))
            assert (early[:count] == least[:count]).all()


def test_of_three_plans_one_lets_capsules_come_as_near_as_they_are_wider_and_one_twice_as_near(monkeypatch):
    known, allowed = task("gap_30"), []
    monkeypatch.setattr(
        "comove.robots.carrying.plan_with_arms", lambda *_, lenient, **__: allowed.append(lenient)
    )
    carrying, rng = RobotCarrier(known.robot, known.scene), np.random.default_rng(0)
    for _ in range(6):
        carrying.plan(NOWHERE, [], [], 0.0, rng)
    assert allowed == [0.0, 0.01, 0.02] * 2


@pytest.mark.parametrize("name", ["gap_30", "two_pandas"])
def test_joints_of_one_arm_at_an_end_do_not_depend_on_where_the_other_arm_rests(name):
    known, elsewhere = task(name), RobotCarrier(task(name).robot, task(name).scene)
    chains, around, rng = elsewhere.arms.chains, elsewhere.arms.around, np.random.default_rng(11)
    left = slice(0, chains.first[1])
    for _ in range(10):
        posture = rng.uniform(chains.lower, chains.upper)
        posture[left] = around.posture[left]
        moved = replace(elsewhere)
        vars(moved)["arms"] = elsewhere.arms._replace(around=around._replace(posture=posture))
        for end in ("starts", "goals"):
            np.testing.assert_array_equal(getattr(moved, end)[0], getattr(known, end)[0])


def test_the_known_path_is_possible_and_faster_or_blocked_ones_are_not():
    motion, _ = known_carry()
    nodes = motion.nodes(201)[None]
    right = RobotCarrier(robot("baxter"), motion.scene)
    fast = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(duration=3.0)))
    above = {"shape": "cylinder", "center": [0.75, 0.35, 0.5], "radius": 0.03, "height": 0.4}
    blocked = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(obstacles=(TABLE, above))))
    asked = [carrying.ask(nodes) for carrying in (right, fast, blocked)]
    assert [bool(possible[0]) for _, possible in asked] == [True, False, False]
    assert asked[0][0][0] < min(asked[1][0][0], asked[2][0][0])


def test_a_population_is_asked_as_each_of_it_alone():
    carrying = task("gantry")
    nodes = np.array([movement(carrying.scene, (0.0, y)).nodes(201) for y in (0.0, 0.45, 0.9, 0.1, -0.5)])
    penalty, possible = carrying.ask(nodes)
    for k in range(len(nodes)):
        one, may = carrying.ask(nodes[k : k + 1])
        assert (one[0], may[0]) == (penalty[k], possible[k])
    assert possible[1]
    assert not possible[2]
    np.testing.assert_array_equal(penalty, carrying.ask(nodes)[0])


def test_more_caution_asks_for_more_room_and_slower_joints():
    carrying = task("gantry")
    careful = carrying.stricter().stricter()
    assert careful.caution == carrying.caution + 2
    assert careful.arms.around.spare > carrying.arms.around.spare
    assert careful.arms.around.share < carrying.arms.around.share
    assert careful.arms.around.clearance == carrying.arms.around.clearance


def test_the_load_is_carried_by_its_holders_and_links_keep_the_scenes_clearance():
    around = task("gantry").arms.around
    np.testing.assert_array_equal(around.carried, [0.5, 0.5])
    assert around.clearance == 0.005
    wide = RobotCarrier(robot("gantry"), gantry_scene(limits={"clearance": 0.02}))
    assert wide.arms.around.clearance == 0.02
    light = RobotCarrier(robot("baxter"), known_carry()[0].scene)
    assert light.arms.around.carried.sum() == 0.25


def test_an_arm_that_holds_nothing_keeps_out_of_the_loads_mass():
    held = {"shape": "bar", "length": 0.5, "mass": 2.0, "held_by": ["left", "right"]}
    third = {"name": "third", "start": [0.0, 0.0, 0.2], "goal": [0.0, 0.1, 0.2]}
    scene = gantry_scene((), load=held, manipulators=[*_manipulators(), third])
    with pytest.raises(RobotError, match=r"has no arm 'third'; known: left, right"):
        RobotCarrier(robot("gantry"), scene)


def _manipulators():
    return gantry_scene(()).file.model_dump(mode="json")["manipulators"]


def without(data, *keys):
    return {key: value for key, value in data.items() if key not in keys}


def planar():
    """A planar scene that carries a bar."""
    ends = zip(("left", "right"), (0.1, -0.1), strict=True)
    hands = [{"name": name, "start": [0.4, y], "goal": [0.6, y]} for name, y in ends]
    return {
        "name": "flat",
        "duration": 5,
        "workspace": {"lower": [0, -1], "upper": [1, 1]},
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": hands,
    }


def moved(shift, end="start"):
    """The benchmark's scene with one end elsewhere, and room for it."""
    data = scene_data(workspace={"lower": [-3, -3, -3], "upper": [3, 3, 3]}, obstacles=())
    for hand in data["manipulators"]:
        hand[end] = [a + b for a, b in zip(hand[end], shift, strict=True)]
    return data


def with_names(names):
    data = scene_data()
    for hand, name in zip(data["manipulators"], names, strict=True):
        hand["name"] = name
    return data


def long_load():
    data = scene_data(
        load={"shape": "bar", "length": 4.0},
        workspace={"lower": [-3, -3, -3], "upper": [3, 3, 3]},
        obstacles=(),
    )
    for hand, y in zip(data["manipulators"], (2.0, -2.0), strict=True):
        hand["start"], hand["goal"] = [0.6, y, 0.1], [0.7, y, 0.1]
    return data


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (planar(), ["workspace", "a robot moves in space, and the scene is planar"]),
        (without(scene_data(), "grasp"), ["grasp", "how to hold the load", "orientation: down"]),
        (without(scene_data(), "grasp", "load"), ["load", "there is nothing to carry"]),
        (with_names(("left", "rigth")), ["no arm 'rigth'", "did you mean 'right'?", "left, right"]),
        (
            moved([0.0, 2.0, 0.0]),
            ["manipulators.start", "'left' cannot reach its start at [0.772, 2.552, 0.05]", "m and"],
        ),
        (moved([0, 0, 1.7], "goal"), ["manipulators.goal", "cannot reach its goal", "degrees are missing"]),
        (long_load(), ["'left' cannot reach its start at [0.6, 2, 0.1]", "use another robot"]),
    ],
)
def test_a_scene_that_a_robot_cannot_carry_out_is_told_in_one_sentence(data, told, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises((SceneError, RobotError)) as caught:
        _ = RobotCarrier(robot("baxter"), Scene.load(path)).starts
        _ = RobotCarrier(robot("baxter"), Scene.load(path)).goals
    message = str(caught.value)
    assert "\n" not in message
    assert all(part in message for part in told), message
    if isinstance(caught.value, SceneError):
        assert str(path) in message


def test_the_distance_told_is_what_is_missing():
    """The gantry's left hand reaches x = 0.6: a start at 0.75 is 0.15 m too far, and 2 cm of caution."""
    file = gantry_scene(()).file.model_dump(mode="json", exclude_none=True)
    file["workspace"] = {"lower": [-2, -2, 0], "upper": [2, 2, 1]}
    for hand in file["manipulators"]:
        hand["start"][0] = 0.75
    with pytest.raises(SceneError, match=r"at \[0\.75, 0\.25, 0\.3\]: 0\.17 m and 0 degrees are missing"):
        _ = RobotCarrier(robot("gantry"), Scene.from_dict(file)).starts


@pytest.mark.parametrize(
    "path",
    sorted([*EXAMPLES.glob("baxter/*.yaml"), *EXAMPLES.glob("robots/*.yaml")]),
    ids=lambda path: path.stem,
)
@pytest.mark.few(2)
def test_ends_of_the_examples_are_reached_without_contact_by_some_grasp(path):
    carrying, clear = task(path.stem), 0
    for scene in carrying.scene.alternatives:
        choice = replace(carrying, scene=scene)
        try:
            ends = ((choice.starts, "start"), (choice.goals, "goal"))
        except SceneError:
            continue
        joints = [(np.concatenate([branches[0] for branches in found]), end) for found, end in ends]
        clear += all(
            choice.ends.at(end).clearances(q[None], scene.nodes_at(end))[0] > 0.0 for q, end in joints
        )
    assert clear > 0


def test_nothing_depends_on_how_many_threads_there_are():
    """Parts of a population are followed apart, in any order."""
    motion, _ = known_carry()
    carrying = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.25)))))
    nodes = np.repeat(motion.nodes(201)[None], 7, axis=0)
    penalty, _ = carrying.ask(nodes)
    assert len(set(penalty.tolist())) == 1


@pytest.mark.parametrize(
    "shift",
    [(0.02, 0.0, -0.02, 0.0), pytest.param((-0.01, -0.02, 0.02, 0.0), marks=pytest.mark.slow)],
    ids=str,
)
def test_two_pandas_find_a_way_within_few_plans_wherever_the_load_lies(shift):
    """Measured in plans, not in seconds: capsules that are wider than the links must not stand in the way."""
    data = yaml.safe_load((EXAMPLES_DIR / "two_pandas.yaml").read_text(encoding="utf-8"))
    for hand in data["manipulators"]:
        for key, (x, y) in (("start", shift[:2]), ("goal", shift[2:])):
            hand[key][0] += x
            hand[key][1] += y
    scene, plans = Scene.from_dict(data), []
    carrying = RobotCarrier(robot("two_pandas"), scene)

    class Counted(LimitedKinematics):
        along, ask, stricter, reasons = carrying.along, carrying.ask, carrying.stricter, carrying.reasons

        def plan(self, *args, **options):
            plans.append(options["max_nodes"])
            return carrying.plan(*args, **options)

    method = replace(robot_method(), n_plans=1, n_polishings=1, polishing=UNPOLISHED)
    found = solve(scene, method=method, budget=600, kinematics=Counted())
    assert found.verified
    assert sum(plans) <= 30_000


def test_a_motion_that_the_robot_can_carry_out_has_no_reasons_against_it():
    motion, _ = known_carry()
    carrier = RobotCarrier(robot("baxter"), motion.scene)
    assert carrier.reasons(motion) == ()
    _, verdict = done = carrier.carried_out(motion)
    assert isinstance(verdict.verified, VerifiedJointMotion)
    assert carrier.carried_out(motion) is done  # asked again, it is not verified again
    assert verify(motion, [carrier.reasons]).verified is not None
    assert carrier.carried_out(motion) is done
    other = movement(motion.scene)
    assert carrier.carried_out(other) is not done


def test_who_waits_hears_of_every_verified_motion_once_whichever_copy_found_it():
    motion, _ = known_carry()
    heard = []
    carrier = RobotCarrier(robot("baxter"), motion.scene, found=heard.append)
    done = carrier.stricter().carried_out(motion)
    assert [found.motion.motion for found in heard] == [motion]
    carrier.carried_out(movement(motion.scene))
    assert carrier.carried_out(motion) is done
    assert len(heard) == 1


def test_a_motion_out_of_reach_is_refused_with_arm_instant_and_distance():
    carrier = RobotCarrier(robot("gantry"), gantry_scene(()))
    motion = movement(carrier.scene, (0.0, 0.8))
    (reason,) = carrier.reasons(motion)
    told = re.fullmatch(
        r"the arm 'right' does not reach its hand's pose at (\S+) s: (\S+) m are missing", reason
    )
    assert float(told[1]) == pytest.approx(3.0, abs=0.3)
    assert float(told[2]) == pytest.approx(0.15, abs=0.01)
    joints, verdict = carrier.carried_out(motion)
    assert verdict.verified is None
    assert joints.duration == 6.0


def test_what_the_verification_of_joints_has_against_a_motion_are_the_reasons():
    motion, _ = known_carry()
    post = {"shape": "cylinder", "center": [0.75, 0.35, 0.5], "radius": 0.03, "height": 0.4}
    scene = Scene.from_dict(scene_data(obstacles=(TABLE, post)))
    carrier = RobotCarrier(robot("baxter"), scene)
    reasons = carrier.reasons(on_scene(motion, scene))
    assert any("obstacles[1] (cylinder)" in reason for reason in reasons)
    verdict = verify(on_scene(motion, scene), [carrier.reasons])
    assert verdict.verified is None
    assert set(reasons) <= set(verdict.reasons)


def test_links_that_a_verification_finds_too_near_are_known_to_the_search_from_then_on(tmp_path):
    """Two square columns 28 mm apart at home, whose capsules nearly meet there, pass each other corner by corner."""
    machine = Robot.load(gantry(tmp_path, nearer=0.356))
    hands = [
        ("left", [-0.3, 0.044, 0.3], [0.344, 0.0, 0.3]),
        ("right", [-0.3, -0.044, 0.3], [0.256, 0.0, 0.3]),
    ]
    scene = gantry_scene(
        (),
        load={"shape": "bar", "length": 0.088, "radius": 0.01, "mass": 1.0},
        manipulators=[{"name": name, "start": start, "goal": goal} for name, start, goal in hands],
    )
    carrier, motion = RobotCarrier(machine, scene), movement(scene)
    columns = np.ascontiguousarray(motion.at(np.linspace(0.0, 1.0, 81))[0].T[None])
    nodes = motion.coordinates.nodes(columns)
    _, possible = carrier.ask(nodes)
    (reason,) = carrier.reasons(motion)
    assert "left_z and right_z come within 0.00" in reason
    _, still = carrier.ask(nodes)
    assert possible and not still
    assert not carrier.stricter().ask(nodes)[1]
    assert (carrier.arms.links.wider <= RobotCarrier(machine, scene).arms.links.wider).all()


def test_ends_out_of_reach_are_told_before_a_search_begins():
    file = gantry_scene(()).file.model_dump(mode="json", exclude_none=True)
    file["workspace"] = {"lower": [-2, -2, 0], "upper": [2, 2, 1]}
    for hand in file["manipulators"]:
        hand["goal"][0] = 1.5
    with pytest.raises(SceneError, match="'left' cannot reach its goal"):
        RobotCarrier(robot("gantry"), Scene.from_dict(file)).require_reach()


def test_a_search_with_the_gantry_ends_with_verified_joints():
    """From a scene whose straight way is blocked to verified joints."""
    carrier = task("gantry")
    carrier.require_reach()
    solution = solve(carrier.scene, method=robot_method(), kinematics=carrier, budget=20.0, seed=1)
    assert solution.verified
    _, verdict = carrier.carried_out(solution.attempt)
    assert verdict.reasons == ()
    assert verdict.report.clearance_scene >= 0.005


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_where_the_duration_is_open_the_first_motion_is_not_much_slower_than_a_known_one(seed):
    """The bends of a plan, or a law of motion that begins with a jolt, would make it take five times as long."""
    motion, _ = known_carry()
    known, heard = RobotCarrier(robot("baxter"), motion.scene).shortest(motion), []
    wanted = {"found": heard.append, "stop": lambda: bool(heard)}
    comove.solve(motion.scene.timed(None), robot=robot("baxter"), seed=seed, budget=600, **wanted)
    assert heard[0].joints.duration < 2.0 * known


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_where_the_duration_is_open_what_is_returned_is_the_fastest_motion_that_was_found(seed):
    """Whichever joints later plans lead through: by others the same motion of the hands may take longer."""
    scene, heard = Scene.load(EXAMPLES / "robots" / "two_xarm7.yaml").timed(None), []
    found = comove.solve(scene, robot=robot("two_xarm7"), seed=seed, budget=600, found=heard.append)
    assert found.joints.motion.joints.duration == min(verified.joints.duration for verified in heard)


def test_hands_that_are_verified_are_not_verified_anew_for_their_joints(monkeypatch):
    motion, _ = known_carry()
    carrying = RobotCarrier(task("gap_30").robot, motion.scene)
    verified = verify(motion).verified
    (check,) = carrying.checks
    monkeypatch.setattr(
        "comove.robots.verification.verify.verify", lambda motion: pytest.fail("verified once more")
    )
    assert check.check(verified) == ()
    assert carrying.carried_out(motion)[1].verified is not None
