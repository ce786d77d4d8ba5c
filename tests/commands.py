"""Commands of comove in this process: the start of another costs more than most of what they do."""

import warnings
from contextlib import chdir
from functools import cache

import typer.testing

from comove.cli.app import whole_application

typer.testing._get_command = cache(typer.testing._get_command)  # it is built anew for every command otherwise


def invoke(*arguments, folder="."):
    """What a command printed that was run in a folder, and its exit code."""
    with warnings.catch_warnings(), chdir(folder):
        return typer.testing.CliRunner().invoke(
            whole_application(), [str(argument) for argument in arguments]
        )
