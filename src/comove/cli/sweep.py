"""Verbs of `comove sweep`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from comove.cli import studies as s
from comove.cli.app import NOT_VERIFIED, VERIFIED, sub_application, verb_of


class _RunByDefault(TyperGroup):
    """Group of verbs that runs `run` for any other word."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the verb `run` before other words."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["run", *args]
        return super().parse_args(ctx, args)


group = sub_application(
    "sweep", "Run scenes with methods, seeds and settings: comove sweep STUDY --out DIR.", cls=_RunByDefault
)


@verb_of(group)
def run(
    study: s.StudyPath,
    out: s.OutFolder,
    running: s.Running,
    *,
    json: Annotated[bool, typer.Option("--json", help="Print report.json and nothing else.")] = False,
) -> int:
    """Run every scene, method, seed and setting of STUDY; compare them."""
    from json import loads

    from comove.cli.texts import as_table
    from comove.data import Sweep, groups_of
    from comove.data.runner import check_study_folder
    from comove.results.inputs import command_again

    part, run = running.part, running.run
    check_study_folder(out)
    loaded = Sweep.load(study)
    report, path = s.run_with_progress(loaded, out, run, part)
    if json:
        print(path.read_text(encoding="utf-8"), end="")
        return VERIFIED if report.verified else NOT_VERIFIED
    groups = groups_of(out)
    simulated = any(g.delivered is not None for g in groups)
    header = ("scene", "method", "settings", "verified", *(("delivered",) if simulated else ()))
    rows = [(*header, "first [s]", "duration [s]", "cost J", "jerk [m/s^3]", "time [s]")]
    for g in groups:
        values = (g.first, g.duration, g.cost, g.jerk, g.seconds)
        figures = ("-" if value is None else f"{value:.4g}" for value in values)
        settings = ", ".join(f"{key} {value}" for key, value in loads(g.settings or "{}").items())
        arrived = ("-" if g.delivered is None else f"{g.delivered}/{g.runs}",) if simulated else ()
        rows.append((g.scene, g.method, settings or "-", f"{g.verified}/{g.runs}", *arrived, *figures))
    print(f"{report.ended} of {report.total} runs: {s.statuses_text(report)}")
    print(as_table(rows), *s.reason_lines(report), f"report: {path}", sep="\n")
    print(f"made again, in the folder: {command_again(out)}")
    return VERIFIED if report.verified else NOT_VERIFIED


@verb_of(group)
def merge(
    parts: Annotated[
        list[Path], typer.Argument(metavar="PART...", help="Folders of parts that were run apart.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for all runs; its own stay.")],
) -> int:
    """Merge the shards of a study."""
    from comove.data.runs import merge as merged

    found = merged(parts, out)
    print(f"{out} holds {found.ended} of {found.total} runs")
    if found.different:
        print(f"warning: {found.different} runs had other motions in other parts; the first were kept")
    return VERIFIED
