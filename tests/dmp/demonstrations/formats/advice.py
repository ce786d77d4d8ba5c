"""Following the commands that refusals print.

What no file tells stands in them in capitals, `--rate HZ` and `--unit UNIT`: a person knows it, here `KNOWN`.
"""

import shlex

import pytest

from comove.dmp.demonstrations import Demonstration
from comove.errors import ComoveError

KNOWN = {"HZ": "100", "UNIT": "m"}


def printed_command(error):
    """Return the words of the command that a refusal prints."""
    _, found, command = error.way_out.partition("run: ")
    assert found, str(error)
    return shlex.split(command)


def filled(words):
    """Return the words of a command with what a person knows of the recordings of these tests."""
    for word, known in KNOWN.items():
        words = [known if one == word else one.replace(f"[{word}]", "[ms]") for one in words]
    return words


def printed_options(error):
    """Return the options of the printed command, as `Demonstration.load` takes them."""
    program, verb, _, *words = filled(printed_command(error))
    assert (program, verb) == ("comove", "learn")
    if "--drop-missing" in words:
        words.insert(words.index("--drop-missing") + 1, True)
    names = (word.removeprefix("--").replace("-", "_") for word in words[::2])
    options = dict(zip(names, words[1::2], strict=True))
    options.pop("out")
    if "columns" in options:
        options["columns"] = options["columns"].split(",")
    if "rate" in options:
        options["rate"] = float(options["rate"])
    return options


def follow(path, most=5, **options):
    """Load a file with the options that refusals print, each command as it is printed."""
    return followed(path, most, **options)[0]


def followed(path, most=5, **options):
    """Return what `follow` does, and the options of the last command."""
    for _ in range(most):
        try:
            return Demonstration.load(path, **options), options
        except ComoveError as error:
            options = printed_options(error)
    pytest.fail("advice without end")
