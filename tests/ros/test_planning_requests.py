"""Requests of MoveIt 2 mean what its messages say, and are refused in words whose advice works; without ROS."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.model.files.moveit import obstacles_in, planning_scene_in
from comove.model.files.moveit_bags import encoded, write
from comove.robots import JointMotion, verify_joints
from comove.ros.planning_requests import ErrorCode, Refusal, groups_in
from comove.ros.planning_server import MotionPlanner, PlanningSettings
from tests.model.files.test_imported import MOVEIT
from tests.model.files.test_moveit_bags import PUBLISHED
from tests.ros.planning_goals import LEFT, RIGHT, Cell, Wire, box, definitions, joint_goal, moved, pose, posed

pytest.importorskip("rosbags")
HAND = 2e-6  # m and rad, by which hands may be off; they are given to 1e-12 m


@pytest.fixture(scope="module")
def cell():
    return Cell()


@pytest.fixture(scope="module")
def wire():
    return Wire()


@pytest.fixture(scope="module")
def planner(cell):
    return MotionPlanner(cell.robot)


@pytest.fixture(scope="module")
def ask(cell, wire, planner):
    """A function that returns the verified joint motion that answers a goal."""

    def asked(goal, *scenes, by=planner, **how):
        messages = [wire.encoded(scene) for scene in scenes or (cell.scene(),)]
        only_plan = goal["planning_options"].get("plan_only", False)
        planned = by.plan(wire.request(goal), messages, only_plan=only_plan, **how)
        return planned.solution.joints.motion

    return asked


@pytest.fixture(scope="module")
def refused(ask):
    """A function that returns why a goal is refused: the name of the code and the words."""

    def why(goal, *scenes, **how):
        with pytest.raises(Refusal) as caught:
            ask(goal, *scenes, **how)
        return caught.value.code.name, caught.value.text

    return why


def by_name(motion, row):
    return dict(zip(motion.joints.joint_names, motion.joints.position[row].tolist(), strict=True))


def relative(cell, joints):
    """The pose of the right hand in the left one."""
    return np.linalg.inv(cell.link_pose(LEFT, joints)) @ cell.link_pose(RIGHT, joints)


def test_definitions_are_those_of_moveit_msgs(wire):
    """Of the same fields in the same order the types have the same hash."""
    assert set(PUBLISHED) <= set(definitions())
    for name, wanted in PUBLISHED.items():
        assert wire.messages.store.hash_rihs01(name) == f"RIHS01_{wanted}"


@pytest.mark.parametrize("body", ["bar", LEFT, RIGHT])
def test_a_pose_is_reached_from_the_joints_of_the_state(cell, ask, body):
    """By Pinocchio: hands keep their relative pose, and the body is where it was asked for."""
    start = cell.bar if body == "bar" else cell.link_pose(body)
    target = moved(start, 0.05, 0.02, 0.1, yaw=0.1)
    motion = ask(cell.goal(target, body))
    first, last = by_name(motion, 0), by_name(motion, -1)
    assert first == pytest.approx({name: cell.joints[name] for name in first}, abs=1e-5)
    in_hand = np.linalg.inv(cell.link_pose(LEFT)) @ start
    assert cell.link_pose(LEFT, last) @ in_hand == pytest.approx(target, abs=HAND)
    for row in range(0, len(motion.joints.time), 10):
        assert relative(cell, by_name(motion, row)) == pytest.approx(relative(cell, cell.joints), abs=HAND)


def test_the_numbers_of_a_trajectory_are_verified_again(cell, ask):
    motion = ask(cell.goal())
    time, position = np.array(motion.joints.time.tolist()), np.array(motion.joints.position.tolist())
    verdict = verify_joints(cell.robot, motion.motion, JointMotion(time, motion.joints.joint_names, position))
    assert verdict.verified is not None, verdict.reasons


def test_joints_are_reached_as_they_are_given(cell, ask):
    """Redundant joints too, which the pose of the hands leaves open."""
    free = by_name(ask(cell.goal()), -1)
    motion = ask(cell.goal(goal_constraints=[joint_goal(free)]))
    assert by_name(motion, -1) == pytest.approx(free, abs=1e-6)
    own = self_motion(cell, free)
    motion = ask(cell.goal(goal_constraints=[joint_goal(own)]))
    assert by_name(motion, -1) == pytest.approx(own, abs=1e-5)
    assert max(abs(own[name] - free[name]) for name in own) > 0.05


def self_motion(cell, joints, step=0.01, n_steps=20):
    """Other joints of the left arm with the same pose of its hand, along the null space; by Pinocchio."""
    import pinocchio as pin

    model, data = cell.robot.model, cell.robot.model.createData()
    q = np.array([joints[name] for name in cell.robot.joint_names])
    frame = model.getFrameId(LEFT, pin.FrameType.BODY)
    columns = cell.robot.arm("left").columns
    pin.framesForwardKinematics(model, data, q)
    target, before = data.oMf[frame].copy(), None
    for _ in range(n_steps):
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)[:, columns]
        direction = np.linalg.svd(jacobian)[2][-1]
        before = direction if before is None or direction @ before > 0 else -direction
        q[columns] += step * before
        for _ in range(3):
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[frame].actInv(target)).vector
            jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)[:, columns]
            q[columns] += np.linalg.pinv(jacobian) @ error
    return dict(zip(cell.robot.joint_names, q.tolist(), strict=True))


def test_scaling_factors_scale_the_limits(cell, ask):
    quick, slow = (
        ask(cell.goal(max_velocity_scaling_factor=v, max_acceleration_scaling_factor=a))
        for v, a in ((0.0, 0.0), (0.1, 0.05))
    )
    _, velocity, acceleration = slow.joints.at(np.linspace(0.0, slow.joints.duration, 2001))
    assert (np.abs(velocity) <= 0.1 * cell.robot.velocity * (1 + 1e-9)).all()
    assert (np.abs(acceleration) <= 0.05 * cell.robot.acceleration * (1 + 1e-9)).all()
    assert quick.joints.duration < 0.8 * slow.joints.duration


def test_frames_and_offsets_place_a_goal(cell, ask):
    """The frame `cell` is 1 m above the world; a point of the hand is aimed at."""
    target = moved(cell.link_pose(LEFT), 0.05, 0.0, 0.1)
    goal = cell.goal(goal_constraints=[posed(moved(target, 0.0, 0.0, -1.0), LEFT, "cell")])
    (point,) = goal["request"]["goal_constraints"][0]["position_constraints"]
    point["target_point_offset"] = {"x": 0.01, "y": -0.02, "z": 0.1}
    (centre,) = point["constraint_region"]["primitive_poses"]
    at = target[:3, 3] + target[:3, :3] @ [0.01, -0.02, 0.1] - [0, 0, 1]
    centre["position"] = dict(zip("xyz", at.tolist(), strict=True))
    last = by_name(ask(goal), -1)
    assert cell.link_pose(LEFT, last) == pytest.approx(target, abs=HAND)


def test_without_an_orientation_the_payload_keeps_its_own(cell, ask):
    goal = posed(moved(cell.bar, 0.0, 0.0, 0.1, yaw=1.0), "bar")
    del goal["orientation_constraints"]
    last = by_name(ask(cell.goal(goal_constraints=[goal])), -1)
    in_hand = np.linalg.inv(cell.link_pose(LEFT)) @ cell.bar
    assert cell.link_pose(LEFT, last) @ in_hand == pytest.approx(moved(cell.bar, 0.0, 0.0, 0.1), abs=HAND)


def test_one_of_several_goals_is_reached(cell, ask):
    said = []
    far, near = posed(moved(cell.bar, 3.0), "bar"), posed(moved(cell.bar, 0.0, 0.0, 0.1), "bar")
    assert ask(cell.goal(goal_constraints=[far, near]), tell=said.append)
    assert len(said) == 2


def test_a_changed_scene_is_that_of_the_request(cell, ask, refused):
    """A box at the goal is in the way; where the change removes it, it is not."""
    there = box("crate", [0.06, 0.06, 0.06], moved(cell.bar, 0.05, 0.0, 0.1))
    change = {"is_diff": True, "world": {"collision_objects": [there]}}
    code, text = refused(cell.goal(), cell.scene(), change)
    assert code == "GOAL_IN_COLLISION" and "crate" in text
    gone = {"is_diff": True, "world": {"collision_objects": [{"id": "crate", "operation": 1}]}}
    assert ask(cell.goal(), cell.scene(), change, gone)


def tilted(cell, body="bar", *, tolerances=(0.05, 0.05, 4.0), wanted=None, **more):
    """An orientation constraint on the way."""
    start = (cell.bar if body == "bar" else cell.link_pose(body)) if wanted is None else wanted
    kept = {f"absolute_{a}_axis_tolerance": t for a, t in zip("xyz", tolerances, strict=True)}
    one = {"header": {"frame_id": "world"}, "link_name": body, "orientation": pose(start)["orientation"]}
    return {"orientation_constraints": [{**one, **kept, **more}]}


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("body", ["bar", RIGHT])
def test_a_payload_stays_upright_on_the_way(cell, ask, body, kind):
    """The errors are computed here as MoveIt defines them."""
    start = cell.bar if body == "bar" else cell.link_pose(body)
    most = (0.05, 0.08, 4.0)
    free = 2
    path = tilted(cell, body, tolerances=most, parameterization=kind)
    if abs(start[2, 2]) < 0.99:  # no axis of this hand is vertical
        pytest.skip("the hand's axis is not vertical")
    motion = ask(cell.goal(moved(start, 0.05, 0.0, 0.1, yaw=0.4), body, path_constraints=path))
    in_hand = np.linalg.inv(cell.link_pose(LEFT)) @ start
    for row in range(0, len(motion.joints.time), 5):
        at = cell.link_pose(LEFT, by_name(motion, row)) @ in_hand
        error = Rotation.from_matrix(start[:3, :3].T @ at[:3, :3])
        off = np.abs(error.as_rotvec() if kind else error.as_euler("XYZ"))
        assert (np.delete(off, free) <= np.delete(most, free) + 1e-6).all()


def test_an_orientation_is_kept_on_the_way(cell, ask):
    path = tilted(cell, tolerances=(0.02, 0.02, 0.02))
    motion = ask(cell.goal(path_constraints=path))
    in_hand = np.linalg.inv(cell.link_pose(LEFT)) @ cell.bar
    for row in range(0, len(motion.joints.time), 5):
        at = cell.link_pose(LEFT, by_name(motion, row)) @ in_hand
        turn = Rotation.from_matrix(cell.bar[:3, :3].T @ at[:3, :3])
        assert (np.abs(turn.as_euler("XYZ")) <= 0.02 + 1e-6).all()


def test_path_constraints_that_cannot_be_kept_are_told(cell, refused):
    far = moved(cell.bar, 0.0, 0.0, 0.1, yaw=0.5)
    within = tilted(cell, tolerances=(0.6, 0.6, 0.6))
    code, text = refused(cell.goal(far, path_constraints=within))
    assert code == "PLANNING_FAILED" and "keep the orientation of the start" in text
    leaning = cell.bar.copy()
    leaning[:3, :3] = Rotation.from_euler("x", 0.2).as_matrix() @ leaning[:3, :3]
    assert refused(cell.goal(path_constraints=tilted(cell, wanted=leaning)))[0] == (
        "START_STATE_VIOLATES_PATH_CONSTRAINTS"
    )
    lean = moved(leaning, 0.0, 0.0, 0.1)
    assert refused(cell.goal(lean, path_constraints=tilted(cell)))[0] == "GOAL_VIOLATES_PATH_CONSTRAINTS"
    others = {"joint_constraints": [{"joint_name": "left_panda_joint1"}]}
    assert "orientation_constraints alone" in refused(cell.goal(path_constraints=others))[1]


def unlike(goal, **changes):
    return {**goal, "request": {**goal["request"], **changes}}


NAN = math.nan
BAD = {
    "a group that is not there": (
        lambda cell, goal: unlike(goal, group_name="arms"),
        "INVALID_GROUP_NAME",
        "there is no group 'arms'; name one of: two_pandas",
    ),
    "a goal out of reach": (
        lambda cell, goal: unlike(goal, goal_constraints=[posed(moved(cell.bar, 3.0), "bar")]),
        "NO_IK_SOLUTION",
        "cannot reach its goal",
    ),
    "an unknown frame": (
        lambda cell, goal: unlike(goal, goal_constraints=[posed(cell.bar, "bar", "map")]),
        "FRAME_TRANSFORM_FAILURE",
        "the frame 'map' is unknown, or moves; give the goal in one of: 'world', 'cell'",
    ),
    "a frame that moves": (
        lambda cell, goal: unlike(goal, goal_constraints=[posed(cell.bar, "bar", LEFT)]),
        "FRAME_TRANSFORM_FAILURE",
        "unknown, or moves",
    ),
    "to be executed": (
        lambda cell, goal: {**goal, "planning_options": {}},
        "CONTROL_FAILED",
        "set planning_options.plan_only to true",
    ),
    "another body": (
        lambda cell, goal: unlike(goal, goal_constraints=[posed(cell.bar, "table")]),
        "INVALID_LINK_NAME",
        "name one of: 'bar', '",
    ),
    "no goal": (
        lambda cell, goal: unlike(goal, goal_constraints=[]),
        "INVALID_GOAL_CONSTRAINTS",
        "there are no goal_constraints; give a position and an orientation of 'bar'",
    ),
    "an empty goal": (
        lambda cell, goal: unlike(goal, goal_constraints=[{}]),
        "INVALID_GOAL_CONSTRAINTS",
        "a goal is empty",
    ),
    "hands apart": (
        lambda cell, goal: unlike(goal, goal_constraints=[two_hands(cell, 0.02)]),
        "INVALID_GOAL_CONSTRAINTS",
        "at two poses, 20 mm and 0 deg apart; give the pose of one hand",
    ),
    "some joints": (
        lambda cell, goal: unlike(goal, goal_constraints=[joint_goal({"left_panda_joint1": 0.0})]),
        "INVALID_GOAL_CONSTRAINTS",
        "give the joints of all arms",
    ),
    "joints beyond limits": (
        lambda cell, goal: unlike(goal, goal_constraints=[all_joints(cell, left_panda_joint1=9.0)]),
        "INVALID_GOAL_CONSTRAINTS",
        "joint_constraints.left_panda_joint1: it is 9 rad, outside its limits",
    ),
    "a number that is none": (
        lambda cell, goal: unlike(goal, goal_constraints=[posed(moved(cell.bar, NAN), "bar")]),
        "INVALID_GOAL_CONSTRAINTS",
        "goal_constraints[0].position_constraints[0].constraint_region.primitive_poses[0].position.x is not a "
        "finite number",
    ),
    "a quaternion that is none": (
        lambda cell, goal: unlike(goal, goal_constraints=[turned(cell, w=3.0)]),
        "INVALID_GOAL_CONSTRAINTS",
        "has not the norm 1; give one, w last",
    ),
    "a factor above 1": (
        lambda cell, goal: unlike(goal, max_velocity_scaling_factor=1.5),
        "PLANNING_FAILED",
        "max_velocity_scaling_factor is 1.5; give a number above 0, and 1 at most",
    ),
    "a negative time": (
        lambda cell, goal: unlike(goal, allowed_planning_time=-1.0),
        "PLANNING_FAILED",
        "or 0 for 5 s",
    ),
    "a Cartesian speed": (
        lambda cell, goal: unlike(goal, max_cartesian_speed=0.1),
        "PLANNING_FAILED",
        "set it to 0, and use max_velocity_scaling_factor",
    ),
}


def two_hands(cell, apart):
    one, other = (posed(moved(cell.link_pose(link), 0.0, 0.0, 0.1), link) for link in (LEFT, RIGHT))
    one["position_constraints"] += other["position_constraints"]
    one["orientation_constraints"] += other["orientation_constraints"]
    (pose_of_other,) = other["position_constraints"][0]["constraint_region"]["primitive_poses"]
    pose_of_other["position"]["x"] += apart
    return one


def all_joints(cell, **changed):
    return joint_goal({name: cell.joints[name] for name in cell.robot.joint_names} | changed)


def turned(cell, **changed):
    goal = posed(moved(cell.bar, 0.0, 0.0, 0.1), "bar")
    goal["orientation_constraints"][0]["orientation"] |= changed
    return goal


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_met_is_refused_in_words(cell, refused, what):
    change, code, words = BAD[what]
    found = refused(change(cell, cell.goal()))
    assert found[0] == code and words in found[1]
    assert int(ErrorCode[code]) < 0


@pytest.mark.parametrize(
    "followed",
    [
        pytest.param(lambda cell: unlike(cell.goal(), group_name="two_pandas"), id="group"),
        pytest.param(lambda cell: unlike(cell.goal(), allowed_planning_time=0.0), id="time"),
        pytest.param(lambda cell: unlike(cell.goal(), max_velocity_scaling_factor=1.0), id="factor"),
        pytest.param(lambda cell: unlike(cell.goal(), goal_constraints=[two_hands(cell, 0.0)]), id="hands"),
    ],
)
def test_advice_that_is_followed_works(cell, ask, followed):
    assert ask(followed(cell)).joints.duration > 0


def test_a_payload_is_needed(cell, ask, refused):
    code, text = refused(cell.goal(), cell.scene(attached=False))
    assert code == "INVALID_OBJECT_NAME" and "attach it to one hand, and name the other hands" in text
    held = {"is_diff": True, "robot_state": {**cell.state(), "is_diff": True}}
    assert ask(cell.goal(), cell.scene(attached=False), held)


def test_joints_outside_their_limits_are_no_start(cell, refused):
    state = {"joint_state": {"name": ["left_panda_joint1"], "position": [7.0]}, "is_diff": True}
    code, text = refused(cell.goal(), cell.scene(), {"is_diff": True, "robot_state": state})
    assert code == "INVALID_ROBOT_STATE" and "left_panda_joint1" in text


def test_nothing_is_planned_without_a_planning_scene(cell, wire, planner):
    with pytest.raises(Refusal, match="by --scene, or send the whole scene"):
        planner.plan(wire.request(cell.goal()), [])


def test_a_request_that_is_cancelled_is_preempted(cell, refused):
    assert refused(cell.goal(), stop=lambda: True)[0] == "PREEMPTED"


def test_groups_are_those_of_the_srdf(cell, tmp_path):
    file = tmp_path / "cell.srdf"
    arms = "".join(
        f'<group name="{side}"><chain base_link="{side}_panda_link0" tip_link="{side}_panda_hand"/></group>'
        for side in ("left", "right")
    )
    both = '<group name="both"><group name="left"/><group name="right"/></group>'
    file.write_text(f'<robot name="cell">{arms}{both}</robot>')
    groups = groups_in(cell.robot, file)
    assert groups["both"] == groups["two_pandas"] == frozenset(cell.robot.joint_names)
    assert groups["left"] == {cell.robot.joint_names[c] for c in cell.robot.arm("left").columns}
    planner = MotionPlanner(cell.robot, PlanningSettings(srdf=file))
    wire = Wire()
    messages = [wire.encoded(cell.scene())]
    assert (
        planner.plan(wire.request(unlike(cell.goal(), group_name="both")), messages).joints == groups["both"]
    )
    with pytest.raises(Refusal, match=r"lacks joints of .*right.*; name one of: two_pandas, both"):
        planner.plan(wire.request(unlike(cell.goal(), group_name="left")), messages)


def test_a_scene_as_text_is_the_same_as_messages(tmp_path):
    text, bag = tmp_path / "cell.scene", tmp_path / "cell.mcap"
    text.write_text(MOVEIT)
    write(bag, [encoded(planning_scene_in(text))])
    for one, other in zip(obstacles_in(bag), obstacles_in(text), strict=True):
        assert one["name"] == other["name"] and one["shape"] == other["shape"]
        assert one["center"] == pytest.approx(other["center"], abs=1e-12)
        for key in ("size", "radius", "height"):
            assert one.get(key) == pytest.approx(other.get(key))
