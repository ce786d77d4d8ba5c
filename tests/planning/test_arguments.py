"""Names of the command line in place of objects: the message names the object, and giving it works."""

from importlib import import_module

import pytest

from comove import solve
from comove.cli.options import COMPARED, METHODS
from comove.errors import OptionError
from comove.planning import arguments
from comove.planning.method import Method
from tests.solved import example

OBJECTIVES = ("least-jerk", "least-time", "paper")


def imported(text):
    """Return the class that a message says to import."""
    module, kind = text.split("from ")[1].split(" import ")
    return getattr(import_module(module), kind.strip())


@pytest.mark.parametrize("name", [*METHODS, *COMPARED])
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


def test_tables_name_what_the_command_line_names():
    assert tuple(arguments.METHODS) == (*METHODS, *COMPARED)
    assert tuple(arguments.OBJECTIVES) == OBJECTIVES


def test_what_is_no_name_gets_the_general_hint():
    with pytest.raises(OptionError, match="a method object"):
        solve(example("wide"), method=3)
