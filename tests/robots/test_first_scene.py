"""First scenes for robots: both hands reach them, and the verification accepts what was found."""

import re
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pinocchio")

from comove.errors import ComoveWarning, RobotError
from comove.model import Scene
from comove.robots import Robot, RobotCarrier, bundled_robots, plan_transfers
from comove.robots.ends import EndJoints
from comove.robots.kernels import TWO_ARMS
from comove.robots.proposal import first_scene, propose_scene
from comove.robots.proposal.first_scene import SETTINGS, _Place, largest_rectangle
from comove.robots.proposal.homes import floor_of
from tests.commands import invoke

N_CELLS, FEWEST, MOST = 11, 3, 5


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 1.0))
def test_the_largest_rectangle_is_free_and_none_is_larger(seed, share):
    """By looking at all of them."""
    rng = np.random.default_rng(seed)
    free = rng.uniform(size=(N_CELLS, N_CELLS)) < share
    spans = [(a, b) for a in range(N_CELLS) for b in range(a + FEWEST, min(a + MOST, N_CELLS) + 1)]
    sizes = [(d - c) * (b - a) for (a, b), (c, d) in product(spans, spans) if free[a:b, c:d].all()]
    found = largest_rectangle(free, FEWEST, MOST)
    if found is None:
        assert not sizes
        return
    (a, c), (b, d) = found
    assert free[a : b + 1, c : d + 1].all()
    assert (b - a + 1) * (d - c + 1) == max(sizes)


def test_of_rectangles_as_large_the_one_about_home_is_taken():
    (a, c), (b, d) = largest_rectangle(np.ones((N_CELLS, N_CELLS), dtype=bool), FEWEST, MOST)
    assert (a + b, c + d) == (N_CELLS - 1, N_CELLS - 1)


@pytest.fixture(scope="module")
def proposal():
    """A first scene for two arms."""
    return propose_scene(Robot.load(TWO_ARMS), str(TWO_ARMS))


def test_a_first_scene_is_solved_and_its_rail_is_in_the_way(proposal):
    robot = proposal.found.joints.robot
    scene = Scene.from_dict(proposal.data)
    written = yaml.safe_load(proposal.text())
    assert written["version"] == 2
    for end in ("start", "goal"):
        again = Scene.from_dict(written).nodes_at(end)[: scene.body.n_nodes]
        assert again == pytest.approx(scene.nodes_at(end), abs=1e-12)
    assert proposal.found.verified
    RobotCarrier(robot, scene).require_reach()
    rail = scene.file.obstacles[0]
    top = rail.center[2] + 0.5 * rail.size[2]
    ends = scene.nodes_at("start"), scene.nodes_at("goal")
    assert top > ends[0][0, 2] - scene.file.load.radius, "the bar has to be lifted"
    bar = 0.5 * (ends[0] + ends[1])[:2]
    nearest = np.clip(rail.center, bar.min(axis=0), bar.max(axis=0))
    assert np.abs(nearest - rail.center)[:2] == pytest.approx([0, 0]), "the straight way leads through it"
    assert scene.lower[2] >= floor_of(robot) - 1e-3


@given(st.floats(0.3, 3.0), st.floats(0.04, 0.5))
def test_there_is_room_beside_the_rail_however_short_the_way_is(reach, way):
    """And the scene can be written."""
    arms = [SimpleNamespace(name=name, payload=np.inf, hand=0.0) for name in ("left", "right")]
    cell = 0.02
    upper = np.array([way + cell, 0.0, 0.1])
    place = _Place(tuple(arms), 1, 0.4, {}, np.zeros(3), upper, reach, -1.0, cell, 0.2)
    data = yaml.safe_load(yaml.safe_dump(place.data("robot", 0.5, 3.0)))
    (rail,), load = data["obstacles"], data["load"]
    for end in ("start", "goal"):
        apart = (
            abs(data["manipulators"][0][end][0] - rail["center"][0]) - 0.5 * rail["size"][0] - load["radius"]
        )
        assert apart > data["limits"]["clearance"] + 1e-3
    assert load["radius"] > 0.0


def test_a_first_scene_can_be_approached_from_home_and_left_for_it(proposal):
    assert proposal.unreached == ""
    transfers = plan_transfers(proposal.found.joints.motion)
    home = proposal.found.joints.robot.home
    np.testing.assert_array_equal(
        [transfers.approach.position[0], transfers.release.position[-1]], [home, home]
    )


@pytest.mark.slow
def test_what_keeps_hands_from_approaching_is_told(monkeypatch):
    """Other scenes are tried first; then one is proposed without."""
    tried = []

    def refuse(motion, **_):
        tried.append(motion)
        raise RobotError("at home, an arm and the load come too near to each other", key="home")

    monkeypatch.setattr(first_scene, "plan_transfers", refuse)
    proposal = propose_scene(Robot.load(TWO_ARMS), str(TWO_ARMS))
    assert proposal.found.verified
    assert "at home, an arm and the load" in proposal.unreached
    assert len(tried) == SETTINGS.n_carried


@pytest.mark.slow
@pytest.mark.parametrize("name", bundled_robots())
def test_every_robot_that_comes_with_comove_has_a_first_scene(name):
    assert propose_scene(Robot.load(name), name).found.verified


@pytest.mark.slow
def test_the_same_scene_is_proposed_each_time(proposal):
    assert propose_scene(Robot.load(TWO_ARMS), str(TWO_ARMS)).data == proposal.data


@pytest.mark.slow
def test_a_robot_without_any_collision_body_has_one(tmp_path):
    """Nothing is compared then but the load and what stands; that is told when it is loaded."""
    for source in TWO_ARMS.parent.iterdir():
        text = re.sub("<collision>.*?</collision>", "", source.read_text(encoding="utf-8"), flags=re.DOTALL)
        (tmp_path / source.name).write_text(text, encoding="utf-8")
    with pytest.warns(ComoveWarning, match="no link of the arm"):
        robot = Robot.load(tmp_path / TWO_ARMS.name)
    assert propose_scene(robot, "robot.yaml").found.verified


def test_one_arm_carries_nothing():
    robot = Robot.load("two_pandas")
    with pytest.raises(RobotError, match="one arm"):
        propose_scene(replace(robot, arms=robot.arms[:1]), "robot.yaml")


def test_hands_that_are_out_of_reach_of_a_bar_are_told(monkeypatch):
    monkeypatch.setattr(EndJoints, "reaches", lambda *_: False)
    with pytest.raises(RobotError, match="no place was found about home"):
        propose_scene(Robot.load(TWO_ARMS), "robot.yaml")


@pytest.mark.slow
def test_obstacles_around_the_robot_are_in_the_scene_and_their_files_are_found(tmp_path):
    """A crate beside the arms, as a mesh whose file is beside the list of obstacles, not beside the scene."""
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "crate.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n", encoding="utf-8"
    )
    entry = {"name": "crate", "shape": "mesh", "file": "crate.obj", "center": [3.0, 0.0, 0.0]}
    around = tmp_path / "made" / "around.yaml"
    around.write_text(yaml.safe_dump({"obstacles": [entry]}), encoding="utf-8")
    scene = tmp_path / "scene.yaml"
    result = invoke("robot", "scene", TWO_ARMS, "--out", scene, "--obstacles", around)
    assert result.exit_code == 0, result.output
    assert [obstacle.name for obstacle in Scene.load(scene).file.obstacles] == [None, "crate"]


def test_a_list_of_obstacles_that_is_none_is_refused(tmp_path):
    around = tmp_path / "around.yaml"
    around.write_text("tables: []", encoding="utf-8")
    result = invoke("robot", "scene", TWO_ARMS, "--out", tmp_path / "other.yaml", "--obstacles", around)
    assert result.exit_code == 2
    assert not (tmp_path / "other.yaml").exists()
