"""`comove run`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb
from comove.cli.changes import Acceleration, Clearance, Duration, Speed, changes_of
from comove.cli.solve import check_budget
from comove.errors import OptionError

SHORTEST = 1e-4  # s, of control periods: ten times what the fastest controllers of arms take
MAX_STEPS = 2_000_000  # that a run may take
PLANNING = 10.0  # s, for the duration of a scene that leaves it out
LONGEST = 3.0  # times the scene's duration, that a run may last unless it is said


@verb
def run(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder for the record.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    period: Annotated[float, typer.Option(help="Control period [s].")] = 0.01,
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds of simulated time that the run may last; 3 times the duration unless given."
        ),
    ] = None,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare", help="Do it with every other method too, draw all side by side and judge them alike."
        ),
    ] = False,
    duration: Duration = None,
    speed: Speed = None,
    acceleration: Acceleration = None,
    clearance: Clearance = None,
    json: Annotated[bool, typer.Option("--json", help="Print run.json and nothing else.")] = False,
) -> int:
    """Execute SCENE step by step among its moving obstacles, record and draw it."""
    from comove.cli.progress import progress_bar, time_spent
    from comove.execution import Executor, Pace, write_run
    from comove.experiments.modulation.comparison import compare as compare_all
    from comove.experiments.modulation.comparison import write_comparison
    from comove.experiments.modulation.pictures import animate_comparison, draw_comparison
    from comove.planning import load_kernels, solve
    from comove.results import check_target, whole_folder
    from comove.scenes import Scene, demonstration_of
    from comove.verification.record import verify_execution
    from comove.views import animate_run, draw_run, save

    check_period(period)
    pace = Pace(period=period)
    if budget is not None:
        check_budget(budget)
    check_target(out)
    loaded = Scene.load(scene, changes_of(duration, speed, acceleration, clearance=clearance))
    if loaded.is_timed or budget is not None:
        check_steps(budget or LONGEST * loaded.duration, period)
    with progress_bar():
        load_kernels(loaded.n_dims, bool(loaded.moving.any()))
        if not loaded.is_timed:  # as long as it takes if all goes as foreseen
            planned = solve(loaded, demonstration=demonstration_of(loaded), seed=seed, budget=PLANNING)
            if planned.interrupted:
                return INTERRUPTED
            loaded = planned.scene
        budget = budget or LONGEST * loaded.duration
        check_steps(budget, period)
        executor = Executor(loaded, seed=seed, pace=pace, demonstration=demonstration_of(loaded))
        record = executor.run(budget)
        report, interrupted, compared = verify_execution(record, executor.blocker), executor.interrupted, []
        if compare and not interrupted:
            compared, interrupted = compare_all(record, budget, seed=seed, pace=pace)
    with whole_folder(out) as draft:
        save(draw_run(record), draft / "run.png")
        animate_run(record, draft / "run.gif")
        if compared:
            save(draw_comparison(compared), draft / "comparison.png")
            animate_comparison(compared, draft / "comparison.gif")
            table = write_comparison(draft, compared, seed=seed)
        summary = write_run(
            draft,
            record,
            report,
            executor.log,
            seed=seed,
            interrupted=interrupted,
            wall_time_s=time_spent(),
        )
    if json:
        print((out / "run.json").read_text(encoding="utf-8"), end="")
    else:
        print(run_text(summary, out) + (comparison_text(table, out) if compared else ""))
    if interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED


def check_period(period: float) -> None:
    """Raise if a control period is too short to be kept."""
    if 0 < period < SHORTEST:
        raise OptionError(
            f"{period} s is too short", key="--period", way_out=f"give {SHORTEST:g} s or more, such as 0.01"
        )


def check_steps(budget: float, period: float) -> None:
    """Raise if a run has more steps than can be computed and stored."""
    if budget / period > MAX_STEPS:
        raise OptionError(
            f"{budget:g} s in steps of {period:g} s are more than {MAX_STEPS:,} steps",
            key="--period",
            way_out=f"give {budget / MAX_STEPS:.2g} s or more, or less time by --budget",
        )


def run_text(summary: dict[str, Any], folder: Path) -> str:
    """Return a readable summary of a run."""
    verdict = "arrived, verified" if summary["verified"] else "NOT VERIFIED"
    clearance = summary["clearance_min"]
    nothing = "nothing to hit"
    lines = [f"{summary['scene']}: {verdict} (seed {summary['seed']}) after {summary['duration_s']:.2f} s"]
    lines += [f"  - {reason}" for reason in summary["reasons"]]
    lines += [f"  {event['time']:6.2f} s  {event['what']}" for event in summary["events"]]
    lines += [
        f"  certified clearance     {nothing if clearance is None else f'{1e3 * clearance:.2f} mm at every instant'}",
        f"  distance error          {summary['distance_error_max']:.3g} m",
        f"  goal                    missed by {1e3 * summary['end_error']:.3g} mm",
        f"  speed, acceleration     {summary['speed_max']:.4g} m/s, {summary['acceleration_max']:.4g} m/s^2 at most",
        f"  control step            {1e3 * summary['control_s_median']:.3g} ms, 99.9 % within "
        f"{1e3 * summary['control_s_p999']:.3g} ms",
        f"  record                  {folder / 'run.npz'}, drawn in {folder / 'run.png'} and {folder / 'run.gif'}",
    ]
    return "\n".join(lines)


def comparison_text(table: dict[str, Any], folder: Path) -> str:
    """Return a readable table of all methods on one scene."""
    lines = ["", "", f"  {'':24s}{'distance off':>14s}{'clearance':>14s}{'goal missed by':>18s}{'time':>10s}"]
    for row in table["methods"]:
        clearance = "-" if row["clearance_min"] is None else f"{1e3 * row['clearance_min']:.2f} mm"
        lines.append(
            f"  {row['method']:24s}{1e3 * row['distance_error_max']:11.3f} mm{clearance:>14s}"
            f"{1e3 * row['end_error']:15.3f} mm{row['duration_s']:8.2f} s"
        )
    lines += ["", f"  side by side            {folder / 'comparison.png'} and {folder / 'comparison.gif'}"]
    return "\n".join(lines)
