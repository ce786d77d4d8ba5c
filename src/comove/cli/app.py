"""Application: verbs, exit codes, and output of errors and warnings."""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from importlib import import_module
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from comove._version import __version__
from comove.cli.streams import FULL_OUTPUT, guard_streams
from comove.errors import ComoveError, ComoveWarning, OptionError, plain, readable, shortened

VERIFIED, NOT_VERIFIED, BAD_INPUT, DEFECT, INTERRUPTED = 0, 1, 2, 70, 130

STYLE: dict[str, Any] = {"no_args_is_help": True, "rich_markup_mode": None, "pretty_exceptions_enable": False}

app = typer.Typer(
    name="comove",
    help="Several manipulators carry one load: coordinated movement primitives, verified in continuous time.",
    add_completion=False,
    **STYLE,
)

Command = Callable[..., int | None]

WITH_ROBOT = "Options that apply only with a robot"


class Verb(TyperCommand):
    """Command whose help lists panels, such as `WITH_ROBOT`, as own sections."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of arguments and options."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            if record is not None:
                sections.setdefault(_panel(parameter) or usual, []).append(record)
        for name, records in sections.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)


def _panel(parameter: Any) -> str | None:
    """Return the help section of a parameter; None for the default."""
    panel: str | None = getattr(parameter, "rich_help_panel", None)
    return panel


def sub_application(name: str, about: str, **options: Any) -> typer.Typer:
    """Return a new group of verbs, `comove NAME VERB`. `options` are those of Typer."""
    group = typer.Typer(name=name, help=about, **STYLE, **options)
    group.callback(help=about)(lambda: None)  # so that a single verb is still named
    app.add_typer(group)
    return group


def verb_of(application: typer.Typer, name: str | None = None) -> Callable[[Command], Callable[..., None]]:
    """Return a decorator that registers a command. The command returns its exit code and may raise `ComoveError`. A
    parameter whose type is a dataclass stands for the options that are its fields, which several commands may share.
    """

    def register(function: Command) -> Callable[..., None]:
        options, groups = _options_of(function)

        @wraps(function)
        def command(*, context: typer.Context, **given: Any) -> None:
            _running[:] = [context]
            warnings.showwarning = _tell_warning  # type: ignore[assignment]  # mypy wants parameters by name
            warnings.simplefilter("always", ComoveWarning)
            for name, kind in groups.items():
                given[name] = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
            try:
                code = function(**given)
            except (ComoveError, OSError, KeyboardInterrupt) as error:
                code = _told(error)
            raise typer.Exit(code or VERIFIED)

        options.insert(0, Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context))
        command.__signature__ = Signature(options)  # type: ignore[attr-defined]  # typing knows none of functions
        command.__annotations__ = {option.name: option.annotation for option in options}
        application.command(name, cls=Verb)(command)
        return command

    return register


def former_verb_of(group: typer.Typer, command: Callable[..., None]) -> None:
    """Register a verb also under its former name, `comove GROUP VERB`. It is hidden and prints a warning.

    Parameters
    ----------
    command : the verb, as returned by `verb`
    """
    verb = command.__name__
    former = f"{group.info.name} {verb}"

    @wraps(command)
    def same(**given: Any) -> None:
        print(
            f"warning: 'comove {former}' is now 'comove {verb}'; the former name will be removed",
            file=sys.stderr,
        )
        command(**given)

    group.command(verb, cls=Verb, hidden=True)(same)


def _options_of(function: Any) -> tuple[list[Parameter], dict[str, Any]]:
    """Return the options of a command or dataclass, and its option groups."""
    types = get_type_hints(function, include_extras=True)
    options, groups = list[Parameter](), dict[str, Any]()
    for name, parameter in signature(function).parameters.items():
        if is_dataclass(types[name]):
            groups[name] = types[name]
            options += _options_of(types[name])[0]
        else:
            options.append(parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=types[name]))
    return options, groups


verb = verb_of(app)
_running: list[typer.Context] = []


NOT_AGAIN = frozenset({"out", "json", "no_pictures", "workers", "dask"})
"""Parameters that change no result: where it is written, what is printed, and how many processes compute it."""


def command_words() -> list[str | Path]:
    """Return the words after ``comove`` that repeat the running command. They are its verb, its arguments and the
    options unlike their defaults, without those of `NOT_AGAIN`; file names are given as `Path`."""
    (context,) = _running
    words: list[str | Path] = []
    place: Any = context
    while place.parent is not None:
        words.insert(0, place.info_name)
        place = place.parent
    if requires_robot():
        del words[0]  # of the former name
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in NOT_AGAIN or value is None or value == parameter.default:
            continue
        for one in value if isinstance(value, (list, tuple)) else (value,):
            is_flag = isinstance(one, bool)
            if parameter.param_type_name == "option":
                words.append(parameter.opts[0] if one or not is_flag else parameter.secondary_opts[0])
            if not is_flag:
                words.append(one if isinstance(one, Path) else str(one))
    return words


def requires_robot() -> bool:
    """Return whether the running command is a former verb of robots. Such a command is refused without a robot."""
    return bool(_running and _running[0].command.hidden)


def refuse_robot_options(message: str, way_out: str) -> None:
    """Refuse options of the running command that require a robot."""
    (context,) = _running
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if _panel(parameter) == WITH_ROBOT and source is not None and source.name == "COMMANDLINE":
            is_off = context.params.get(parameter.name or "") is False and parameter.secondary_opts
            option = (parameter.secondary_opts if is_off else parameter.opts)[0]
            raise OptionError(message, key=option, way_out=way_out)


def since_process_start() -> float:
    """Return the time since this process began [s]."""
    try:
        with open("/proc/self/stat", encoding="ascii") as stat:
            ticks = int(stat.read().rsplit(")", 1)[1].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return time.process_time()


def _tell_warning(message: Warning | str, category: type[Warning], *_: object) -> None:
    if issubclass(category, ComoveWarning):
        print(f"warning: {plain(str(message))}", file=sys.stderr)


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
    """Plan, verify and run coordinated motions of several manipulators."""


VERBS = (
    *("bench", "demo", "doctor", "explain", "export", "generate", "learn", "library", "report"),
    *(
        "reproduce",
        "robot",
        "run",
        "scene",
        "send",
        "serve",
        "show",
        "simulate",
        "solve",
        "sweep",
        "verify",
        "view",
    ),
)
"""Files of this folder that register verbs."""


def whole_application(verb: str = "") -> typer.Typer:
    """Return the application with all verbs, or with `verb` alone."""
    for name in (verb,) if verb in VERBS else VERBS:
        import_module(f"comove.cli.{name}")
    return app


def main() -> None:
    """Run the `comove` command, which ends in a documented exit code."""
    guard_streams()
    _unwind_when_ended()
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(
            variable, "1"
        )  # on small matrices threads wait for each other longer than they compute
    try:
        try:
            whole_application(*sys.argv[1:2])()
        except SystemExit as leaving:
            code = leaving.code
        except BaseException as error:
            code = _told(error)
        sys.stdout.flush()  # where it may turn out that nobody listens
    except KeyboardInterrupt:
        code = INTERRUPTED
    sys.exit(code)


def _unwind_when_ended() -> None:
    """Make ending signals interrupt the process, so that drafts are removed."""

    def leave(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:  # `nohup` ignores one
            signal.signal(number, leave)


def _told(error: BaseException) -> int:
    """Print in one sentence why the command ended; return its exit code."""
    words, code = " ".join(str(error).split()), BAD_INPUT
    if isinstance(error, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    if isinstance(error.__cause__, OSError) and error.__cause__.errno == errno.EFBIG:
        code = FULL_OUTPUT
    if isinstance(error, ComoveError):
        message = str(error) if error.says_all else f"{error} (comove explain {type(error).__name__})"
    elif isinstance(error, MemoryError):
        message = "there is not enough memory for this; give it less, or more memory"
    elif isinstance(error, UnicodeEncodeError) and error.encoding != "utf-8":
        text = error.object[error.start : error.end]
        message = (
            f"{shortened(text)!r} cannot be written in this environment's encoding ({error.encoding}); "
            "set PYTHONUTF8=1, or LC_ALL=C.UTF-8"
        )
    elif isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        message = (
            f"{place}the system refused: {error.strerror or words}; check the path, and that you may use it"
        )
    else:
        code = DEFECT
        message = (
            f"this is a defect of comove, not of what you gave it ({type(error).__name__}: {shortened(words)}); "
            f"{_report(error)}"
        )
    print(f"error: {plain(readable(message))}", file=sys.stderr)
    return code


def _report(error: BaseException) -> str:
    """Write a defect report to a file; return its path."""
    import platform
    import tempfile
    import traceback

    lines = [
        f"comove {__version__}, Python {platform.python_version()}, {platform.platform()}",
        f"command: {sys.argv!r}",
        "",
        *traceback.format_exception(error),
    ]
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            prefix="comove-defect-",
            suffix=".txt",
            encoding="utf-8",
            errors="backslashreplace",
            delete=False,
        ) as file:
            file.write("\n".join(lines))
    except OSError as refused:
        return f"no report could be written ({refused.strerror}): set TMPDIR to a folder that you may write"
    return f"please send the report {file.name}"


INSTEAD = "instead of what SCENE says"


@dataclass(frozen=True)
class RunLimits:
    """Options that override limits of a scene for executions."""

    duration: Annotated[float | None, typer.Option(help=f"Duration of the movement [s], {INSTEAD}.")] = None
    speed: Annotated[float | None, typer.Option(help=f"Limit of the hands' speed [m/s], {INSTEAD}.")] = None
    acceleration: Annotated[
        float | None, typer.Option(help=f"Limit of the hands' acceleration [m/s^2], {INSTEAD}.")
    ] = None
    clearance: Annotated[
        float | None, typer.Option(help=f"Distance to keep from everything [m], {INSTEAD}.")
    ] = None

    @property
    def changes(self) -> dict[str, Any]:
        """Return the given options as the argument `changes` of `Scene.load`."""
        given = {key: value for key, value in vars(self).items() if value is not None}
        changes = {"duration": given.pop("duration")} if "duration" in given else {}
        return changes | ({"limits": given} if given else {})


@dataclass(frozen=True)
class SceneLimits(RunLimits):
    """Options that override limits of a scene for motions."""

    jerk: Annotated[float | None, typer.Option(help=f"Limit of the hands' jerk [m/s^3], {INSTEAD}.")] = None
