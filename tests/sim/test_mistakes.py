"""What users may get wrong is told in a sentence; settings of what is measured change nothing that is measured."""

import dataclasses
from functools import lru_cache

import numpy as np
import pytest

from comove.errors import ComoveError, ComoveWarning, OptionError, RobotError
from comove.model import Scene
from comove.robots import JointMotion, Robot
from comove.sim import (
    Friction,
    Perturbation,
    Push,
    Settings,
    draw_film,
    draw_sheet,
    simulate,
    write_simulation,
)
from tests.sim.benchmark import posts, standing

INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
SHAPE = '<collision><geometry><box size="0.05 0.05 0.2"/></geometry></collision>'
LINK = f'<link name="{{}}"><inertial><mass value="1"/>{INERTIA}</inertial>{SHAPE}</link>'
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>'
JOINT += '<limit lower="-3" upper="3" velocity="2" effort="50"/></joint>'


def small_robot(folder, elbow="elbow", wrist=LINK):
    """Two joints; a link has the name `elbow`."""
    parts = [
        '<link name="base"/>',
        LINK.format(elbow),
        wrist.format("wrist"),
        JOINT.format("first", "revolute", "base", elbow),
        JOINT.format("second", "revolute", elbow, "wrist"),
    ]
    (folder / "small.urdf").write_text(f'<robot name="small">{"".join(parts)}</robot>')
    path = folder / "small.yaml"
    path.write_text(
        "name: small\nmodels: [{urdf: small.urdf}]\narms: {hand: {tip: wrist, home: [0.5, 0.5]}}\n"
    )
    return Robot.load(path)


@pytest.mark.parametrize("inertial", ["", '<inertial><mass value="0"/>' + INERTIA + "</inertial>"])
def test_a_link_without_a_mass_is_given_one_of_its_body_and_stands_still(inertial, tmp_path):
    with pytest.warns(ComoveWarning, match=r"guessed from collision bodies.*wrist 0\.5 kg"):
        robot = small_robot(tmp_path, wrist='<link name="{}">' + inertial + SHAPE + "</link>")
    execution = simulate(*resting(robot), robot)
    assert np.abs(execution.joints - robot.home).max() < 1e-3
    assert np.abs(execution.torque).max() < 50.0


def test_a_joint_that_moves_nothing_with_a_mass_is_not_simulated_and_the_advice_works(tmp_path):
    robot = small_robot(tmp_path, wrist='<link name="{}"/>')
    with pytest.raises(RobotError, match="nothing that the joint 'second' moves has a mass") as caught:
        simulate(*resting(robot), robot)
    advised = str(caught.value).partition("in the URDF: ")[2]
    robot = small_robot(tmp_path, wrist='<link name="{}">' + advised + "</link>")
    execution = simulate(*resting(robot), robot)
    assert np.abs(execution.joints - robot.home).max() < 1e-3


def resting(robot):
    """The small robot stands still with nothing in its hand."""
    place = robot.tool_pose(robot.home, robot.arms[0])[:3, 3].tolist()
    scene = Scene.from_dict(
        {
            "name": "still",
            "duration": 0.2,
            "workspace": {"lower": [-2, -2, -2], "upper": [2, 2, 2]},
            "manipulators": [{"name": "hand", "start": place, "goal": place}],
        }
    )
    time = np.linspace(0.0, 0.2, 21)
    return JointMotion(time, robot.joint_names, np.repeat(robot.home[None], 21, axis=0)), scene


@lru_cache(maxsize=1)
def stood():
    robot, motion = standing(0.1)
    return simulate(motion, posts(), robot)


@pytest.mark.parametrize("name", ["scene", "load", "still", "elbow"])
def test_links_may_be_called_as_one_likes(tmp_path, name):
    robot = small_robot(tmp_path, elbow=name)
    motion, scene = resting(robot)
    execution = simulate(motion, scene, robot)
    assert execution.delivered, execution.reasons


def test_a_load_has_no_name_that_a_link_may_have():
    from comove.sim.engine import THE_LOAD
    from comove.sim.urdf import ROOT

    assert " " in THE_LOAD and " " in ROOT


def test_what_mujoco_cannot_build_is_told(tmp_path):
    robot = small_robot(tmp_path, elbow="world")
    motion, scene = resting(robot)
    with pytest.raises(RobotError, match=r"MuJoCo cannot build 'small': .*; correct its URDF"):
        simulate(motion, scene, robot)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Perturbation(friction=float("nan")), "friction"),
        (lambda: Perturbation(mass=-1.0), "mass"),
        (lambda: Perturbation(gains=(1.0, 0.0)), "gains"),
        (lambda: Perturbation(start_error=(float("inf"), 0.0, 0.0)), "start_error"),
        (lambda: Push(0.5, 0.0, (1.0, 0.0, 0.0)), "push.duration"),
        (lambda: Push(0.5, 0.1, (1.0, float("nan"), 0.0)), "push.force"),
        (lambda: Friction(coefficient=-1.0), "coefficient"),
        (lambda: Friction(force=0.0), "force"),
        (lambda: Friction(size=(0.02, float("nan"))), "size"),
        (lambda: Settings(log_rate=1e9), "log_rate"),
        (lambda: Settings(log_rate=1e-3), "log_rate"),
        (lambda: Settings(settle=-1.0), "settle"),
    ],
)
def test_impossible_numbers_are_refused(make, key):
    with pytest.raises(OptionError, match=f"{key}: .*; give"):
        make()


def test_gains_of_another_robot_are_refused():
    robot, motion = standing(0.1)
    with pytest.raises(
        OptionError, match=r"gains: there are 3, and the robot 'baxter' has 14 joints; give one"
    ):
        simulate(motion, posts(), robot, perturbation=Perturbation(gains=(1.0, 1.0, 1.0)))


def test_what_is_measured_does_not_depend_on_how_often(tmp_path):
    """The weight that motors bear, and so what servos may use of them, is found anew in any case."""
    robot, motion = standing(1.0)
    position = motion.position + np.outer(0.5 * (1 - np.cos(np.pi * motion.time)), 0.8 * np.ones(14))
    raised = JointMotion(motion.time, motion.joint_names, position)
    often, seldom = (
        simulate(raised, posts(), robot, settings=Settings(log_rate=rate)) for rate in (100.0, 10.0)
    )
    assert np.array_equal(often.joints[::10], seldom.joints)


def test_a_push_from_the_first_step_to_the_last_pushes():
    robot, motion = standing(0.3)
    push = Perturbation(push=Push(0.0, 100.0, (0.0, 0.0, -20.0)))
    pushed = simulate(motion, posts(), robot, perturbation=push)
    assert pushed.load_pose[-1, 2, 3] < stood().load_pose[-1, 2, 3] - 1e-3


def test_pictures_of_another_simulation_do_not_stay(tmp_path):
    for name in ("simulation.png", "simulation.mp4", "simulation.gif", "motion.png"):
        (tmp_path / name).write_bytes(b"of the one before")
    write_simulation(stood(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"simulation.json", "simulation.npz", "motion.png"}


def broken_down(state):
    """An execution that ended at its first sample."""
    whole = stood()
    fields = [f.name for f in dataclasses.fields(whole) if isinstance(getattr(whole, f.name), np.ndarray)]
    cut = {name: getattr(whole, name)[:1].copy() for name in fields}
    if state is not None:
        for name in ("joints", "hands", "load_pose"):
            cut[name][...] = state
    return dataclasses.replace(whole, unstable=0.0, **cut)


@pytest.mark.parametrize("state", [pytest.param(None, marks=pytest.mark.slow), np.nan])
def test_what_broke_down_at_once_is_written_and_drawn_or_told(tmp_path, state):
    execution = broken_down(state)
    assert "broke down at 0.00 s" in execution.reasons[0]
    assert write_simulation(execution, tmp_path)["delivered"] is False
    for draw, name in ((draw_sheet, "sheet.png"), (draw_film, "film.mp4")):
        try:
            draw(execution, tmp_path / name, width=64)
        except ComoveError as error:
            assert "pictures cannot be drawn" in str(error)


@pytest.mark.slow
def test_the_film_of_no_time_has_a_picture(tmp_path, monkeypatch):
    from comove.sim import pictures

    monkeypatch.setattr(pictures, "encodes", lambda: False)
    try:
        path = draw_film(broken_down(None), tmp_path / "film.mp4", width=64)
    except OptionError:
        pytest.skip("pictures cannot be drawn here")
    assert path.name == "film.gif" and path.stat().st_size > 0
