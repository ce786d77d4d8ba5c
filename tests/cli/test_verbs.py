"""One verb for both: a scene or a result says whether a robot carries, and the former names of verbs do the same."""

import json
import re
from pathlib import Path

import pytest

from comove import solving
from comove.cli import run
from comove.cli.app import WITH_ROBOT
from comove.errors import RobotError
from comove.io.folders import LIST
from comove.stored import ResultPart, parts_of, verify_folder
from tests.commands import invoke
from tests.robots.known_carry import scene_data
from tests.robots.known_folder import write
from tests.robots.small_robots import gantry, gantry_scene
from tests.solved import solved

SCENE = Path(__file__).parents[2] / "examples" / "baxter" / "gap_30.yaml"
FORMER = ("solve", "run", "simulate", "export", "send")
CLOCKS = (
    "time_to_first_verified_s",
    "wall_time_s",
    "control_s_median",
    "control_s_p999",
    "planning_s",
    "steps_per_second",
)


@pytest.fixture
def asked(monkeypatch):
    """What is asked of the search and of a robot's run, neither of which is made."""
    calls = []

    def solve(scene, *, robot, **more):
        calls.append(robot.name if robot else None)
        raise RobotError("this is enough")

    monkeypatch.setattr(solving, "solve", solve)
    monkeypatch.setattr(run, "run_joints", lambda *args, **more: calls.append((args, more)) or 0)
    return calls


@pytest.fixture
def scenes(tmp_path):
    """A scene that names Baxter, and the same without a robot."""
    with_robot, without = tmp_path / "robot.yaml", tmp_path / "hands.yaml"
    data = scene_data()
    data["load"] |= {"mass": 0.25}  # else it is warned of
    with_robot.write_text(json.dumps(data))
    without.write_text(json.dumps({key: value for key, value in data.items() if key != "robot"}))
    return with_robot, without


@pytest.fixture
def small(tmp_path):
    """A scene of a robot with few joints, which is beside it."""
    gantry(tmp_path)
    data = gantry_scene().file.model_dump(mode="json", exclude_none=True) | {"robot": "robot.yaml"}
    (tmp_path / "small.yaml").write_text(json.dumps(data))
    return tmp_path / "small.yaml"


def contents(folder):
    """The contents of all files, by name, without times; pictures are drawn from the others."""
    found = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".png"):
        data = path.read_bytes()
        if path.suffix == ".json" and path.parent == folder and path.name != LIST:
            data = {key: value for key, value in json.loads(data).items() if key not in CLOCKS}
        found[path.relative_to(folder)] = data
    return found


def same_but_one_line(former, plain):
    """What the former verb printed: the same, and on standard error one line more that names the plain one."""
    assert former.exit_code == plain.exit_code
    line, *others = former.stderr.splitlines()
    assert re.fullmatch(r"warning: 'comove robot (\w+)' is now 'comove \1'; .*", line)
    assert [line.replace("/former/", "/plain/") for line in others] == plain.stderr.splitlines()


def test_the_scene_says_whether_joints_are_looked_for(asked, scenes, tmp_path):
    with_robot, without = scenes
    for scene, *more in (
        (with_robot,),
        (without, "--robot", "baxter"),
        (with_robot, "--hands-alone"),
        (without,),
    ):
        invoke("solve", scene, "--out", tmp_path / "out", *more)
    assert asked == ["baxter", "baxter", None, None]


def test_the_scene_says_whether_joints_are_run(asked, scenes, tmp_path):
    assert invoke("run", scenes[0], "--out", tmp_path / "out", "--seed", 3, "--rate", 100).exit_code == 0
    assert invoke("run", scenes[1], "--out", tmp_path / "out", "--robot", "baxter").exit_code == 0
    (first, second), how = asked, [arguments[4] for arguments, _ in asked]
    assert [arguments[3] for arguments, _ in asked] == [None, "baxter"]
    assert (first[1]["seed"], second[1]["seed"], how[0].rate, how[1].rate) == (3, 0, 100.0, 250.0)


@pytest.mark.parametrize(("option", "film"), [((), False), (("--film",), True), (("--no-film",), False)])
def test_a_film_of_a_robots_run_is_drawn_where_it_is_asked_for(option, film, asked, scenes, tmp_path):
    assert invoke("run", scenes[0], "--out", tmp_path / "out", *option).exit_code == 0
    ((arguments, _),) = asked
    assert arguments[4].film is film


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("solve", "--method", "projection"), "--method: the method 'projection' moves hands alone"),
        (("solve", "--no-planner"), "--no-planner: the joints of 'baxter' need a planned path"),
        (("solve", "--obstacles", "cost"), "--obstacles: obstacles are constraints"),
        (("solve", "--hands-alone", "--robot", "baxter"), "--hands-alone: a robot, and the hands alone"),
        (("run", "--compare"), "--compare: other methods move hands alone"),
        (("run", "--rate", "100", "--period", "0.01"), "--rate: a rate, and a period; give one of the two"),
    ],
)
def test_what_joints_cannot_do_is_refused_and_nothing_is_written(options, told, asked, scenes, tmp_path):
    verb, *more = options
    done = invoke(verb, scenes[0], "--out", tmp_path / "out", *more)
    assert done.exit_code == 2 and told in done.stderr
    assert not asked and not (tmp_path / "out").exists()


def options_with_a_robot(verb):
    """The options that the help of a verb lists apart, each as its first name."""
    _, _, part = invoke(verb, "--help").output.partition(f"{WITH_ROBOT}:\n")
    return re.findall(r"^  (--[\w-]+)", part, re.MULTILINE)


@pytest.mark.parametrize("verb", ["solve", "run"])
def test_options_that_apply_only_with_a_robot_are_listed_apart_and_refused_without_one(
    verb, asked, scenes, tmp_path
):
    options = options_with_a_robot(verb)
    assert set(options) == {
        "solve": {"--present", "--transfers", "--approach", "--release"},
        "run": {
            *("--grasp", "--perturbed", "--pictures", "--ros", "--plan", "--commands", "--joint-states"),
            *("--obstacles", "--frame", "--noise"),
        },
    }[verb]  # fmt: skip
    values = {
        "--present": "joints.yaml",
        "--grasp": "weld",
        "--perturbed": "1",
        "--ros": "2",
        "--noise": "0.1",
    }
    values |= {name: "/name" for name in ("--plan", "--commands", "--joint-states", "--obstacles", "--frame")}
    for option in options:
        given = [option, values[option]] if option in values else [option]
        for scene, *more in ((scenes[1],), (scenes[0], "--hands-alone")):
            done = invoke(verb, scene, "--out", tmp_path / "out", *more, *given)
            assert done.exit_code == 2 and done.stderr.count("\n") == 1
            assert done.stderr.startswith(f"error: {option}: no robot")
    assert not asked and not (tmp_path / "out").exists()


def test_a_result_without_joints_is_neither_simulated_nor_exported_nor_sent(tmp_path):
    """And the advice leads to one that is."""
    from comove.io.folders import whole_folder
    from comove.results import RESULT
    from comove.view.figures import save_result

    with whole_folder(tmp_path / "hands", RESULT) as draft:
        save_result(solved("wide"), draft, wall_time_s=1.0)
    for verb in ("simulate", "export", "send"):
        done = invoke(verb, tmp_path / "hands")
        assert done.exit_code == 2 and done.stderr.count("\n") == 1
        assert "no robot's joints move in it; solve its scene with a robot: comove solve" in done.stderr
    write(tmp_path / "joints")
    assert invoke("export", tmp_path / "joints", "--format", "npz", "--no-transfers").exit_code == 0


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


def test_the_help_names_no_former_verb():
    listed = invoke("robot", "--help").output.partition("Commands:\n")[2]
    assert set(re.findall(r"^  (\w+)", listed, re.MULTILINE)) == {"convert", "new", "check", "scene"}
    assert set(FORMER) <= set(re.findall(r"^  (\w+)", invoke("--help").output, re.MULTILINE))
    for verb in FORMER:
        plain, former = (invoke(*words, verb, "--help").output for words in ((), ("robot",)))
        assert former.partition("\n")[2] == plain.partition("\n")[2]


def test_a_former_verb_makes_the_same_result(small, tmp_path):
    plain = invoke("solve", small, "--out", tmp_path / "plain", "--seed", 1)
    former = invoke("robot", "solve", small, "--out", tmp_path / "former", "--seed", 1)
    assert plain.exit_code == 0, plain.stderr
    same_but_one_line(former, plain)
    one, other = contents(tmp_path / "plain"), contents(tmp_path / "former")
    assert one == other and len(one) > 5
    assert b'"solve"' in one[Path(LIST)] and b'"robot",' not in one[Path(LIST)]
    plain = invoke("export", tmp_path / "plain", "--format", "csv", "--no-transfers")
    former = invoke("robot", "export", tmp_path / "former", "--format", "csv", "--no-transfers")
    same_but_one_line(former, plain)
    assert contents(tmp_path / "plain") == contents(tmp_path / "former")


@pytest.mark.slow
def test_former_verbs_of_the_simulator_make_the_same_results(small, tmp_path):
    for words, folder, perturbed in (((), "plain", "--perturbed"), (("robot",), "former", "--seed")):
        assert invoke("solve", small, "--out", tmp_path / folder).exit_code == 0
        done = invoke(*words, "simulate", tmp_path / folder, perturbed, 2, "--no-pictures")
        assert done.exit_code in (0, 1), done.stderr
        done = invoke(*words, "run", small, "--out", tmp_path / f"{folder} run", "--no-pictures")
        assert done.exit_code in (0, 1), done.stderr
    for name in ("", " run"):
        assert contents(tmp_path / f"plain{name}") == contents(tmp_path / f"former{name}")


def test_a_former_verb_still_needs_a_robot(scenes, tmp_path):
    for verb in ("solve", "run"):
        done = invoke("robot", verb, scenes[1], "--out", tmp_path / "out")
        assert done.exit_code == 2 and "neither the scene nor the command names a robot" in done.stderr
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_solve_is_that_of_the_robot(tmp_path):
    done = invoke("solve", SCENE, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    assert parts_of(tmp_path / "out") == (ResultPart.MOTION, ResultPart.JOINTS)
    assert "hands_alone" not in json.loads((tmp_path / "out" / "solution.json").read_text())
    done = invoke("verify", SCENE, tmp_path / "out")
    assert done.exit_code == 0 and "links from obstacles" in done.stdout


@pytest.mark.slow
def test_run_is_that_of_the_robot(tmp_path):
    done = invoke("run", SCENE, "--out", tmp_path / "out", "--period", 0.004)
    assert done.exit_code == 0, done.stderr
    assert parts_of(tmp_path / "out") == (ResultPart.ROBOT_RUN,)
    assert (tmp_path / "out/scene.json").is_file()
    assert (tmp_path / "out/robot_run.png").is_file() or "no pictures" in done.stderr
    done = invoke("verify", SCENE, tmp_path / "out")
    assert done.exit_code == 0 and "at samples" in done.stdout.splitlines()[0]
