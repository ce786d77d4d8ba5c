"""`comove explain`."""

from __future__ import annotations

import inspect
from typing import Annotated

import typer

from comove.cli.app import verb
from comove.errors import OptionError, kinds, near_name


@verb
def explain(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Name of an error.")] = None,
) -> int:
    """Explain an error and its correction, with an example. Without a name, list all errors."""
    texts = {known: inspect.getdoc(kind) or "" for known, kind in kinds().items()}
    if name is None:
        for known, text in texts.items():
            print(f"{known:18s} {text.splitlines()[0]}")
    elif name not in texts:
        raise OptionError(f"there is no error '{name}'", key="NAME", way_out=near_name(name, texts))
    else:
        print(f"{name}\n\n{texts[name]}")
    return 0
