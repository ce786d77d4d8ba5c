"""The page of commands and options, written from the application itself."""

from __future__ import annotations

from typing import Any

import typer

from comove.cli.app import whole_application

INTRODUCTION = """# Command line

`comove COMMAND --help` says the same. Lengths are in metres, times in seconds. [Exit codes](errors.md#exit-codes).
"""


def page() -> str:
    """Return the Markdown of the page on the command line."""
    root = typer.main.get_command(whole_application())
    parts = [INTRODUCTION]
    for path, command in sorted(_commands(root, "comove")):
        parts += _section(path, command)
    return "\n".join(parts) + "\n"


def _commands(command: Any, path: str) -> list[tuple[str, Any]]:
    """Return all commands below one, with the words by which each is called."""
    if not hasattr(command, "commands"):
        return [(path, command)]
    found = []
    for name, part in command.commands.items():
        found += _commands(part, f"{path} {name}")
    return found


def _section(path: str, command: Any) -> list[str]:
    """Return the lines that describe one command."""
    context = command.context_class(command, info_name=path)
    usage = command.get_usage(context).removeprefix("Usage: ")
    lines = [f"## {path}", "", (command.help or "").strip(), "", "```text", usage, "```", ""]
    options = [p for p in command.params if p.name != "help"]
    if options:
        lines += ["| | |", "|---|---|"]
    for parameter in options:
        names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
        if parameter.param_type_name == "argument":
            names = f"`{parameter.metavar or parameter.name.upper()}`"
        lines.append(f"| {names} | {_said(parameter)} |")
    return [*lines, ""]


def _said(parameter: Any) -> str:
    """Return the help of a parameter and its default, on one line."""
    text = " ".join((getattr(parameter, "help", None) or "").split()).replace("|", "\\|")
    default = parameter.default
    if callable(default) or default is None or isinstance(default, bool) or default == ():
        return text
    return f"{text} Default: `{default}`."
