"""A robot as a search sees it: joints at both ends, what is possible, and scenes that it cannot carry out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from comove.errors import RobotError, SceneError
from comove.planning import solve
from comove.planning.methods import UNPOLISHED
from comove.robots.check import RobotCheck
from comove.robots.search.carrying import BRANCHES, SAME_BRANCH, Carrying, robot_method
from comove.robots.search.following import MET
from comove.robots.search.tracking import _nodes
from comove.scenes import Scene
from tests.robots.known_carry import TABLE, known_carry, posts, scene_data
from tests.robots.small_robots import EXAMPLES, gantry_scene, movement, robot, task

EXAMPLES_DIR = Path(__file__).parents[3] / "examples" / "robots"
NAMES = ("gantry", "gap_30", "two_pandas", "ur5_and_panda")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", ["start", "goal"])
def test_joints_at_the_ends_hold_the_load_in_different_ways(name, end):
    carrying = task(name)
    nodes = carrying.scene.nodes_at(end)
    rotations = carrying.scene.grasp.hand_rotations(nodes[: len(carrying.holders)])
    for i, (arm, branches) in enumerate(zip(carrying.holders, getattr(carrying, f"{end}s"), strict=True)):
        assert 1 <= len(branches) <= BRANCHES
        for joints in branches:
            q = carrying.robot.home.copy()
            q[arm.columns] = joints
            pose = carrying.robot.tool_pose(q, arm)
            np.testing.assert_allclose(pose[:3, 3], nodes[i], atol=2 * MET)
            assert np.linalg.norm(pin.log3(rotations[i] @ pose[:3, :3].T)) < 1e-3
            assert (q >= carrying.robot.lower).all()
            assert (q <= carrying.robot.upper).all()
        for k, joints in enumerate(branches):
            assert all(np.abs(joints - other).max() > SAME_BRANCH for other in branches[:k])
        away = np.abs(branches - arm.home).max(axis=1)
        assert (np.diff(away) >= -1e-6).all()  # what mirrors each other is equally far


def test_the_known_path_is_possible_and_faster_or_blocked_ones_are_not():
    motion, _ = known_carry()
    nodes = _nodes(motion, 201)[None]
    right = Carrying(robot("baxter"), motion.scene)
    fast = Carrying(robot("baxter"), Scene.from_dict(scene_data(duration=3.0)))
    above = {"shape": "cylinder", "center": [0.75, 0.35, 0.5], "radius": 0.03, "height": 0.4}
    blocked = Carrying(robot("baxter"), Scene.from_dict(scene_data(obstacles=(TABLE, above))))
    asked = [carrying.ask(nodes) for carrying in (right, fast, blocked)]
    assert [bool(possible[0]) for _, possible in asked] == [True, False, False]
    assert asked[0][0][0] < min(asked[1][0][0], asked[2][0][0])


def test_a_population_is_asked_as_each_of_it_alone():
    carrying = task("gantry")
    nodes = np.array([_nodes(movement(carrying.scene, (0.0, y)), 201) for y in (0.0, 0.45, 0.9, 0.1, -0.5)])
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
    wide = Carrying(robot("gantry"), gantry_scene(limits={"clearance": 0.02}))
    assert wide.arms.around.clearance == 0.02
    assert Carrying(robot("baxter"), known_carry()[0].scene).mass == 0.25


def test_an_arm_that_holds_nothing_keeps_out_of_the_loads_mass():
    held = {"shape": "bar", "length": 0.5, "mass": 2.0, "held_by": ["left", "right"]}
    third = {"name": "third", "start": [0.0, 0.0, 0.2], "goal": [0.0, 0.1, 0.2]}
    scene = gantry_scene((), load=held, manipulators=[*_manipulators(), third])
    with pytest.raises(RobotError, match=r"has no arm 'third'; known: left, right"):
        Carrying(robot("gantry"), scene)


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
            ["manipulators.start", "'left' cannot reach its start at 0.772, 2.55, 0.05", "m and"],
        ),
        (moved([0, 0, 1.7], "goal"), ["manipulators.goal", "cannot reach its goal", "degrees are missing"]),
        (long_load(), ["'left' cannot reach its start at 0.6, 2, 0.1", "use another robot"]),
    ],
)
def test_a_scene_that_a_robot_cannot_carry_out_is_told_in_one_sentence(data, told, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises((SceneError, RobotError)) as caught:
        _ = Carrying(robot("baxter"), Scene.load(path)).starts
        _ = Carrying(robot("baxter"), Scene.load(path)).goals
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
    with pytest.raises(SceneError, match=r"at 0\.75, 0\.25, 0\.3: 0\.17 m and \S+ degrees are missing"):
        _ = Carrying(robot("gantry"), Scene.from_dict(file)).starts


@pytest.mark.parametrize(
    "path",
    sorted([*EXAMPLES.glob("baxter/*.yaml"), *EXAMPLES.glob("robots/*.yaml")]),
    ids=lambda path: path.stem,
)
def test_ends_of_the_examples_are_reached_without_contact(path):
    carrying = task(path.stem)
    for found, end in ((carrying.starts, "start"), (carrying.goals, "goal")):
        q = np.concatenate([branches[0] for branches in found])
        assert carrying.clearance(q, carrying.scene.nodes_at(end)) > 0.0


def test_nothing_depends_on_how_many_threads_there_are():
    """Parts of a population are followed apart, in any order."""
    motion, _ = known_carry()
    carrying = Carrying(robot("baxter"), Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.25)))))
    nodes = np.repeat(_nodes(motion, 201)[None], 7, axis=0)
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
    carrying = Carrying(robot("two_pandas"), scene)

    class Counted:
        ask, stricter = carrying.ask, carrying.stricter

        def plan(self, *args, **options):
            plans.append(options["max_nodes"])
            return carrying.plan(*args, **options)

    method = replace(robot_method(), n_plans=1, n_polishings=1, polishing=UNPOLISHED)
    found = solve(scene, method=method, budget=600, carrier=Counted(), checks=[RobotCheck(carrying)])
    assert found.verified
    assert sum(plans) <= 30_000
