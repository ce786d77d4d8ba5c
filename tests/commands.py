"""Commands of comove in this process: the start of another costs more than most of what they do."""

import warnings

from typer.testing import CliRunner

from comove.cli.app import whole_application


def invoke(*arguments):
    """What a command printed, and its exit code."""
    with warnings.catch_warnings():
        return CliRunner().invoke(whole_application(), [str(argument) for argument in arguments])
