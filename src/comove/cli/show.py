"""`comove show`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import HANDS_ALONE, say
from comove.errors import ResultError

if TYPE_CHECKING:
    from comove.results import ResultKind
    from comove.stored import ResultPart, Verification

AS_STORED = "AS STORED, NOT VERIFIED"


@verb
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    open_pictures: Annotated[bool, typer.Option("--open", help="Open the pictures as well.")] = False,
) -> int:
    """Verify a result again and print its summary. The summary includes simulations and names pictures."""
    from comove.cli.progress import progress_bar
    from comove.cli.texts import in_rows, pictures_in
    from comove.results.inputs import command_again
    from comove.stored import ResultPart, Verification, parts_of, verify_folder

    code, found, why = VERIFIED, dict[ResultPart, Verification](), ""
    summaries = {part: _kind_of(part).read(folder, whole=True)[0] for part in parts_of(folder)}
    try:
        with progress_bar():
            found = {part.part: part for part in verify_folder(folder)}
    except ResultError as error:  # scene or robot are not there
        why = str(error)
    for part, summary in summaries.items():
        told, verdict = dict(summary), AS_STORED
        if part in found:
            told |= _measured(found[part])
            verdict = "" if found[part].verified or not _is_claimed(part, summary) else "NOT VERIFIED"
            if found[part].verified and all(one.is_hands_alone for one in found.values()):
                verdict = HANDS_ALONE
        if verdict not in ("", HANDS_ALONE):
            code = NOT_VERIFIED
            told["reasons"] = list(found[part].reasons) if part in found else [why]
        print(_text(part, told, folder, verdict))
    against = dict.fromkeys(words for part in found.values() for words in part.against)
    if against:
        first, *others = against
        say(f"  verified against {first}", *(f"  {words}" for words in others))
    if again := command_again(folder):
        say(*in_rows([("made again, in the folder", again)]))
    if open_pictures:
        for path in pictures_in(folder):
            typer.launch(str(path))
    return code


def _kind_of(part: ResultPart) -> ResultKind:
    """Return the file layout of a part."""
    from comove.stored import ResultPart

    if part is ResultPart.MOTION:
        from comove.results.solution import SOLUTION as kind
    elif part is ResultPart.RUN:
        from comove.results.runs import RUN as kind
    elif part is ResultPart.JOINTS:
        from comove.robots.files import JOINTS as kind
    elif part is ResultPart.ROBOT_RUN:
        from comove.sim.robot_runs import ROBOT_RUN as kind
    else:
        from comove.sim import SIMULATION as kind
    return kind


def _is_claimed(part: ResultPart, summary: Mapping[str, Any]) -> bool:
    from comove.stored import ResultPart

    named = {ResultPart.ROBOT_RUN: "as_it_should_be", ResultPart.SIMULATION: "delivered"}
    return summary.get(named.get(part, "verified")) is True


def _measured(found: Verification) -> dict[str, Any]:
    """Return a verification's measures by their names in the part's summary."""
    from comove.results.sealed import finite
    from comove.stored import ResultPart

    measures: dict[str, Any] = {}
    if found.part is ResultPart.JOINTS and found.verified_joints is not None:
        report = found.verified_joints.report
        measures = report.asdict() | {"without_gripper": report.without_gripper}
    elif found.part in (ResultPart.MOTION, ResultPart.RUN) and found.report is not None:
        measures = {name: value for name, value in found.report.asdict().items() if name != "reasons"}
    elif found.robot is not None:
        from comove.robots.verification.checks import without_gripper

        measures = {"without_gripper": without_gripper(found.robot)}
    return {name: finite(value) if isinstance(value, float) else value for name, value in measures.items()}


def _text(part: ResultPart, summary: Mapping[str, Any], folder: Path, verdict: str = "") -> str:
    """Return the printed summary of a part."""
    from comove.cli import texts
    from comove.stored import ResultPart

    if part is ResultPart.JOINTS:
        told = texts.joints_text(summary["robot"], summary)
        return "\n".join([told, f"  {verdict}", *texts.listed(summary["reasons"])]) if verdict else told
    write = {
        ResultPart.MOTION: texts.summary_text,
        ResultPart.RUN: texts.run_text,
        ResultPart.ROBOT_RUN: texts.robot_run_text,
        ResultPart.SIMULATION: texts.simulation_text,
    }[part]
    return write(summary, folder, verdict)
