"""Verbs of `comove scene`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import VERIFIED, sub_application, verb_of
from comove.errors import SceneError

group = sub_application("scene", "Scene files: write version 2 of one, print the schema for editors.")


@verb_of(group)
def upgrade(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene of version 1 (YAML).")],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, which must not be there yet; beside SCENE if that names files."),
    ] = None,
) -> int:
    """Convert SCENE to version 2, without its comments. It is printed unless --out is given."""
    from comove.io.folders import scene_folder
    from comove.io.yaml_reader import read_yaml
    from comove.model import Scene
    from comove.model.files.upgrade import as_text, upgraded
    from comove.results.inputs import names_files

    data, _ = read_yaml(scene)
    if data.get("version") == 2:
        raise SceneError("it is of version 2 already", file=scene, key="version", way_out="use it as it is")
    loaded = Scene.load(scene, check_ends=False)
    contents = upgraded(loaded, data)
    text = as_text(contents)
    if (
        out is not None
        and out.absolute().parent.resolve() != scene_folder(scene).resolve()
        and names_files(loaded)
    ):
        way_out = f"write it there: --out {scene_folder(scene) / out.name}"
        raise SceneError("the scene names files beside it", file=out, way_out=way_out)
    _give(text, out)
    if out is not None:
        print(f"{out}: version 2 of {scene}; comments are not kept")
    return VERIFIED


@verb_of(group)
def schema(
    out: Annotated[Path | None, typer.Option(help="File to write; it must not be there yet.")] = None,
) -> int:
    """Print the JSON schema of scene files of version 2. Editors use it to complete and check keys."""
    from comove.model.files.version2 import SceneFile2

    _give(json.dumps(SceneFile2.model_json_schema(), indent=2) + "\n", out)
    return VERIFIED


def _give(text: str, out: Path | None) -> None:
    """Print a text, or write it to a new file."""
    from comove.io.files import whole_file

    if out is None:
        print(text, end="")
        return
    with whole_file(out, SceneError, replace=False) as file:
        file.write(text.encode())
