"""`comove library remove`."""

from __future__ import annotations

from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.library.app import FOLDER, Folder, library_app


@verb_of(library_app)
def remove(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Of the primitives.")],
    folder: Folder = FOLDER,
) -> int:
    """Delete primitives from the library, damaged ones too."""
    from comove.primitives import Library

    library = Library(folder)
    for name in names:
        if name not in library:
            library.get(name)  # which says what there is
    for name in dict.fromkeys(names):
        library.remove(name)
    count = len(library)
    print(f"{folder} holds {count} primitive{'' if count == 1 else 's'}")
    return 0
