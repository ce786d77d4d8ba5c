"""`comove verify`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, SceneLimits, verb
from comove.cli.texts import HANDS_ALONE, in_rows, say
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.stored import Verification


@verb
def verify(
    things: Annotated[
        list[Path],
        typer.Argument(
            metavar="[SCENE] DIR",
            help="Result folder, and before it the scene file that you trust; without one the folder's own scene.",
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot whose joint motion it is: a bundled one's name, or a description (YAML); what the scene "
            "says unless given."
        ),
    ] = None,
    *,
    limits: SceneLimits,
) -> int:
    """Verify a saved result again, from its files alone. It may hold a motion, joints, a run and a simulation."""
    from comove.cli.progress import progress_bar
    from comove.model import Scene
    from comove.stored import verify_folder

    *scenes, folder = things
    if len(scenes) > 1:
        raise OptionError(
            f"{len(things)} paths are given",
            key="DIR",
            way_out="name a scene and a folder, or a folder alone",
        )
    if limits.changes and not scenes:
        raise OptionError(
            "there is no scene that it could change",
            key=f"--{next(iter(limits.changes.get('limits', limits.changes)))}",
            way_out="name the scene before the folder, or leave it out",
        )
    with progress_bar():
        scene = Scene.load(scenes[0], limits.changes) if scenes else None
        parts = verify_folder(folder, scene, robot)
    _require_robot(parts, folder, robot)
    reasons = dict.fromkeys(reason for part in parts for reason in part.reasons)
    if reasons:
        say(f"{folder}: rejected", *(f"  - {reason}" for reason in reasons), file=sys.stderr)
        _say_against(parts, file=sys.stderr)
        for words in filter(None, (part.allowance for part in parts)):
            say(f"  deviations of joints: {words}, in the robot's description", file=sys.stderr)
        if scene is not None:
            _say_changes(parts[0], folder, scenes[0])
        return NOT_VERIFIED
    proved = any(part.is_proof for part in parts)
    verdict = "verified" if proved else "as it should be, at samples: nothing is proved in between"
    if all(part.is_hands_alone for part in parts):
        verdict = HANDS_ALONE
    say(f"{folder}: {verdict}")
    _say_against(parts)
    _say_measures(parts)
    return VERIFIED


def _require_robot(parts: tuple[Verification, ...], folder: Path, robot: str | None) -> None:
    """Refuse a robot for a folder without joint motion."""
    if robot is not None and all(part.robot is None for part in parts):
        raise OptionError(
            "the folder holds no motion of a robot's joints",
            file=folder,
            key="--robot",
            way_out="leave it out, or name the folder of a robot's motion",
        )


def _say_against(parts: tuple[Verification, ...], file: TextIO | None = None) -> None:
    first, *others = dict.fromkeys(words for part in parts for words in part.against)
    say(f"  against {first}", *(f"  {words}" for words in others), file=file)


def _say_measures(parts: tuple[Verification, ...]) -> None:
    """Print the measures of all parts, each once."""
    rows = dict.fromkeys(
        (name, f"{words} (asked for: {asked})" if asked else words, "")
        for part in parts
        for name, words, asked in part.rows
    )
    allowed = [part.allowance for part in parts]
    rows |= dict.fromkeys(("deviations of joints", words, "") for words in allowed if words)
    print(*in_rows(rows), sep="\n")


def _say_changes(part: Verification, folder: Path, scene: Path) -> None:
    """Print the options that change the scene to the solved one."""
    from comove.results import changes_to

    if changed := changes_to(part.scene, folder, part.summary, scene):
        options = " ".join(f"--{key} {value}" for key, value in changed.items())
        say(f"  it was solved with {options}: give that again", file=sys.stderr)
