"""Commands load what they need: a fresh process runs one and lists its modules.

The verifier loads what judges alone. What takes long to load, and what numba needs to compile, nobody waits for who
has no use for it.
"""

import json
import os
import subprocess
import sys

import pytest

from comove.control import Executor, Pace, write_run
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.sim import play, write_simulation
from comove.verification.record import verify_execution
from comove.view.figures import save_result
from tests.robots.known_carry import baxter, known_carry
from tests.robots.known_folder import write
from tests.robots.known_run import write_known_run
from tests.solved import EXAMPLES, example, solved

MAKERS = (
    *("planning", "optim", "dmp.demonstrations", "lab", "data", "view", "ros"),
    *("control", "processes", "robots.search", "robots.online", "robots.proposal"),
    *(f"sim.{name}" for name in ("dynamics", "playback", "building", "pictures", "meshes", "world")),
)
MOST = 94
PROBE = """
import json, sys
sys.argv[0] = "comove"
from comove.cli import main
try:
    main()
except SystemExit as leaving:
    code = leaving.code
print(json.dumps([code, list(sys.modules)]), file=sys.stderr)
"""


def loaded(*arguments):
    """The modules that a command has loaded in a process of its own, which succeeds."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE, *map(str, arguments)], capture_output=True, text=True, env=os.environ
    )
    code, names = json.loads(done.stderr.splitlines()[-1])
    assert code == 0, done.stderr
    return names


def hands(folder):
    with whole_folder(folder, RESULT) as draft:
        save_result(solved("wide"), draft, wall_time_s=1.0)
    return EXAMPLES / "wide.yaml", folder


def joints(folder):
    write(folder)
    scene = folder.parent / "known.yaml"
    scene.write_text(json.dumps(known_carry()[0].scene.file.model_dump(mode="json", exclude_none=True)))
    return scene, folder


def run(folder):
    with whole_folder(folder, RESULT) as draft:
        executor = Executor(example("wide"), seed=0, pace=Pace(period=0.02))
        record = executor.run(30.0)
        report = verify_execution(record)
        write_run(draft, record, report, executor.log, seed=0, interrupted=False, wall_time_s=1.0)
    return EXAMPLES / "wide.yaml", folder


def simulation(folder):
    scene, _ = joints(folder)
    motion, played = known_carry()
    write_simulation(play(played, baxter(), motion.scene), folder)
    return scene, folder


def robot_run(folder):
    return (write_known_run(folder),)


@pytest.mark.parametrize("made", [hands, run, joints, simulation, robot_run])
def test_the_verifier_loads_no_maker_of_motions(made, tmp_path):
    named = loaded("verify", *made(tmp_path / "result"))
    rooms = {name.removeprefix("comove.") for name in named if name.startswith("comove.")}
    assert not {name for name in rooms if name.startswith(MAKERS)}
    assert len(rooms) <= MOST
    knows = {name.partition(".")[0] for name in rooms} & {"robots", "sim"}
    expected = {joints: {"robots"}, simulation: {"robots", "sim"}, robot_run: {"robots", "sim"}}
    assert knows == expected.get(made, set())


SLOW = ("scipy.linalg", "scipy.spatial", "matplotlib", "pinocchio", "PIL", "rich")
COMPILING = ("numba.np.arrayobj", "numba.np.linalg", "numba.cpython.unicode", "numba.typed.typeddict", "cffi")


def test_a_search_loads_neither_what_draws_nor_what_compiles(tmp_path):
    """With everything compiled before; of formats it loads that of the demonstration alone."""
    command = "solve", EXAMPLES / "narrow.yaml", "--out", tmp_path / "out", "--no-pictures"
    loaded(*command)  # compiles where something is missing
    names = loaded(*command)
    assert not {name for name in names if name.startswith((*SLOW, *COMPILING))}
    rooms = ("control", "optim", "lab", "sim", "robots", "ros", "data", "dmp.demonstrations.formats.rosbag")
    assert not {name for name in names if name.startswith(tuple(f"comove.{room}" for room in rooms))}
    for verb in ("show", "verify"):
        names = loaded(verb, tmp_path / "out")
        assert not {name for name in names if name.startswith((*SLOW, *COMPILING, "comove.planning"))}


@pytest.mark.parametrize("words", [["--help"], ["solve", "--help"], ["--version"]])
def test_help_loads_no_numbers(words):
    assert not {"numpy", "numba", "comove.model"} & {*loaded(*words)}


def test_recordings_are_named_in_a_process_that_has_read_none(tmp_path):
    """Formats are loaded on first use, which names such as lasa:SHAPE:all come before."""
    loaded("learn", "lasa:Sine:all", "--out", tmp_path / "sine.json")
