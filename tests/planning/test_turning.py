"""Example scenes with obstacles that turn are solved, and by the file alone nothing is touched."""

from pathlib import Path

import pytest

from comove import solve
from comove.model import Scene
from comove.planning.methods import Quick
from tests.brute_force import least_clearance

EXAMPLES = Path(__file__).parents[2] / "examples" / "moving"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["revolving_door", "turning_beam"])
def test_the_examples_are_solved(name):
    scene = Scene.load(EXAMPLES / f"{name}.yaml")
    solution = solve(scene, method=Quick(), progress=False)
    assert solution.reasons == () and solution.motion is not None
    clearance, _ = least_clearance(solution.motion.motion)
    assert scene.clearance <= solution.report.clearance_min <= clearance + 1e-9
