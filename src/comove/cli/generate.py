"""`comove generate`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import studies as s
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.options import require_one_of
from comove.errors import SceneError, near_name

if TYPE_CHECKING:
    from comove.data import Study, StudyReport
    from comove.data.variety import Variety

SHEET = 24
"""Episodes on a contact sheet."""
NO_FORMATS: list[str] = []


@verb
def generate(
    study: s.StudyPath,
    out: s.OutFolder,
    *,
    episodes: Annotated[
        int | None, typer.Option(metavar="N", help="Number of episodes; that of STUDY unless given.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of all episodes; that of STUDY unless given.")
    ] = None,
    running: s.Running,
    formats: Annotated[
        list[str],
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="Write the verified episodes as a dataset into DIR: npz, lerobot, robomimic, mcap; "
            "may be repeated. What STUDY names unless given.",
        ),
    ] = NO_FORMATS,
    rate: Annotated[
        int | None,
        typer.Option(
            metavar="HZ",
            help="Samples a second of the datasets; those of STUDY's cameras unless given, 50 without any.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print report.json and nothing else.")] = False,
) -> int:
    """Generate a dataset of verified motions, as STUDY defines. Scenes are sampled and solved, verified motions
    kept, and their variety is reported."""
    from comove.data import Study
    from comove.data.datasets import FORMATS, export_episodes
    from comove.data.datasets.export import check_export
    from comove.data.datasets.samples import chosen_rate
    from comove.data.runner import check_study_folder
    from comove.results.inputs import command_again
    from comove.stored import gripper_rows

    part, run = running.part, running.run
    check_study_folder(out)
    loaded = Study.load(study, episodes=episodes, seed=seed)
    wanted = _formats(formats, loaded, running.shard)
    chosen_rate(rate, loaded.described.get("cameras"))
    for name in wanted:
        check_export(out, FORMATS[name])
    if running.dask is None:
        loaded.require()
    probe = loaded.probe()
    print(
        f"{100 * probe.share:.0f} % of {probe.rejected + probe.valid} draws give no valid scene, and are drawn again"
        + (f"; the last: {probe.reason}" if probe.rejected else ""),
        file=sys.stderr,
    )
    report, path = s.run_with_progress(loaded, out, run, part)
    sheet = _contact_sheet(out, loaded.folder)
    if json:
        print(path.read_text(encoding="utf-8"), end="")
    else:
        print(_text(report))
        if running.dask is None:  # whoever asks others to run may lack what robots need
            for robot, arms in loaded.without_gripper.items():
                for title, said, _ in gripper_rows(arms):
                    print(f"  {title:14s} {robot}: {said}")
        print(f"report: {path}", f"made again, in the folder: {command_again(out)}", sep="\n")
        if sheet is not None:
            print(f"first episodes: {sheet}")
    for name in wanted if report.verified else ():
        dataset, count = export_episodes(out, loaded.folder, FORMATS[name], rate, loaded)
        print(f"{name}: {dataset} holds {count} episodes", file=sys.stderr if json else sys.stdout)
    return VERIFIED if report.verified else NOT_VERIFIED


def _contact_sheet(out: Path, scenes: Path) -> Path | None:
    """Draw the first verified episodes; return the picture's path or None.

    Parameters
    ----------
    scenes : folder to which paths in the scenes are relative
    """
    from comove.data.episode import restored
    from comove.data.runs import RUNS, StudyStore
    from comove.view.figures import draw_episodes, save_picture

    store = StudyStore.open(out / RUNS)
    drawn = [
        (restored(kept, scenes, store.path), str(run.number)) for run, kept in islice(store.motions(), SHEET)
    ]
    if not drawn:
        return None
    motions, titles = zip(*drawn, strict=True)
    save_picture(draw_episodes(motions, titles), out / "episodes.png")
    return out / "episodes.png"


def _formats(named: list[str], study: Study, shard: str) -> Sequence[str]:
    """Return the formats to write. They are those of the command, else those of the study unless only a shard is
    run."""
    from comove.data.datasets import FORMATS

    for name in named:
        require_one_of(name, tuple(FORMATS), "format")
    for name in study.file.formats:
        if name not in FORMATS:
            way_out = near_name(name, FORMATS)
            raise SceneError(f"unknown format '{name}'", file=study.path, key="formats", way_out=way_out)
    return named or (study.file.formats if shard == s.WHOLE else ())


def _text(report: StudyReport) -> str:
    """Return a summary of a study in a few lines."""
    lines = [
        f"{report.ended} of {report.total} episodes: {s.statuses_text(report)}",
        f"  verified       {100 * report.verified_share:.1f} % of those with a valid scene; "
        f"{100 * report.rejected_share:.1f} % of all draws were rejected",
    ]
    lines += s.reason_lines(report)
    if (clearance := report.figures.get("clearance_min")) is not None:
        lines.append(
            f"  clearance      {1000 * clearance.least:.1f} to {1000 * clearance.greatest:.1f} mm, certified when run"
        )
    lines += _joint_lines(report)
    found = report.variety
    if found is not None:
        classes = ", ".join(f"{n} x '{name or '-'}'" for name, n in list(found.classes.items())[:5])
        lines += [
            f"  two episodes   differ by {100 * found.starts:.1f} cm in start, {100 * found.goals:.1f} cm in goal, "
            f"{100 * found.paths:.1f} cm in path ({100 * found.shapes:.1f} cm in its shape)",
            f"  passing sides  {_sides(found)}: {classes}",
        ]
    lines.append(f"  bytes          {report.bytes_each:.0f} an episode")
    lines.append(f"  processor time {report.seconds_in_all / max(1, report.ended):.2f} s an episode")
    return "\n".join(lines)


def _sides(found: Variety) -> str:
    if len(found.classes) == 1:
        return "the same in all episodes"
    return f"{len(found.classes)} classes, as varied as {2**found.entropy:.3g} equally frequent ones"


def _joint_lines(report: StudyReport) -> list[str]:
    """Return lines on a robot's joints and simulations."""
    figures, lines = report.figures, []
    if (speed := figures.get("joints.velocity_ratio_max")) is not None:
        torque, margin = figures["joints.torque_ratio_max"], figures["joints.joint_margin_min"]
        near = [figures[name].least for name in figures if name.startswith("joints.clearance_")]
        lines.append(
            f"  joints         up to {100 * speed.greatest:.0f} % of their speed and {100 * torque.greatest:.0f} % "
            f"of their torque, {margin.least:.3f} rad from their limits"
            + (f"; links {1000 * min(near):.1f} mm from everything" if near else "")
        )
    if (end := figures.get("simulation.end_error")) is not None:
        force = figures.get("simulation.internal_force_max")
        lines.append(
            f"  in MuJoCo      the load ends {1000 * end.median:.1f} mm from its goal, "
            f"{1000 * end.greatest:.1f} mm at most"
            + ("" if force is None else f"; inner force up to {force.greatest:.0f} N")
        )
    return lines
