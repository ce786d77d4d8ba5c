"""The application: verbs, exit codes, and how errors and warnings are told."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, NoReturn

import typer

from comove._version import __version__
from comove.errors import ComoveError, ComoveWarning

VERIFIED, NOT_VERIFIED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

STYLE = {"no_args_is_help": True, "rich_markup_mode": None, "pretty_exceptions_enable": False}

app = typer.Typer(
    name="comove",
    help="Several manipulators carry one load: coordinated movement primitives, verified in continuous time.",
    add_completion=False,
    **STYLE,
)

Command = Callable[..., int | None]


def sub_application(name: str, about: str) -> typer.Typer:
    """A group of verbs, `comove NAME VERB`."""
    group = typer.Typer(name=name, help=about, **STYLE)
    group.callback(help=about)(lambda: None)  # so that a single verb is still named
    app.add_typer(group)
    return group


def verb_of(application: typer.Typer, name: str | None = None) -> Callable[[Command], Callable[..., None]]:
    """Register a command: it returns its exit code and may raise `ComoveError` for bad input."""

    def register(function: Command) -> Callable[..., None]:
        @wraps(function)
        def command(*args: Any, **options: Any) -> None:
            warnings.showwarning = _tell_warning
            warnings.simplefilter("always", ComoveWarning)
            try:
                code = function(*args, **options)
            except ComoveError as error:
                fail(str(error))
            except KeyboardInterrupt:
                print("interrupted", file=sys.stderr)
                raise typer.Exit(INTERRUPTED) from None
            raise typer.Exit(code or VERIFIED)

        application.command(name)(command)
        return command

    return register


verb = verb_of(app)


def fail(message: str) -> NoReturn:
    """Tell bad input in one message and leave."""
    print(f"error: {message}", file=sys.stderr)
    raise typer.Exit(BAD_INPUT)


def since_process_start() -> float:
    """Seconds since this process began."""
    try:
        with open("/proc/self/stat", encoding="ascii") as stat:
            ticks = int(stat.read().rsplit(")", 1)[1].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return time.process_time()


def _tell_warning(message: Warning | str, category: type[Warning], *_: object) -> None:
    if issubclass(category, ComoveWarning):
        print(f"warning: {message}", file=sys.stderr)


def _version(asked: bool) -> None:
    if asked:
        print(f"comove {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Show the version."
    ),
) -> None:
    """Several manipulators carry one load: coordinated movement primitives, verified in continuous time."""


def main() -> None:
    """Entry point of the `comove` command."""
    try:
        from comove.cli import (  # noqa: F401  registers verbs
            bench,
            demo,
            learn,
            library,
            reproduce,
            robot,
            run,
            show,
            solve,
            verify,
        )

        app()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
