"""`comove generate`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import studies as s
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb
from comove.cli.options import require_one_of

if TYPE_CHECKING:
    from comove.studies import StudyReport

NO_FORMATS: list[str] = []


@verb
def generate(
    study: s.StudyPath,
    out: s.OutFolder,
    workers: s.Workers = 2,
    shard: s.ShardOption = s.WHOLE,
    slurm: s.Slurm = None,
    shards: s.Shards = 1,
    dask: s.Dask = None,
    formats: Annotated[
        list[str],
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="Write the verified episodes as a dataset into DIR: npz, lerobot, lerobot-2.1, robomimic, mcap; "
            "may be repeated.",
        ),
    ] = NO_FORMATS,
    rate: Annotated[int, typer.Option(metavar="HZ", help="Samples a second of the datasets.")] = 50,
    json: Annotated[bool, typer.Option("--json", help="Print report.json and nothing else.")] = False,
) -> int:
    """Draw scenes as STUDY says, solve each, keep what is verified, and say how various it is."""
    from comove.studies import Shard, Study, report_of, write_report
    from comove.studies.datasets import FORMATS, export_episodes
    from comove.studies.datasets.export import check_export

    s.require_alone(shard, slurm)
    for name in formats:
        require_one_of(name, tuple(FORMATS), "format")
        check_export(out, FORMATS[name])
    part, loaded, run = Shard.parse(shard), Study.load(study), s.runs_of(workers, dask)
    if slurm is not None:
        s.write_slurm("generate", slurm, study, out, shards=shards, workers=workers, name=loaded.name)
        return VERIFIED
    probe = loaded.probe()
    print(
        f"{100 * probe.share:.0f} % of {probe.rejected + probe.valid} draws give no valid scene, and are drawn again"
        + (f"; the last: {probe.reason}" if probe.rejected else ""),
        file=sys.stderr,
    )
    try:
        s.run_with_progress(loaded, out, run, part)
    except KeyboardInterrupt:
        return INTERRUPTED
    report = report_of(out)
    path = write_report(report, out)
    if json:
        print(path.read_text(encoding="utf-8"), end="")
    else:
        print(_text(report), f"report: {path}", sep="\n")
    for name in formats if report.verified else ():
        dataset, count = export_episodes(out, loaded.folder, FORMATS[name], rate)
        print(f"{name}: {dataset} holds {count} episodes", file=sys.stderr if json else sys.stdout)
    return VERIFIED if report.verified else NOT_VERIFIED


def _text(report: StudyReport) -> str:
    """Return what a study shows, in a few lines."""
    lines = [
        f"{report.ended} of {report.total} episodes: {s.statuses_text(report)}",
        f"  verified       {100 * report.verified_share:.1f} % of those with a valid scene; "
        f"{100 * report.rejected_share:.1f} % of all draws were rejected",
    ]
    lines += [f"  {count:5d} x        {reason}" for reason, count in report.reasons.items()]
    if (clearance := report.figures.get("clearance_min")) is not None:
        lines.append(
            f"  clearance      {1000 * clearance.least:.1f} to {1000 * clearance.greatest:.1f} mm, certified"
        )
    found = report.variety
    if found is not None:
        classes = ", ".join(f"{n} x '{name or '-'}'" for name, n in list(found.classes.items())[:5])
        lines += [
            f"  two episodes   differ by {100 * found.starts:.1f} cm in start, {100 * found.goals:.1f} cm in goal, "
            f"{100 * found.paths:.1f} cm in path ({100 * found.shapes:.1f} cm in its shape)",
            f"  passing sides  {len(found.classes)} classes, {found.entropy:.2f} bit: {classes}",
        ]
    lines.append(f"  bytes          {report.bytes_each:.0f} an episode")
    return "\n".join(lines)
