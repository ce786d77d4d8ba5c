"""The constraint that docs/extending.md makes works from the scene file to the certificate and the execution."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "extending.md"
MOST_LINES = 60

SCENE = """
def scene(height=0.1, above="third", **more):
    return Scene.from_dict({
        "name": "above", "duration": 4.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "load": {"shape": "bar", "length": 0.2, "held_by": ["left", "right"]},
        "manipulators": [
            {"name": "left", "start": [0.2, 0.5], "goal": [0.6, 0.5]},
            {"name": "right", "start": [0.4, 0.5], "goal": [0.8, 0.5]},
            {"name": "third", "start": [0.1, 0.1], "goal": [0.9, 0.1]},
        ],
        "obstacles": [{"shape": "circle", "center": [0.5, 0.6], "radius": 0.14}],
        "constraints": [
            {"type": "height_above", "between": ["left", "right"], "above": above, "height": height, **more}
        ],
    })
"""


def example():
    """The example's file, and its line of registration."""
    page = PAGE.read_text(encoding="utf-8").split("## A new constraint")[1]
    return (re.search(rf"^```{kind}\n(.*?)^```", page, re.M | re.S)[1] for kind in ("python", "text"))


def run(code):
    """Run code in a process of its own, in which the example is one of the kinds."""
    file, line = example()
    register = f"import comove.model.constraints as room\nroom.KINDS |= {{{line.strip()}}}\n"
    names = "import numpy as np\nimport comove\nfrom comove.model import Scene\n"
    program = f"{file}\n{register}{names}{SCENE}{code}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_it_is_a_short_file_and_one_line():
    file, line = example()
    assert len(file.splitlines()) < MOST_LINES
    assert len(line.splitlines()) == 1


def test_scenes_know_its_keys_and_say_what_is_wrong():
    out = run(
        """
from comove.errors import SceneError
print(scene().constraints[0])
for wrong in ({"above": "thrid"}, {"height": -1.0}, {"hieght": 0.1}, {"height": 0.5}):
    try:
        scene(**wrong)
    except SceneError as error:
        print(error)
print(scene().scaled(3.0).constraints[0].height)
"""
    )
    made, unknown, negative, misspelt, low, large = out.strip().splitlines()
    assert made.startswith("HeightAboveConstraint(upper=(0, 1), lower=2, height=0.1, tolerance=0.001")
    assert "constraints[0].above: there is no manipulator 'thrid'; did you mean 'third'" in unknown
    assert "constraints[0].height: -1.0 is out of range" in negative
    assert "did you mean 'height'" in misspelt
    assert "constraints[0]: at the start 'left' and 'right' come down to 0.4 m above 'third'" in low
    assert float(large) == pytest.approx(0.3)


@pytest.mark.slow
def test_it_is_searched_certified_and_bounded():
    """Without it the bar dives below the circle; the bound lies above dense samples and by next to nothing."""
    out = run(
        """
from dataclasses import replace
from comove.verification import verify
asked = scene(0.355)
free = comove.solve(replace(asked, constraints=asked.constraints[1:]), seed=0, budget=60.0)
judged = verify(replace(free.attempt, scene=asked))
held = comove.solve(asked, seed=0, budget=60.0)
dense = held.attempt.hands(np.linspace(0.0, 1.0, 20001))[0]
met = 0.355 - 0.001 - (dense[:, :2, 1].min(axis=1) - dense[:, 2, 1]).min()
print(free.verified, judged.verified is None, judged.reasons)
print(held.verified, held.report.constraint_excess_max, met, type(held.objective).__name__)
"""
    )
    free, held = out.strip().splitlines()
    assert free.startswith("True True")
    assert "come down to" in free
    verified, excess, met, objective = held.split()
    assert (verified, objective) == ("True", "LeastJerk")
    assert float(met) <= float(excess) <= 0.0
    assert float(excess) <= float(met) + 1e-3


@pytest.mark.slow
def test_an_execution_keeps_it():
    """The third hand climbs over a circle: the bar, which could stay where it is, makes way for it."""
    out = run(
        """
from comove.control import Executor
from comove.verification.record import verify_execution
data = scene().file.model_dump(mode="json")
data["manipulators"][2] |= {"start": [0.1, 0.3], "goal": [0.9, 0.3]}
data["obstacles"] = [{"shape": "circle", "center": [0.5, 0.26], "radius": 0.1}]
for height in (0.05, 0.16):
    data["constraints"][0]["height"] = height
    record = Executor(Scene.from_dict(data)).run(8.0)
    apart = record.position[:, :2, 1].min(axis=1) - record.position[:, 2, 1]
    report = verify_execution(record)
    print(apart.min(), report.constraint_excess_max, report.reasons)
"""
    )
    free, held = (line.split(maxsplit=2) for line in out.strip().splitlines())
    assert float(free[0]) < 0.15
    assert float(held[0]) >= 0.16 - 0.001
    assert float(held[1]) <= 0.0
    assert held[2] == "()"
