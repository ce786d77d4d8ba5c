"""Tasks of several phases: what holds for their plans, by the robot's own kinematics, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.errors import OptionError, TaskError
from comove.robots import Robot
from comove.tasks import Body, Grasp, Task, World

TABLE = {
    "name": "table",
    "shape": "box",
    "center": [0.9, 0.0, -0.05],
    "size": [0.8, 3.0, 0.1],
    "support": True,
}
TILTED = {"along": [0.0, 1.0, 0.0], "tilt_deg": (-20.0, 20.0), "flip": True}


def pose(x, y, z, rotation=None):
    found = np.eye(4)
    found[:3, 3] = x, y, z
    if rotation is not None:
        found[:3, :3] = rotation.as_matrix()
    return found


def board(name="board", x=0.6, sites=(0.2, -0.2)):
    """A board on the table, with a site at each hand."""
    places = {side: pose(0.0, y, 0.06) for side, y in zip(("left", "right"), sites, strict=True)}
    return Body(name, ({"shape": "box", "size": [0.05, 0.6, 0.12]},), 1.0, pose(x, 0.0, 0.06), places)


@pytest.fixture(scope="module")
def robot():
    return Robot.load("two_ur10")


def task_of(robot, *bodies):
    return Task(World(robot, (TABLE,), {body.name: body for body in bodies}))


def approached(task, body, **grasp):
    task.approach(**{arm: Grasp(body, arm, **(grasp or TILTED)) for arm in ("left", "right")})


@pytest.fixture(scope="module")
def carried(robot):
    """A board that is lifted, set down elsewhere and left; its task's plan."""
    body = board()
    task = task_of(robot, body)
    approached(task, body)
    task.close(0.8)
    task.carry(body, shift=[0.1, 0.0, 0.2], upright=True)
    task.set_down(body, "table", [0.8, 0.0])
    task.open(0.6)
    task.retreat()
    return task, body, task.solve(budget=20.0)


def test_parts_follow_on_one_another_at_rest(carried, robot):
    _, _, plan = carried
    assert [part.phases for part in plan.parts] == [
        ("approach", "close"),
        ("carry",),
        ("carry",),
        ("open", "retreat"),
    ]
    np.testing.assert_allclose(plan.parts[0].motion.position[0], robot.home, atol=1e-12)
    np.testing.assert_allclose(plan.parts[-1].motion.position[-1], robot.home, atol=1e-12)
    for before, after in zip(plan.parts[:-1], plan.parts[1:], strict=True):
        np.testing.assert_allclose(before.motion.position[-1], after.motion.position[0], atol=1e-9)
    for part in plan.parts:
        rates = part.motion.curve(np.array([0.0, part.motion.duration]), 1)
        assert np.abs(rates).max() < 1e-9
        assert part.clearance_min >= 0.005 - 1e-9


def test_the_body_is_where_its_hands_carry_it(carried, robot):
    """By forward kinematics alone: both hands keep their places on it, it stays upright, and it ends on the table."""
    task, body, plan = carried
    start = [robot.tool_pose(plan.parts[1].motion.position[0], arm) for arm in robot.arms]
    held = [np.linalg.inv(hand) @ body.pose for hand in start]
    for part in plan.parts[1:3]:
        for q in part.motion.position[::10]:
            places = [robot.tool_pose(q, arm) @ grip for arm, grip in zip(robot.arms, held, strict=True)]
            np.testing.assert_allclose(places[0], places[1], atol=1e-5)
            assert places[0][2, 2] > np.cos(np.deg2rad(5.0)) - 1e-6
    end = robot.tool_pose(plan.parts[2].motion.position[-1], robot.arms[0]) @ held[0]
    np.testing.assert_allclose(end, task.pose_of(body), atol=1e-5)
    np.testing.assert_allclose(end[:3, 3], [0.8, 0.0, 0.06], atol=1e-5)


def test_hands_come_to_their_sites_open_and_leave_open(carried, robot):
    _, body, plan = carried
    approach = plan.parts[0]
    for arm in robot.arms:
        at = approach.motion.curve(np.array([approach.closing[arm.name]]))[0]
        hand, site = robot.tool_pose(at, arm), body.pose @ body.sites[arm.name]
        np.testing.assert_allclose(hand[:3, 3], site[:3, 3], atol=1e-5)
        assert abs(approach.motion.duration - approach.closing[arm.name] - 0.8) < 0.011
    commands = list(plan.stream(50.0))
    begins = plan.parts[0].motion.duration
    ends = begins + sum(part.motion.duration for part in plan.parts[1:3])
    for command in commands:
        assert all(np.isfinite(q).all() for q in command.joints.values())
        if command.time < begins - 0.9 or command.time > ends:
            assert not any(command.closed.values())
        if begins < command.time < ends:
            assert all(command.closed.values()) and command.phases == ("carry",)
    assert commands[0].time == 0.0 and commands[-1].time == plan.duration


def test_streams_are_the_motions(carried, robot):
    _, _, plan = carried
    fastest = max(np.abs(part.motion.velocity).max() for part in plan.parts)
    steps = list(plan.stream(100.0))
    for before, after in zip(steps[:-1], steps[1:], strict=True):
        for arm in robot.arms:
            assert (
                np.abs(after.joints[arm.name] - before.joints[arm.name]).max() <= 1.01 * fastest * 0.01 + 1e-9
            )
    with pytest.raises(OptionError, match="rate"):
        next(plan.stream(0.0))


@pytest.mark.slow
def test_one_body_after_the_other_and_each_is_in_the_others_way(robot):
    first, second = board("first", 0.6), board("second", 0.85)
    task = task_of(robot, first, second)
    approached(task, first)
    task.close()
    task.carry(first, shift=[0.0, 0.0, 0.25])
    task.set_down(first, "table", [1.05, 0.0])
    task.open()
    task.retreat()
    approached(task, second)
    task.close()
    task.carry(second, shift=[-0.2, 0.0, 0.1])
    plan = task.solve(budget=40.0)
    assert len(plan.parts) == 6
    for before, after in zip(plan.parts[:-1], plan.parts[1:], strict=True):
        np.testing.assert_allclose(before.motion.position[-1], after.motion.position[0], atol=1e-9)
    names = {obstacle.name for obstacle in plan.parts[-1].solution.scene.file.obstacles}
    assert names == {"table", "first_0"}
    (there,) = (o for o in plan.parts[-1].solution.scene.file.obstacles if o.name == "first_0")
    np.testing.assert_allclose(there.center, [1.05, 0.0, 0.06], atol=1e-9)


@pytest.mark.slow
def test_a_goal_in_another_body_is_told_with_its_phase(robot):
    first, second = board("first", 0.6), board("second", 0.85)
    task = task_of(robot, first, second)
    approached(task, first)
    task.close()
    task.carry(first, shift=[0.25, 0.0, 0.0])
    with pytest.raises(TaskError, match=r"carry 1 of 'first'.*second_0"):
        task.solve(budget=5.0)


@pytest.fixture(scope="module")
def handed(robot):
    """A stick that the left arm lifts and gives to the right one, which sets it down; its plan."""
    low = {**TABLE, "center": [0.9, 0.0, -0.05], "size": [0.8, 3.0, 0.17]}
    sites = {side: pose(0.0, y, 0.025) for side, y in (("left", 0.1), ("right", -0.1))}
    stick = Body("stick", ({"shape": "box", "size": [0.05, 0.3, 0.05]},), 0.3, pose(0.6, 0.2, 0.06), sites)
    task = Task(World(robot, (low,), {"stick": stick}))
    held = {"along": [0.0, 1.0, 0.0], "tilt_deg": (-60.0, 60.0), "flip": True}
    task.approach(left=Grasp(stick, "left", **held))
    task.close()
    task.carry(stick, to=pose(0.8, 0.0, 0.7))
    task.hand_over(stick, right=Grasp(stick, "right", **held))
    task.carry(stick, shift=[0.0, -0.2, -0.1])
    task.set_down(stick, "table", [0.7, -0.5], upright=False)
    task.open()
    task.retreat()
    return task, stick, task.solve(budget=40.0)


@pytest.mark.slow
def test_a_body_is_held_at_every_instant_of_a_hand_over(handed, robot):
    """By forward kinematics: who holds it stands still meanwhile, and it is where it was given."""
    task, stick, plan = handed
    assert [part.phases[0] for part in plan.parts] == [
        *("approach", "carry", "hand_over", "hand_over"),
        *("carry", "carry", "open"),
    ]
    for before, after in zip(plan.parts[:-1], plan.parts[1:], strict=True):
        np.testing.assert_allclose(before.motion.position[-1], after.motion.position[0], atol=1e-9)
    left, right = robot.arms
    coming, leaving = (part.motion.position for part in plan.parts[2:4])
    assert np.ptp(coming[:, left.columns], axis=0).max() == 0.0
    assert np.ptp(leaving[:, right.columns], axis=0).max() == 0.0
    grip = np.linalg.inv(robot.tool_pose(plan.parts[1].motion.position[0], left)) @ stick.pose
    given = robot.tool_pose(coming[0], left) @ grip
    np.testing.assert_allclose(given[:3, 3], [0.8, 0.0, 0.7], atol=1e-5)
    taken = np.linalg.inv(robot.tool_pose(coming[-1], right)) @ given
    end = robot.tool_pose(plan.parts[5].motion.position[-1], right) @ taken
    np.testing.assert_allclose(end, task.pose_of(stick), atol=1e-5)
    np.testing.assert_allclose(
        robot.tool_pose(coming[-1], right)[:3, 3], (given @ stick.sites["right"])[:3, 3], atol=1e-5
    )
    begins = plan.parts[0].motion.duration
    ends = sum(part.motion.duration for part in plan.parts[:6])
    for command in plan.stream(20.0):
        if begins <= command.time <= ends - 0.05:
            assert any(command.closed.values())  # nobody drops it
    assert not any(command.closed.values())


@pytest.mark.slow
def test_nothing_touches_while_it_is_handed_over(handed, robot):
    """By the exact bodies at samples: arms with each other, and with the stick but for the hands at it."""
    import coal
    import pinocchio as pin

    _, stick, plan = handed
    geometry, data, placed = robot.collision, robot.model.createData(), robot.collision.createData()
    box = coal.Box(*stick.parts[0]["size"])
    grip = np.linalg.inv(robot.tool_pose(plan.parts[1].motion.position[0], robot.arms[0])) @ stick.pose
    where = robot.tool_pose(plan.parts[2].motion.position[0], robot.arms[0]) @ grip
    at = coal.Transform3s(where[:3, :3], where[:3, 3])
    for part in plan.parts[2:4]:
        for q in part.motion.position[::20]:
            pin.updateGeometryPlacements(robot.model, data, geometry, placed, q)
            assert not pin.computeCollisions(geometry, placed, False)
            for number, item in enumerate(geometry.geometryObjects):
                name = robot.model.frames[item.parentFrame].name
                if "wrist_3" in name or "wrist_2" in name:  # of hands that hold it, or come to
                    continue
                place, found = placed.oMg[number], coal.DistanceResult()
                there = coal.Transform3s(place.rotation, place.translation)
                coal.distance(item.geometry, there, box, at, coal.DistanceRequest(), found)
                assert found.min_distance > 0.004, name


@pytest.mark.slow
def test_a_hand_over_out_of_reach_is_told(robot):
    stick = Body("stick", ({"shape": "box", "size": [0.05, 0.3, 0.05]},), 0.3, pose(0.6, 0.2, 0.06))
    task = task_of(robot, stick)
    held = {"along": [0.0, 1.0, 0.0], "tilt_deg": (-60.0, 60.0)}
    task.approach(left=Grasp(stick, position=[0.0, 0.1, 0.025], **held))
    task.close()
    task.carry(stick, to=pose(0.5, 1.3, 0.5))
    task.hand_over(stick, right=Grasp(stick, position=[0.0, -0.1, 0.025], **held))
    task.carry(stick, shift=[0.0, -0.2, 0.0])
    with pytest.raises(TaskError, match=r"carry 1 of 'stick'.*right"):
        task.solve(budget=10.0)


@given(
    seed=st.integers(0, 10_000),
    tilt=st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)).map(sorted),
    flip=st.booleans(),
    most=st.integers(1, 12),
)
def test_ways_to_hold_are_what_a_grasp_says(seed, tilt, flip, most):
    """Fingers close across `along`, from a direction within the tilt of the approach."""
    rng = np.random.default_rng(seed)
    turn, along = Rotation.random(random_state=seed), rng.normal(size=3)
    body = Body("body", ({"shape": "box", "size": [0.1, 0.1, 0.1]},), 1.0, pose(0, 0, 0, turn))
    along /= np.linalg.norm(along)
    if np.linalg.norm(np.cross(turn.apply(along), [0, 0, 1])) < 0.1:
        return
    ways = Grasp(body, position=[0.1, 0.2, 0.3], along=along, tilt_deg=tuple(tilt), flip=flip).ways(most)
    assert 1 <= len(ways) <= max(most, 2 if flip else 1)
    straight = turn.inv().apply([0.0, 0.0, -1.0])
    straight -= (straight @ along) * along
    straight /= np.linalg.norm(straight)
    for way in ways:
        approach, closing = np.array(way["approach"]), np.array(way["closing"])
        for vector in (approach, closing):
            assert abs(np.linalg.norm(vector) - 1.0) < 1e-9 and abs(vector @ along) < 1e-9
        assert abs(approach @ closing) < 1e-9
        angle = np.rad2deg(np.arctan2(np.cross(straight, approach) @ along, straight @ approach))
        assert tilt[0] - 1e-6 <= angle <= tilt[1] + 1e-6
    if flip:
        sides = {tuple(np.round(way["closing"], 9)) for way in ways}
        assert all(tuple(-np.array(side)) in {tuple(np.array(s)) for s in sides} for side in sides)


def test_what_fingers_hold_is_guessed_from_the_nearest_part():
    handle = {"shape": "box", "size": [0.02, 0.11, 0.02], "position": [0.16, 0.0, 0.06]}
    pot = Body("pot", ({"shape": "box", "size": [0.3, 0.3, 0.1]}, handle), 1.0, np.eye(4))
    (way,) = Grasp(pot, position=[0.16, 0.0, 0.06]).ways(1)
    assert abs(way["closing"][0]) == 1.0  # across the bar, which is along y


@pytest.mark.parametrize(
    ("grasp", "words", "advice"),
    [
        ({"site": "lefd"}, "no site 'lefd'", "left"),
        ({"along": [0.0, 0.0, 1.0]}, "along what its fingers would hold", "another direction"),
        ({"along": [0.0, 0.0, 0.0]}, "no direction", "not all 0"),
        ({"along": [1.0, np.nan, 0.0]}, "no direction", "three numbers"),
        ({"approach": [1.0]}, "no direction", "three numbers"),
        ({"along": "x"}, "no direction", "three numbers"),
        ({"position": [0.0, 0.1]}, "the position is", "three numbers"),
        ({"position": "top"}, "the position is", "three numbers"),
        ({"tilt_deg": (40.0, -40.0)}, "the tilt is", "least and largest"),
        ({"tilt_deg": 40.0}, "the tilt is", "least and largest"),
    ],
)
def test_grasps_that_cannot_be(grasp, words, advice):
    with pytest.raises(TaskError, match=words) as found:
        Grasp(board(), **grasp)
    assert advice in str(found.value)


def test_a_body_without_edges_asks_for_a_direction():
    ball = Body("ball", ({"shape": "mesh", "file": "ball.stl"},), 1.0, np.eye(4))
    with pytest.raises(TaskError, match=r"give along=\[x, y, z\]"):
        Grasp(ball)


def refused(act):
    with pytest.raises(TaskError) as found:
        act()
    assert found.value.way_out
    return str(found.value)


def test_phases_that_contradict_each_other(robot):
    body, other = board(), board("other", 0.9)
    task = task_of(robot, body, other)
    grasps = {arm: Grasp(body, arm, **TILTED) for arm in ("left", "right")}
    assert "no phase" in refused(lambda: task.solve())
    assert "no hand has approached" in refused(task.close)
    assert "no arm 'lefd'; did you mean 'left'" in refused(lambda: task.approach(lefd=grasps["left"]))
    assert "give a Grasp" in refused(lambda: task.approach(left=body))
    assert "no arm is named" in refused(task.approach)
    both = {"left": grasps["left"], "right": Grasp(other, "right", **TILTED)}
    assert "board and other" in refused(lambda: task.approach(**both))
    assert "'board' is not held" in refused(lambda: task.carry(body, shift=[0, 0, 0.1]))
    task.approach(**grasps)
    assert "'board' is not held" in refused(lambda: task.carry(body, shift=[0, 0, 0.1]))
    for time in (0.0, -1.0, np.nan, np.inf):
        assert "positive" in refused(lambda time=time: task.close(time))
    task.close()
    assert "hands are full" in refused(lambda: task.approach(**grasps))
    assert "nothing was carried" in refused(task.open)
    assert "no hand was opened" in refused(task.retreat)
    assert "'other' is not held" in refused(lambda: task.carry(other, shift=[0, 0, 0.1]))
    assert "not one goal" in refused(lambda: task.carry(body))
    assert "not one goal" in refused(lambda: task.carry(body, to=np.eye(4), shift=[0, 0, 0.1]))
    assert "no pose" in refused(lambda: task.carry(body, to=2.0 * np.eye(4)))
    assert "three numbers" in refused(lambda: task.carry(body, shift=[0.1, np.nan, 0.0]))
    assert "no obstacle 'tabel'; did you mean 'table'" in refused(
        lambda: task.set_down(body, "tabel", [0.8, 0.0])
    )
    assert "nothing was carried" in refused(lambda: task.hand_over(body, left=grasps["left"]))
    task.carry(body, shift=[0.0, 0.0, 0.1])
    assert "holds it already" in refused(lambda: task.hand_over(body, left=grasps["left"]))
    task.open()
    assert "retreat before" in refused(lambda: task.approach(**grasps))
    with pytest.raises(TaskError, match="did you mean 'board'"):
        task.world.body("boards")


@pytest.mark.parametrize("upright", [0.0, -1.0, np.nan, 180.0, "yes"])
def test_how_upright_must_be_a_tolerance(robot, upright):
    body = board()
    task = task_of(robot, body)
    approached(task, body)
    task.close()
    assert "tolerance below 180" in refused(lambda: task.carry(body, shift=[0, 0, 0.1], upright=upright))
    for at in ([0.8], [0.8, 0.0, 0.0], "table", [np.nan, 0.0]):
        assert "give x and y" in refused(lambda at=at: task.set_down(body, "table", at))
    for to in ("there", np.eye(3), [[1.0]]):
        assert "no pose" in refused(lambda to=to: task.carry(body, to=to))
    assert task.stages[0].legs == []  # nothing of it was taken


def test_a_body_of_another_world_is_not_approached(robot):
    task = task_of(robot, board())
    assert "no body 'other'" in refused(lambda: approached(task, board("other")))


@pytest.mark.slow
def test_a_shelf_on_which_a_body_was_set_down_carries_it(robot):
    """Though nothing rests on it at first."""
    shelf = {"name": "shelf", "shape": "box", "center": [1.0, 0.0, 0.1], "size": [0.1, 1.0, 0.02]}
    body = board()
    task = Task(World(robot, (TABLE, shelf), {body.name: body}))
    approached(task, body)
    task.close()
    task.carry(body, shift=[0.1, 0.0, 0.3])
    task.set_down(body, "shelf", [1.0, 0.0])
    task.open()
    task.retreat()
    approached(task, body)
    task.close()
    task.carry(body, shift=[-0.1, 0.0, 0.2])
    plan = task.solve(budget=40.0)
    rests = [
        {one.name for one in part.solution.scene.file.obstacles if getattr(one, "support", False)}
        for part in plan.parts
        if part.phases == ("carry",)
    ]
    assert rests == [{"table"}, {"shelf"}, {"shelf"}]


def test_an_approach_alone_is_no_task(robot):
    task = task_of(robot, board())
    approached(task, board())
    assert "approached and not carried" in refused(lambda: task.solve())


def test_set_down_needs_a_level_box(robot):
    tilted = {**TABLE, "quaternion_wxyz": Rotation.from_euler("x", 0.3).as_quat()[[3, 0, 1, 2]].tolist()}
    body = board()
    task = Task(World(robot, (tilted,), {"board": body}))
    approached(task, body)
    task.close()
    assert "no level box" in refused(lambda: task.set_down(body, "table", [0.8, 0.0]))


def test_grasps_are_of_bodies_where_they_are_then(robot):
    """From above is from above also where the body was turned on the way."""
    body = board()
    task = task_of(robot, body)
    task.approach(left=Grasp(body, "left", **TILTED))
    task.close()
    turned = pose(0.7, 0.0, 0.5, Rotation.from_euler("y", 180, degrees=True))
    task.carry(body, to=turned)
    task.hand_over(body, right=Grasp(body, "right", along=[0.0, 1.0, 0.0]))
    (way,) = task.stages[-1].grasps["right"].ways(1)
    np.testing.assert_allclose(turned[:3, :3] @ way["approach"], [0.0, 0.0, -1.0], atol=1e-12)


def test_a_body_that_has_sunk_a_little_is_lifted_out(robot):
    body = board()
    deep = body.at(pose(0.6, 0.0, 0.0592))
    task = task_of(robot, deep)
    approached(task, deep)
    task.close()
    task.carry(deep, shift=[0.0, 0.0, 0.2])
    task.carry(deep, shift=[0.05, 0.0, 0.0])
    plan = task.solve(budget=10.0)
    start = plan.parts[1].solution.scene.file.load.start
    assert start.position[2] == pytest.approx(0.06, abs=1e-6)
    first, last = plan.parts[1].motion.position[0], plan.parts[2].motion.position[-1]
    for arm in robot.arms:  # it is held as it is lifted out, to the end
        end = robot.tool_pose(last, arm) @ np.linalg.inv(robot.tool_pose(first, arm)) @ pose(0.6, 0.0, 0.06)
        np.testing.assert_allclose(end, task.pose_of(deep), atol=1e-5)
    deeper = body.at(pose(0.6, 0.0, 0.05))
    task = task_of(robot, deeper)
    approached(task, deeper)
    task.close()
    task.carry(deeper, shift=[0.0, 0.0, 0.2])
    assert "m deep in table" in refused(lambda: task.solve(budget=5.0))
