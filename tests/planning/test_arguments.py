"""Names of the command line in place of objects: the message names the object, and giving it works."""

from importlib import import_module

import numpy as np
import pytest

from comove import solve
from comove.data import sweep
from comove.dmp.demonstrations import Demonstration
from comove.errors import InputError, OptionError
from comove.methods import METHODS, OF_ROBOTS, OWN
from comove.planning import arguments
from comove.planning.method import Method
from tests.solved import example

OBJECTIVES = ("least-jerk", "least-time", "paper")


def imported(text):
    """Return the class that a message says to import."""
    module, kind = text.split("from ")[1].split(" import ")
    return getattr(import_module(module), kind.strip())


@pytest.mark.parametrize("name", METHODS)
def test_a_method_given_by_name(name):
    scene = example("wide")
    with pytest.raises(OptionError) as caught:
        solve(scene, method=name)
    kind = imported(caught.value.way_out)
    assert (
        issubclass(kind, Method) and kind.name == name and f"give {kind.__name__}()" in caught.value.way_out
    )
    with pytest.raises(OptionError, match=rf"{kind.__name__}\(\)"):
        solve(scene, method=kind)


@pytest.mark.parametrize("name", OBJECTIVES)
@pytest.mark.parametrize("spelt", [str, str.upper, lambda name: name.replace("-", "_")])
def test_an_objective_given_by_name(name, spelt):
    scene = example("wide")
    with pytest.raises(OptionError) as caught:
        solve(scene, objective=spelt(name))
    kind = imported(caught.value.way_out)
    arguments.check_options(scene, None, 0, None, 1.0, kind(), "constraint", ())


def test_every_table_of_methods_is_derived_from_one():
    assert {name: known.kind.name for name, known in METHODS.items()} == {name: name for name in METHODS}
    assert tuple(sweep.METHODS) == OWN and set(sweep.ROBOT_METHODS) == set(OWN) & set(OF_ROBOTS)


def test_what_is_no_name_gets_the_general_hint():
    with pytest.raises(OptionError, match="a method object"):
        solve(example("wide"), method=3)


@pytest.mark.parametrize(
    "given", [lambda hands: hands[0], tuple, lambda hands: dict(zip(("left", "right"), hands, strict=True))]
)
def test_movements_of_joints_are_no_paths_of_hands(given):
    time = np.linspace(0.0, 1.0, 30)
    hands = [Demonstration(time, np.outer(time, [0.5, 0.1]), "arm", unit="rad")] * 2
    with pytest.raises(InputError, match="movement of joints in rad, which is no path"):
        arguments.movements_of(given(hands), example("wide"))
