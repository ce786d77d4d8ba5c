"""What stands around a robot: homes keep clear of it, and one inside of it is a fault, in shells as in solids."""

import numpy as np
import pytest
import yaml

from comove.robots import Robot
from comove.robots.proposal import examine, homes, propose, scene_of
from comove.robots.proposal import proposal as proposals
from comove.robots.proposal.homes import HomeSettings
from comove.robots.proposal.proposal import ProposalSettings
from tests.commands import invoke
from tests.robots.test_proposal import arm, link, urdf, written


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(proposals, "SETTINGS", ProposalSettings(n_samples=20))
    monkeypatch.setattr(homes, "SETTINGS", HomeSettings(n_drawn=400, n_tried=40))


def proposed(tmp_path, around=None):
    sides = {"left_": (0, 0.3, 0.1), "right_": (0, -0.3, 0.1)}
    arms = "".join(arm(side, "base", at, gripper=(0, 0, 1)) for side, at in sides.items())
    made = written(tmp_path, urdf(link("base"), arms))
    return propose([made], tmp_path / "robot.yaml", around=around).robot


def about(places, size=0.15):
    """Boxes about places."""
    return [
        {"shape": "box", "name": f"shelf_{k}", "center": place.tolist(), "size": [size] * 3}
        for k, place in enumerate(places)
    ]


def test_a_home_inside_furniture_is_a_fault_and_a_proposed_home_is_elsewhere(tmp_path):
    robot = proposed(tmp_path)
    hands = [robot.tool_pose(robot.home, each)[:3, 3] for each in robot.arms]
    around = scene_of(about(hands))
    assert examine(robot).sound
    found = examine(robot, around=around)
    assert any("'left_finger_a' and 'shelf_0" in fault and "move 'shelf_0" in fault for fault in found.faults)
    moved = proposed(tmp_path, around)
    assert examine(moved, around=around).sound
    assert all(
        np.abs(moved.tool_pose(moved.home, each)[:3, 3] - hand).max() > 0.075
        for each, hand in zip(moved.arms, hands, strict=True)
    )


def test_a_home_in_the_middle_of_a_hollow_mesh_touches_none_of_its_triangles_and_is_a_fault(tmp_path):
    robot = proposed(tmp_path)
    place = robot.tool_pose(robot.home, robot.arms[0])[:3, 3]
    corners = "".join(f"v {x} {y} {z}\n" for x in (-3, 3) for y in (-3, 3) for z in (-3, 3))
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    (tmp_path / "crate.obj").write_text(corners + "".join(f"f {face}\n" for face in faces), encoding="utf-8")
    crate = {"shape": "mesh", "name": "crate", "file": "crate.obj", "center": place.tolist()}
    found = examine(robot, around=scene_of([crate], tmp_path))
    assert any("is inside crate" in fault for fault in found.faults)


def test_where_no_hand_points_down_in_the_clear_a_home_is_found_however_it_is_turned(tmp_path, monkeypatch):
    """Whatever settles with its hand down does so where something stands."""
    made, out = written(tmp_path, urdf(link("base"), arm("", "base"))), tmp_path / "robot.yaml"
    first = propose([made], out).robot
    around = scene_of(about([first.tool_pose(first.home, first.arms[0])[:3, 3]], 0.12))
    monkeypatch.setattr(homes, "_settled", lambda *_: (first.home, 1.0))
    moved = propose([made], out, around=around).robot
    assert not any("at home" in fault for fault in examine(moved, around=around).faults)


@pytest.mark.slow
def test_commands_take_obstacles_and_keep_the_pairs_of_two_models_of_one_name_apart(tmp_path):
    """`new` among obstacles, `check` among them and on a scene that is too heavy."""
    for side, where in (("one", 0.1), ("two", 0.2)):
        (tmp_path / side).mkdir()
        text = urdf(link("base"), arm("", "base", (0, 0, where))).replace(
            link("link2"), link("link2", (1.0, 1.0, 1.0))
        )
        (tmp_path / side / "robot.urdf").write_text(text, encoding="utf-8")
    around, out = tmp_path / "around.yaml", tmp_path / "both.yaml"
    around.write_text(yaml.safe_dump({"obstacles": about(np.array([[0.0, 0.0, 1.0]]))}), encoding="utf-8")
    urdfs = [tmp_path / side / "robot.urdf" for side in ("one", "two")]
    made = invoke("robot", "new", *urdfs, "--out", out, "--obstacles", around)
    assert made.exit_code in (0, 1), made.output
    data = yaml.safe_load(out.read_text())
    assert len({model["srdf"] for model in data["models"]}) == 2
    assert all((tmp_path / model["srdf"]).is_file() for model in data["models"])
    hands = [Robot.load(out).tool_pose(Robot.load(out).home, each)[:3, 3] for each in Robot.load(out).arms]
    around.write_text(yaml.safe_dump({"obstacles": about(hands)}), encoding="utf-8")
    checked = invoke("robot", "check", out, "--scene", around)
    assert checked.exit_code == 1
    assert "move 'shelf_0" in checked.output
