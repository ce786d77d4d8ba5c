"""Objects that hold arrays are told in one short line."""

import numpy as np

import comove
from comove.brief import brief
from comove.dmp import PoseDMP
from tests.solved import solved


def test_results_and_what_they_hold_are_one_short_line():
    solution = solved("narrow")
    dmp = comove.DMP.fit(comove.Demonstration(np.linspace(0, 1, 99), np.linspace([0, 0], [1, 2], 99)))
    things = [
        solution,
        solution.motion,
        solution.attempt,
        solution.trajectory,
        solution.scene,
        dmp,
        dmp.rollout(),
    ]
    for thing in things:
        text = repr(thing)
        assert text.startswith(f"{type(thing).__name__}("), "says what it is"
        assert len(text) < 500 and "\n" not in text
    assert "<array (" in repr(dmp)
    assert PoseDMP.__repr__ is brief
