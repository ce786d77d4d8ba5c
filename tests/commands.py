"""Commands of comove in this process: the start of another costs more than most of what they do."""

import warnings
from contextlib import chdir

from typer.testing import CliRunner

from comove.cli.app import whole_application


def invoke(*arguments, folder="."):
    """What a command printed that was run in a folder, and its exit code."""
    with warnings.catch_warnings(), chdir(folder):
        return CliRunner().invoke(whole_application(), [str(argument) for argument in arguments])
