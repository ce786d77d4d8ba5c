"""`comove library list`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import BAD_INPUT, VERIFIED, verb_of
from comove.cli.library.app import FOLDER, Folder, library_app
from comove.cli.recordings import check_picture, save_picture


@verb_of(library_app, "list")
def list_primitives(
    folder: Folder = FOLDER,
    json: Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")] = False,
    out: Annotated[Path | None, typer.Option(help="Picture of all of them (PNG, PDF or SVG).")] = None,
) -> int:
    """List the primitives of the library; damaged files are named, others left alone."""
    from comove.primitives import Library

    check_picture(out)
    library = Library(folder)
    primitives, damaged = library.read_all()
    if json:
        print(_as_json(primitives))
    elif not primitives:
        print(f"{folder} holds no primitives; add some: comove library add DEMO")
    else:
        print(_as_table(primitives))
    for error in damaged.values():
        print(f"error: {error}", file=sys.stderr)
    if library.foreign:
        print(f"left alone, no primitives: {', '.join(library.foreign)}", file=sys.stderr)
    if out is not None:
        from comove.views import draw_library

        save_picture(draw_library(primitives, title=str(folder)), out)
    return BAD_INPUT if damaged else VERIFIED


def _as_table(primitives) -> str:
    rows = [("name", "kind", "dims", "duration", "variant", "weights", "fit error (rms)", "learned from")]
    for p in primitives:
        dmp, learned = p.positions, p.provenance
        error = "-" if learned is None else f"{learned.error_rms:.3g} {p.unit}"
        source = "-" if learned is None else learned.source or learned.recording
        rows.append(
            (
                p.name,
                p.kind,
                f"{dmp.n_dims}",
                f"{dmp.duration:.3g} s",
                str(dmp.variant),
                f"{dmp.weights.shape[1]}",
            )
            + (error, source)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def _as_json(primitives) -> str:
    from dataclasses import asdict
    from json import dumps

    entries = [
        {
            "name": p.name,
            "kind": p.kind,
            "unit": p.unit,
            "variant": str(p.positions.variant),
            "n_dims": p.positions.n_dims,
            "n_basis": p.positions.weights.shape[1],
            "duration": p.dmp.duration,
            "start": p.positions.start.tolist(),
            "goal": p.positions.goal.tolist(),
            "provenance": None if p.provenance is None else asdict(p.provenance),
            "notes": p.notes,
        }
        for p in primitives
    ]
    return dumps(entries, indent=2, allow_nan=False)
