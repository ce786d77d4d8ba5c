"""Options and output shared by `comove generate`, `sweep` and `bench`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli.app import INTERRUPTED, command_words
from comove.cli.progress import progress_bar
from comove.cli.streams import terminal
from comove.errors import printable

if TYPE_CHECKING:
    from comove.data import Study, StudyProgress, StudyReport, Sweep
    from comove.data.runner import Run, Shard

StudyPath = Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (YAML).")]
OutFolder = Annotated[
    Path, typer.Option("--out", help="Folder for the runs; one that is there is gone on with.")
]
WHOLE = "1/1"


@dataclass(frozen=True)
class Running:
    """Options of the processes, machines and shard of a study's runs."""

    workers: Annotated[
        int, typer.Option(metavar="N", help="Runs at a time, each in a process of its own.")
    ] = 2
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Run only the I-th of N parts, into a folder of its own.")
    ] = WHOLE
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run on the workers of this Dask scheduler; 'local' starts one here."
        ),
    ] = None

    @property
    def part(self) -> Shard:
        """Return the shard to run."""
        from comove.data import Shard

        return Shard.parse(self.shard)

    @property
    def run(self) -> Run:
        """Return the runner. It uses processes of this machine, or the workers of a Dask scheduler."""
        from comove.data import on_processes

        on_this = on_processes(self.workers)
        if self.dask is None:
            return on_this
        from comove.data.on_dask import on_dask

        return on_dask(self.dask, self.workers)


def run_with_progress(study: Study | Sweep, out: Path, run: Run, shard: Shard) -> tuple[StudyReport, Path]:
    """Do the missing runs with progress; return the report and its path."""
    from comove.data import report_of, run_study, write_report
    from comove.results.inputs import write_inputs

    with telling_progress(out, len(shard.numbers(study.total))) as tell:
        run_study(study, out, run, shard=shard, tell=tell)
    write_inputs(out, None, files=study.files(), command=command_words())
    report = report_of(out)
    return report, write_report(report, out)


@contextmanager
def telling_progress(out: Path, total: int) -> Iterator[Callable[[StudyProgress], None]]:
    """Yield a callback that shows the number of runs in `out`. After Ctrl-C, print how to continue, and end the
    command."""
    done = 0

    def tell(progress: StudyProgress) -> None:
        nonlocal done
        if progress.done == progress.before and progress.before:
            print(f"{progress.before} of {progress.total} runs were in {out} already", file=sys.stderr)
        done = progress.done
        show(progress)

    with progress_bar(), _progress_line() as show:
        try:
            yield tell
        except KeyboardInterrupt:
            print(
                f"\ninterrupted: {done} of {total} runs are in {out}; the same command goes on",
                file=sys.stderr,
            )
            raise typer.Exit(INTERRUPTED) from None


@contextmanager
def _progress_line() -> Iterator[Callable[[Any], None]]:
    """Yield a callback that shows progress on one terminal line."""
    if not sys.stderr.isatty():
        yield lambda progress: None
        return

    def show(progress: StudyProgress) -> None:
        left = "" if progress.left is None else f", {_time(progress.left)} left"
        text = f"{progress.done} of {progress.total} runs, {progress.rate:.1f} a second{left}"
        print(f"{text:70s}\r", end="", file=terminal(), flush=True)

    try:
        yield show
    finally:
        print(file=sys.stderr)


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def statuses_text(report: StudyReport) -> str:
    """Return the counts of runs by status and of exhausted budgets."""
    text = ", ".join(f"{count} {status}" for status, count in report.statuses.items()) or "none"
    if not report.cut_short:
        return text
    return f"{text}; the time budget of {report.cut_short} ran out: they may come out otherwise on another machine"


def reason_lines(report: StudyReport) -> list[str]:
    """Return the most frequent failure reasons with counts, one a line."""
    return [printable(f"  {count:5d} x        {reason}") for reason, count in report.reasons.items()]
