"""Ways to hold and put down a payload: what is dropped is out of reach, what is taken is held, by Pinocchio."""

import re
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import comove
from comove.errors import ComoveWarning, SceneError
from comove.model import Scene
from comove.robots import Robot, RobotCarrier
from comove.robots.choosing import Reach
from comove.robots.solving import _clear_ways, require_carried
from tests.robots.raw_links import RawLinks

BOARD = {
    "version": 2,
    "name": "board",
    "robot": "two_pandas",
    "duration": 8.0,
    "workspace": {"lower": [0.0, -0.8, 0.02], "upper": [1.0, 0.8, 1.2]},
    "payload": {
        "shape": "box",
        "size": [0.4, 0.08, 0.02],
        "mass": 0.6,
        "start": {"position": [0.42, 0.0, 0.3], "rpy_deg": [0, 0, 90]},
        "goal": {"position": [0.5, 0.05, 0.5], "rpy_deg": [0, 20, 90]},
    },
    "grasps": "auto",
    "limits": {"speed": 0.5, "acceleration": 1.0},
}
HELD = {
    name: {"position": [x, 0, 0], "approach": [0, 0, -1], "closing": [0, -1, 0]}
    for name, x in (("left", 0.17), ("right", -0.17))
}


def board(goal=None, **keys):
    data = BOARD | keys
    return Scene.from_dict(data | {"payload": data["payload"] | ({"goal": goal} if goal else {})})


REACHED = 1e-4  # m and rad


@cache
def robot():
    return Robot.load("two_pandas")


@cache
def raw():
    """The robot as its files have it."""
    return RawLinks(robot())


def payload_poses(found, n=60):
    """Positions and orientations of the payload along a solution, by what each arm's hand does: (arms, n, ...)."""
    scene, curve, poses = found.scene, found.joints.attempt.curve, []
    for name in scene.manipulators:
        grasp = scene.file.grasp.frames[name], scene.file.load.grasps[name]
        for time in np.linspace(0.0, scene.duration, n):
            hand = raw().grasp(name, curve(time))
            turn = Rotation.from_matrix(hand.rotation) * Rotation.from_quat(grasp[0], scalar_first=True).inv()
            poses.append((hand.translation - turn.apply(grasp[1]), turn))
    return poses


def test_auto_takes_the_arms_of_the_robot():
    """It says the same as naming them all."""
    both = board(grasps={"left": "auto", "right": "auto"})
    assert board().manipulators == ("left", "right")
    assert board().sha256 == both.sha256


def missing(name, choice, end):
    """How far an arm stays from its grasp at an end, by least squares on the raw URDF, as the norm of a twist.

    The least of several starts within the limits of the joints; where the arm reaches it, the first that does.
    """
    arm, q, rng = robot().arm(name), robot().home.copy(), np.random.default_rng(0)
    low, high = robot().lower[arm.columns], robot().upper[arm.columns]
    turn, frame = (
        Rotation.from_quat(x, scalar_first=True) for x in (end.quaternion_wxyz, choice.frames[name])
    )
    place = np.array(end.position) + turn.apply(choice.grasps[name])
    inverse = pin.SE3((turn * frame).as_matrix(), place).inverse()

    def off(joints):
        q[arm.columns] = joints
        return pin.log6(inverse * raw().grasp(name, q)).vector

    def slopes(joints):
        q[arm.columns] = joints
        return pin.Jlog6(inverse * raw().grasp(name, q)) @ raw().grasp_jacobian(name, q)[:, arm.columns]

    best = np.inf
    for start in [np.clip(arm.home, low, high), *rng.uniform(low, high, (7, len(low)))]:
        best = min(best, np.linalg.norm(least_squares(off, start, slopes, bounds=(low, high), ftol=1e-3).fun))
        if best < REACHED:
            break
    return best


def test_what_is_dropped_is_out_of_reach_and_nothing_else():
    """Ways are kept where each arm reaches its grasp at both ends, by kinematics of the raw URDF."""
    scene = board({"position": [0.55, 0.0, 0.62], "rpy_deg": [35, 0, 90]})
    ranked = [choice for choice, _ in Reach(robot(), scene).ranked()]
    held = [
        choice
        for choice in scene.file.choices
        if all(
            missing(name, choice, end) < REACHED
            for end in (choice.goal, scene.file.load.start)
            for name in choice.grasps
        )
    ]
    assert 0 < len(held) < len(scene.file.choices)
    assert sorted(map(str, ranked)) == sorted(map(str, held))


def test_grasps_that_no_arm_reaches_are_told_with_how_far():
    scene = board({"position": [0.5, 0.62, 0.6]})
    assert Reach(robot(), scene).ranked() == []
    with pytest.raises(
        SceneError, match=r"payload\.goal: .*'left' cannot reach its goal .* m and .* degrees are"
    ):
        comove.solve(scene, robot=robot())


def held_at(left, right):
    return {
        name: [
            {"position": [x, 0, 0], "approach": [0, 0, -1], "closing": [0, sign, 0]} for x, sign in several
        ]
        for name, several in (("left", left), ("right", right))
    }


@pytest.mark.parametrize("n", [1, 3])
def test_grasps_on_the_payload_precede_those_in_the_air(n):
    """However many are ranked, and however little the joints turn to those in the air."""
    left, right = [(0.3, 1), (0.17, -1)], [(-0.17, 1), (-0.17, -1), (-0.3, 1)][:n]
    with pytest.warns(ComoveWarning, match=r"grasps\.left\[0\]"):
        scene = board(grasps=held_at(left, right))
    ways = [choice.grasps for choice, _ in Reach(robot(), scene).ranked()]
    held = [sum(abs(at[0]) < 0.2 for at in way.values()) for way in ways]
    assert held == sorted(held, reverse=True)
    assert held[0] == 2
    way, _ = next(_clear_ways(scene, robot(), {}, True))
    assert way.file.load.grasps["left"][0] == 0.17


COLLIDING = [
    (held_at([(0.17, 1)], [(0.16, 1)]), "2 hands"),
    (held_at([(0.17, 1), (0.17, -1)], [(0.16, 1), (0.15, 1)]), "of lists"),
]


@pytest.mark.parametrize("grasps", [one for one, _ in COLLIDING], ids=[name for _, name in COLLIDING])
def test_hands_that_collide_by_their_grasps_are_named_and_moved_apart(grasps):
    """Not as arms that lift too much by the lever; the distance that is advised is accepted, a shorter one is not."""
    scene = board(grasps=grasps)
    with pytest.raises(SceneError, match=r"'left' and 'right' are .* collide whatever joints hold") as raised:
        comove.solve(scene, robot=robot())
    assert raised.value.key.startswith("grasps")
    needed = float(re.search(r"at least ([\d.]+) m", raised.value.way_out)[1])
    for distance, fine in ((needed, True), (needed - 0.06, False)):
        moved = board(grasps=held_at([(0.17, 1)], [(0.17 - distance, 1)]))
        try:
            RobotCarrier(robot(), moved)
        except SceneError as error:
            assert "collide" in str(error)
            assert not fine
        else:
            assert fine


def test_one_way_that_arms_can_carry_will_do():
    """The first of the listed grasps puts both hands at one place."""
    scene = board(grasps=held_at([(0.17, 1)], [(0.16, 1), (-0.17, 1)]))
    require_carried(robot(), scene)


@pytest.mark.slow
def test_the_turn_of_a_goal_is_free():
    """It is not one of a grid, and arms put the payload down there with its tilt."""
    goal = {"position": [0.5, 0.05, 0.5], "rpy_deg": [0, 20, 0], "free": "yaw"}
    found = comove.solve(board(goal, grasps=HELD), robot=robot(), seed=0)
    assert found.verified
    quaternion = found.scene.file.load.goal.quaternion_wxyz
    rpy = Rotation.from_quat(quaternion, scalar_first=True).as_euler("xyz", degrees=True)
    assert rpy[:2] == pytest.approx(np.array([0.0, 20.0]), abs=1e-6)
    assert abs(rpy[2] - 5.0 * np.round(rpy[2] / 5.0)) > 1e-3
    *_, (position, turn) = payload_poses(found, 2)
    assert position == pytest.approx(np.array([0.5, 0.05, 0.5]), abs=1e-5)
    assert turn.as_euler("xyz", degrees=True) == pytest.approx(rpy, abs=1e-3)


KEPT = [
    ({"type": "planar"}, {"position": [0.52, 0.1, 0.3], "rpy_deg": [0, 0, 110]}, [0, 0, 1]),
    (
        {"type": "planar", "normal": [1, 0, 0]},
        {"position": [0.42, 0.1, 0.5], "rpy_deg": [20, 0, 90]},
        [1, 0, 0],
    ),
    ({"type": "no_rotation"}, {"position": [0.5, 0.1, 0.5], "rpy_deg": [0, 0, 90]}, None),
    ({"type": "upright", "tolerance_deg": 15}, {"position": [0.5, 0.1, 0.5], "rpy_deg": [0, 10, 90]}, "up"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("constraint", "goal", "kept"), KEPT)
def test_arms_keep_what_a_constraint_keeps(constraint, goal, kept):
    """Of the payload's pose, as each arm's joints give it."""
    if goal["rpy_deg"][0]:
        goal = {"position": goal["position"], "quaternion_wxyz": turned_about_x(goal["rpy_deg"][0])}
    found = comove.solve(board(goal, grasps=HELD, constraints=[constraint]), robot=robot(), seed=0)
    assert found.verified, found.reasons
    poses = payload_poses(found)
    first = poses[0]
    for position, turn in poses:
        between = turn * first[1].inv()
        if kept == "up":
            assert turn.as_matrix()[2, 2] > np.cos(np.deg2rad(15.0))
        elif kept is None:
            assert between.magnitude() < 1e-4
        else:
            assert np.linalg.norm(np.cross(between.as_rotvec(), kept)) < 1e-4
            assert abs((position - first[0]) @ kept) < 1e-5


def turned_about_x(degrees):
    """The start's orientation, turned about the world's x axis."""
    start = Rotation.from_euler("z", 90, degrees=True)
    return (Rotation.from_euler("x", degrees, degrees=True) * start).as_quat(scalar_first=True).tolist()
