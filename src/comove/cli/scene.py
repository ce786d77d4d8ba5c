"""Verbs of `comove scene`."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from comove.cli import options as o
from comove.cli.app import VERIFIED, sub_application, verb_of
from comove.errors import SceneError

group = sub_application(
    "scene", "Scene files: write version 2 of one, import one of MoveIt, print the schema."
)
Triple = tuple[float, float, float]


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


@verb_of(group, "import")
def import_(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]", help="Planning scene of MoveIt: a bag of ROS 2 (folder, .mcap), or .scene."
        ),
    ] = None,
    *,
    robot: Annotated[
        str, typer.Option(metavar="ROBOT", help="A description (YAML), or a bundled robot's name.")
    ],
    ros: Annotated[
        int | None,
        typer.Option(metavar="2", help="Record the present planning scene from ROS 2, beside --out."),
    ] = None,
    topic: Annotated[str | None, typer.Option(**o.SCENE_TOPIC)] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Scene to write, beside or above FILE; it must not be there yet. Else it is printed."
        ),
    ] = None,
    shift: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="From the payload's start to its goal [m].")
    ] = None,
    goal_position: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="The payload's position at the goal [m].")
    ] = None,
    goal_rpy_deg: Annotated[
        Triple | None,
        typer.Option(
            metavar="R P Y", help="Its orientation there, about x, y and z; that of the start unless given."
        ),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Object that is carried; the attached one unless given."),
    ] = None,
    leave_out: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Object that is left out; may be repeated.")
    ] = None,
    support: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Object on which the payload rests; may be repeated."),
    ] = None,
    srdf: Annotated[Path | None, typer.Option(help="SRDF that has the group state of --state.")] = None,
    state: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Group state whose joints replace those of the planning scene."),
    ] = None,
) -> int:
    """Make a scene for a robot from a planning scene of MoveIt.

    It is read from FILE, or recorded by --ros 2. It has no goal, so give one: --shift, or --goal-position and
    --goal-rpy-deg.
    """
    import os

    import yaml

    from comove.cli.texts import in_rows, say
    from comove.io.files import require_target
    from comove.model import Scene
    from comove.model.files.upgrade import as_text
    from comove.robots import Robot, bundled_robots, find_description
    from comove.robots.planning_scenes import Goal, ImportOptions, scene_from, with_supports_at_rest

    if out is not None:
        require_target(out, SceneError)
    loaded, goal = Robot.load(robot), Goal(shift, goal_position, goal_rpy_deg)
    with ExitStack() as undo:
        file = _source(file, ros, topic, out, undo)
        folder = file.absolute().parent if out is None else out.absolute().parent
        options = ImportOptions(goal, payload, tuple(leave_out or ()), tuple(support or ()), srdf, state)
        stem = file.stem if out is None else out.stem
        found = scene_from(file, loaded, folder, stem, options)
        named = robot if robot in bundled_robots() else os.path.relpath(find_description(robot), folder)
        data: dict[str, Any] = {"version": 2, "name": stem, "robot": named} | found.data
        if found.meshes and out is None:
            told = "the payload's meshes are written beside the scene"
            raise SceneError(
                told, file=file, key="--out", way_out="name the scene to write: --out scene.yaml"
            )
        for name, mesh in found.meshes.items():
            _give(mesh.decode(), folder / name)
            undo.callback((folder / name).unlink)
        data, idle = with_supports_at_rest(data, folder)
        Scene.from_dict(data, folder=folder)
        notes = [*found.notes]
        if idle:
            notes.append(
                f"the payload keeps clear of what it may touch and does not rest on: {', '.join(idle)}"
            )
        if out is None:
            if found.present:
                notes.append("joints are written beside the scene, where --out says")
            say(*(f"  - {note}" for note in notes), file=sys.stderr)
            print(as_text(data), end="")
            return VERIFIED
        present = out.with_name(f"{out.stem}-present.yaml")
        if found.present:
            _give(yaml.safe_dump(dict(found.present), sort_keys=False), present)
            undo.callback(present.unlink)
        _give(as_text(data), out)
        undo.pop_all()
    say(f"{out}: a scene for {loaded.name}", *(f"  - {note}" for note in notes))
    command = f"comove solve {out}" + (f" --present {present}" if found.present else "") + " --out carried"
    rows = [("grasps", "proposed" if data["grasps"] == "auto" else f"of {' and '.join(data['grasps'])}")]
    if found.present:
        rows.append(
            ("joints", f"{present}, {'which hold the payload' if found.is_held else 'before an approach'}")
        )
    print(*in_rows([*rows, ("next", command)]), sep="\n")
    return VERIFIED


def _source(file: Path | None, ros: int | None, topic: str | None, out: Path | None, undo: ExitStack) -> Path:
    """Return the file of the planning scene; record it if it is wanted from ROS 2, beside `out`."""
    if ros not in (None, 2):
        raise SceneError(f"MoveIt 2 is of ROS 2, not of ROS {ros}", key="--ros", way_out="give --ros 2")
    if ros is None and file is None:
        raise SceneError(
            "there is no planning scene", key="FILE", way_out="name a file, or give --ros 2 to record one"
        )
    if ros is None and file is not None:
        if topic is not None:
            raise SceneError("nothing is recorded", key="--topic", way_out="give --ros 2 instead of a file")
        return file
    if file is not None:
        raise SceneError("it is recorded from ROS 2, or read from a file", key="FILE", way_out="leave it out")
    if out is None:
        told = "what is recorded is written beside the scene"
        raise SceneError(told, key="--out", way_out="name the scene to write: --out scene.yaml")
    from comove.io.files import require_target
    from comove.ros.live_scenes import TOPIC, record

    recorded = out.with_suffix(".mcap")
    require_target(recorded, SceneError)
    record(recorded, topic or TOPIC)
    undo.callback(recorded.unlink)
    return recorded


def _give(text: str, out: Path | None) -> None:
    """Print a text, or write it to a new file."""
    from comove.io.files import whole_file

    if out is None:
        print(text, end="")
        return
    with whole_file(out, SceneError, replace=False) as file:
        file.write(text.encode())
