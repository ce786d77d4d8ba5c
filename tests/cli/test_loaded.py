"""What the verifier loads: a fresh process runs `comove verify`, and says which modules of comove it has."""

import json
import os
import subprocess
import sys

import pytest

from comove.execution import Executor, Pace, write_run
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.verification.record import verify_execution
from comove.views import save_result
from tests.robots.known_carry import known_carry
from tests.robots.known_folder import write
from tests.solved import EXAMPLES, example, solved

MAKERS = (
    "planning",
    "optimisers",
    "robots.search",
    "robots.online",
    "demonstrations",
    "experiments",
    "studies",
)
MAKERS += ("workbench", "views", "export", "execution", "reaction")
PROBE = """
import json, sys
sys.argv[0] = "comove"
from comove.cli import main
try:
    main()
except SystemExit as leaving:
    code = leaving.code
names = [name for name in sys.modules if name == "comove" or name.startswith("comove.")]
print(json.dumps([code, names]), file=sys.stderr)
"""


def loaded(*arguments):
    """The modules of comove that a command has loaded in a process of its own, which accepts what it verifies."""
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


@pytest.mark.parametrize("made", [hands, run, joints])
def test_the_verifier_loads_no_maker_of_motions(made, tmp_path):
    """Nor more than 90 modules, beside those that know robots where one is verified."""
    names = loaded("verify", *made(tmp_path / "result"))
    rooms = {name.removeprefix("comove.") for name in names}
    assert not {name for name in rooms if name.startswith(MAKERS)}
    robots = {name for name in rooms if name.startswith("robots")}
    assert len(rooms - robots) <= 90 and (made is joints or not robots)
