"""A scene that names a robot is solved and run with its joints; the hands alone only where that is asked for."""

import json
from pathlib import Path

import comove.cli.joints as joints
import pytest

from comove.errors import ComoveWarning
from comove.planning import Budget, solve
from comove.scenes import Scene
from comove.stored import Part, parts_of, verify_folder
from tests.commands import invoke
from tests.robots.known_carry import scene_data

SCENE = Path(__file__).parents[2] / "examples" / "baxter" / "gap_30.yaml"


@pytest.fixture
def asked(monkeypatch):
    """What is asked of a robot's joints, which are not looked for."""
    calls = []
    for name in ("solve_joints", "run_joints"):
        monkeypatch.setattr(
            joints, name, lambda *args, _name=name, **more: calls.append((_name, args, more)) or 0
        )
    return calls


@pytest.fixture
def scenes(tmp_path):
    """A scene that names Baxter, and the same without a robot."""
    with_robot, without = tmp_path / "robot.yaml", tmp_path / "hands.yaml"
    with_robot.write_text(json.dumps(scene_data()))
    without.write_text(json.dumps({key: value for key, value in scene_data().items() if key != "robot"}))
    return with_robot, without


@pytest.mark.parametrize("verb", ["solve", "run"])
def test_the_scene_says_whether_joints_are_looked_at(verb, asked, scenes, tmp_path):
    scene, without = scenes
    assert invoke(verb, scene, "--out", tmp_path / "out", "--seed", 3).exit_code == 0
    assert invoke(verb, without, "--out", tmp_path / "out", "--robot", "baxter").exit_code == 0
    assert [name for name, *_ in asked] == [f"{verb}_joints"] * 2
    assert [(arguments[3], more["seed"]) for _, arguments, more in asked] == [(None, 3), ("baxter", 0)]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("solve", "--method", "projection"), "--method: the method 'projection' moves hands alone"),
        (("solve", "--no-planner"), "--no-planner: the joints of 'baxter' need a planned path"),
        (("solve", "--obstacles", "cost"), "--obstacles: obstacles are constraints"),
        (("solve", "--hands-alone", "--robot", "baxter"), "--hands-alone: a robot, and the hands alone"),
        (("run", "--compare"), "--compare: other methods move hands alone"),
        (("run", "--hands-alone", "--grasp", "weld"), "--grasp: no robot carries the load"),
    ],
)
def test_what_joints_cannot_do_is_refused_and_nothing_is_written(options, told, asked, scenes, tmp_path):
    verb, *more = options
    done = invoke(verb, scenes[0], "--out", tmp_path / "out", *more)
    assert done.exit_code == 2 and told in done.stderr
    assert not asked and not (tmp_path / "out").exists()


def test_the_advice_to_look_at_the_hands_alone_works_and_its_verdict_says_so(scenes, tmp_path):
    folder = tmp_path / "out"
    done = invoke("solve", scenes[0], "--out", folder, "--hands-alone")
    assert done.exit_code == 0, done.stderr
    assert "verified, the hands alone" in done.stdout
    assert json.loads((folder / "solution.json").read_text())["hands_alone"] is True
    for arguments in (("verify", scenes[0], folder), ("verify", folder), ("show", folder)):
        again = invoke(*arguments)
        assert again.exit_code == 0 and "the hands alone" in again.stdout.splitlines()[0]
    (part,) = verify_folder(folder)
    assert part.verified and part.is_hands_alone


def test_solve_of_a_scene_with_a_robot_says_in_python_that_it_looks_at_the_hands_alone():
    scene = Scene.from_dict(scene_data())
    with pytest.warns(ComoveWarning, match="solve looks at the hands alone"):
        solve(scene, seed=0, budget=Budget(work=2.0))


@pytest.mark.slow
def test_solve_is_that_of_the_robot(tmp_path):
    done = invoke("solve", SCENE, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    assert parts_of(tmp_path / "out") == (Part.MOTION, Part.JOINTS)
    assert "hands_alone" not in json.loads((tmp_path / "out" / "solution.json").read_text())
    done = invoke("verify", SCENE, tmp_path / "out")
    assert done.exit_code == 0 and "links from obstacles" in done.stdout


@pytest.mark.slow
def test_run_is_that_of_the_robot(tmp_path):
    done = invoke("run", SCENE, "--out", tmp_path / "out", "--period", 0.004)
    assert done.exit_code == 0, done.stderr
    assert parts_of(tmp_path / "out") == (Part.ROBOT_RUN,)
    assert (tmp_path / "out/scene.json").is_file()
    assert (tmp_path / "out/robot_run.png").is_file() or "no pictures" in done.stderr
    done = invoke("verify", SCENE, tmp_path / "out")
    assert done.exit_code == 0 and "at samples" in done.stdout.splitlines()[0]


@pytest.mark.parametrize(("option", "film"), [((), False), (("--film",), True), (("--no-film",), False)])
def test_a_film_of_a_robots_run_is_drawn_where_it_is_asked_for(option, film, asked, scenes, tmp_path):
    assert invoke("run", scenes[0], "--out", tmp_path / "out", *option).exit_code == 0
    ((_, arguments, _),) = asked
    assert arguments[4].film is film
