"""Runs without a simulator: the robot is where it was commanded, or as far off as a test says."""

from functools import lru_cache

import numpy as np
import pytest

from comove.control import Clouds
from comove.control.safety.twists import nodes_of
from comove.errors import OptionError, RobotError
from comove.model import Scene
from comove.robots.online.executor import JointExecutor, OnlineSettings
from comove.robots.online.pilot import PilotSettings
from comove.robots.online.recovery import RecoverySettings, way_back
from tests.robots.known_carry import TABLE, posts, scene_data
from tests.robots.online.test_recovery import displaced
from tests.robots.small_robots import robot
from tests.robots.test_tilting import tray_data

AWAY = {"shape": "sphere", "center": [0.55, 0.9, 0.2], "radius": 0.08}


@lru_cache(maxsize=4)
def scene_with(motion=None):
    """The known carry of Baxter between its posts, and a ball that goes to and fro."""
    ball = () if motion is None else ({**AWAY, "motion": {"waypoints": motion[0], "times": motion[1]}},)
    return Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.30), *ball)))


def through(*points, times):
    """Waypoints and times that can be a key."""
    return tuple(tuple(point) for point in points), tuple(times)


def test_settings_of_the_pilot_that_are_not_positive_are_refused():
    with pytest.raises(OptionError, match="every"):
        OnlineSettings(pilot=PilotSettings(every=0.0))
    with pytest.raises(OptionError, match="rests"):
        OnlineSettings(recovery=RecoverySettings(rests=0.0))


def test_clouds_are_refused():
    """Rows of links would be read for obstacles that only clouds have shown."""
    scene = scene_with()
    with pytest.raises(OptionError, match=r"not of clouds.*Observed"):
        JointExecutor(scene, robot("baxter"), Clouds(scene))


def run(executor, longest):
    """Commands until the load has arrived."""
    commands = [executor.position.copy()]
    while executor.time < longest and not executor.arrived:
        commands.append(executor.step(commands[-1]))
    return np.array(commands)


def hold_error(executor, commands, poses):
    """Largest error of the hands on the load, by Pinocchio; poses of the load after every command."""
    machine, scene = executor.robot, executor.scene
    worst = 0.0
    for q, nodes in zip(commands[1:], poses, strict=True):
        hands = nodes[:2]
        turns = scene.grasp.hand_rotations(hands)
        for i, arm in enumerate(executor.held.carrier.holders):
            pose = machine.tool_pose(q, arm)
            worst = max(worst, np.abs(pose[:3, 3] - hands[i]).max(), np.abs(pose[:3, :3] - turns[i]).max())
    return worst


@pytest.mark.slow
def test_a_run_among_what_stands_is_the_verified_carry():
    executor = JointExecutor(scene_with(), robot("baxter"), seed=1)
    commands = run(executor, 15.0)
    assert executor.arrived
    assert executor.time == pytest.approx(executor.plan.joints.duration, abs=0.3)
    planned = executor.plan.joints.at(
        np.minimum(0.004 * np.arange(len(commands)), executor.plan.joints.duration)
    )[0]
    assert np.abs(commands - planned).max() < 0.02
    assert len(executor.log.planning) == 1


@pytest.mark.slow
def test_what_comes_is_dodged_and_the_load_held_all_the_way():
    moving = through([0.55, 0.9, 0.2], [0.55, -0.9, 0.2], times=(1.0, 6.0))
    executor = JointExecutor(scene_with(moving), robot("baxter"), seed=1)
    nodes, commands, near = [], [executor.position.copy()], np.inf
    while executor.time < 40.0 and not executor.arrived:
        commands.append(executor.step(commands[-1]))
        nodes.append(nodes_of(executor.scene, executor.poses))
        center = executor.observer.ground_truth(np.array([executor.time]))[0, -1]
        share = np.linspace(0, 1, 30)[:, None]
        near = min(
            near, np.linalg.norm(nodes[-1][0] + share * (nodes[-1][1] - nodes[-1][0]) - center, axis=1).min()
        )
    commands = np.array(commands)
    assert executor.arrived
    assert any("another course" in event.what for event in executor.log.events)
    assert near > 0.08 + 0.012 + executor.scene.clearance - 1e-3
    assert hold_error(executor, commands, nodes) < 1e-8
    machine, period = executor.robot, executor.settings.period
    rates = np.diff(commands, axis=0) / period
    assert (np.abs(rates) <= machine.velocity * (1 + 1e-6)).all()
    assert (commands >= machine.lower).all() and (commands <= machine.upper).all()
    assert (np.abs(np.diff(rates, axis=0)) / period <= machine.acceleration * 1.05).all()


@pytest.mark.slow
def test_a_run_repeats_to_the_last_digit():
    moving = through([0.55, 0.9, 0.2], [0.55, -0.9, 0.2], times=(1.0, 6.0))
    runs = [run(JointExecutor(scene_with(moving), robot("baxter"), seed=3), 3.0) for _ in range(2)]
    np.testing.assert_array_equal(*runs)


@pytest.mark.slow
def test_a_robot_that_does_not_come_along_is_waited_for_and_then_told_of():
    executor = JointExecutor(scene_with(), robot("baxter"), seed=1)
    stuck = executor.position.copy()
    for _ in range(1500):
        executor.step(stuck)
    lag = np.abs(executor.position - stuck).max()
    assert lag < 2 * executor.settings.lag
    assert executor.replanner.clock < executor.plan.joints.duration / 2
    far = stuck.copy()
    far[3] += 1.0
    with pytest.raises(RobotError, match="rad from where it was commanded"):
        executor.step(far)
    for wrong in (stuck[:3], np.full(len(stuck), np.nan)):
        with pytest.raises(RobotError, match="measured joints"):
            executor.step(wrong)


@pytest.mark.slow
def test_a_robot_that_was_driven_off_gives_way_and_goes_on_from_where_it_stands():
    executor = JointExecutor(scene_with(), robot("baxter"), seed=1, settings=OnlineSettings(lost=0.2))
    with pytest.raises(RobotError, match="was not driven off"):
        executor.recover(executor.position)
    for _ in range(300):
        executor.step(executor.position)
    machine, arms = executor.robot, executor.held.carrier.holders
    held = np.array([machine.tool_pose(executor.position, arm) for arm in arms])
    tilted = displaced(held, np.array([0.3, 0.2, 0.0]), np.array([-0.05, 0.0, 0.04]))
    away = executor.position.copy()
    away[executor.held.columns] = way_back(
        executor.held.carrier.arms, away[executor.held.columns], held, tilted
    )[-1]
    before = executor.position.copy()
    with pytest.raises(RobotError, match="rad from where it was commanded"):
        executor.step(away)
    assert executor.driven_off
    np.testing.assert_array_equal(executor.position, before)
    measured, gives = before, executor.settings.recovery.gives
    for share in np.linspace(0.0, 1.0, 100):  # it is still driven
        measured = before + share * (away - before)
        assert np.abs(executor.recover(measured) - measured)[executor.held.columns].max() <= gives + 1e-12
    for _ in range(60):  # it stands, but not for long enough
        command = executor.recover(measured)
    assert np.abs(command - measured).max() <= gives + 1e-12
    while executor.driven_off:
        assert executor.time < 20.0
        command = executor.recover(command)
    nodes, commands = [], [command]
    while executor.time < 40.0 and not executor.arrived:
        commands.append(executor.step(commands[-1]))
        nodes.append(nodes_of(executor.scene, executor.poses))
    assert executor.arrived
    assert hold_error(executor, np.array(commands), nodes) < 1e-8
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.004 * machine.velocity.max()
    assert [event.what for event in executor.log.events][-2:-1] == ["it goes on from where it stands"]
    with pytest.raises(RobotError):
        executor.step(away)
    with pytest.raises(RobotError, match="measured joints"):
        executor.recover(np.full(len(away), np.nan))
    with pytest.raises(RobotError, match="has not come to stand since"):
        for k in range(6000):
            executor.recover(before + 0.02 * np.sin(0.3 * k))


@pytest.mark.parametrize("change", [{"period": 0.0}, {"period": 0.5}, {"leisure": -1.0}, {"lag": np.nan}])
def test_settings_that_make_no_sense_are_refused(change):
    with pytest.raises(OptionError):
        OnlineSettings(**change)


@pytest.mark.slow
def test_a_tray_is_tilted_step_by_step_while_something_moves():
    """Commands hold it in every pose, by Pinocchio, and a robot that stands elsewhere is known by its hands."""
    ball = {
        "shape": "sphere",
        "center": [0.5, 0.0, 1.2],
        "radius": 0.06,
        "motion": {"waypoints": [[0.5, 0.0, 1.2], [0.5, 0.0, 1.0]], "times": [0.0, 2.0]},
    }
    scene = Scene.from_dict(tray_data(obstacles=[ball], duration=4.0))
    machine = robot("two_pandas")
    executor, off = JointExecutor(scene, machine, seed=0), []
    arms = [machine.arm(name) for name in scene.manipulators]
    command = executor.position.copy()
    while executor.time < 9.0 and not executor.arrived:
        command = executor.step(command)
        nodes = nodes_of(scene, executor.poses)
        wanted = scene.grasp.hand_rotations(nodes)
        held = np.array([machine.tool_pose(command, arm) for arm in arms])
        off.append(max(np.abs(held[:, :3, 3] - nodes[:2]).max(), np.abs(held[:, :3, :3] - wanted).max()))
        told = executor._nearest(held)
        np.testing.assert_allclose(nodes_of(scene, told), nodes, atol=1e-6)
    assert executor.arrived
    assert max(off) < 1e-6
    np.testing.assert_allclose(nodes_of(scene, executor.poses), scene.nodes_at("goal"), atol=2e-3)
