"""`comove run`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli import options as o
from comove.cli.app import (
    INTERRUPTED,
    NOT_VERIFIED,
    VERIFIED,
    WITH_ROBOT,
    command_words,
    refuse_robot_options,
    verb,
)
from comove.cli.robot_runs import USUAL_RATE, SimulatedRun, StreamOptions, run_in_ros, run_joints
from comove.cli.texts import HANDS_ALONE
from comove.errors import OptionError

PERIOD = 0.01  # s, of control unless it is said
SHORTEST = 1e-4  # s, of control periods: ten times what the fastest controllers of arms take
MAX_STEPS = 2_000_000  # that a run may take
FORESEEN = 10.0  # work of the search for the duration of a scene that has none
LONGEST = 3.0  # times the scene's duration, that a run may last unless it is said


@verb
def run(
    scene: o.SceneFile,
    out: Annotated[Path, typer.Option(help="Folder for the record.")],
    seed: o.Seed = 0,
    period: Annotated[
        float | None, typer.Option(help="Control period [s]; 0.01 unless given, of a robot 0.004.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Control steps in a second [Hz], instead of --period.")
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds of simulated time that the run may last; 3 times the duration unless given, of a robot 4."
        ),
    ] = None,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare",
            help="Do it with every other method too, draw all side by side and verify them alike.",
        ),
    ] = False,
    robot: o.RobotName = None,
    grasp: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=WITH_ROBOT,
            help="How end effectors hold the payload in MuJoCo: weld (unless given), connect, friction.",
        ),
    ] = None,
    perturbed: Annotated[
        int | None,
        typer.Option(
            min=0,
            rich_help_panel=WITH_ROBOT,
            help="Draw friction, mass, gains and the payload's place in the end effectors from this seed.",
        ),
    ] = None,
    pictures: Annotated[
        bool, typer.Option(rich_help_panel=WITH_ROBOT, help="Draw a sheet of pictures.")
    ] = True,
    film: Annotated[
        bool | None,
        typer.Option(
            help="Draw a film (GIF, of a robot MP4 where that can be encoded); of hands unless said."
        ),
    ] = None,
    hands_alone: o.HandsAlone = False,
    *,
    ros: StreamOptions,
    limits: o.RunLimits,
    json: Annotated[bool, typer.Option("--json", help="Print the summary in JSON and nothing else.")] = False,
) -> int:
    """Execute SCENE among its moving obstacles; record and draw it. End effectors move freely, or by the robot that
    SCENE names."""
    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.texts import comparison_text, run_text
    from comove.control import Executor, Pace, write_run
    from comove.io.folders import check_target, whole_folder
    from comove.lab.modulation.comparison import Compared, write_comparison
    from comove.lab.modulation.comparison import compare as compare_all
    from comove.lab.modulation.pictures import animate_comparison, draw_comparison
    from comove.model import Scene, demonstration_of
    from comove.model.resting import require_no_rest
    from comove.planning import Budget, SceneKind, solve
    from comove.planning.warming import require
    from comove.results import RESULT
    from comove.results.inputs import write_inputs
    from comove.verification.record import verify_execution
    from comove.view.figures import animate_run, draw_run, save

    if rate is not None and period is not None:
        raise OptionError("a rate, and a period", key="--rate", way_out="give one of the two")
    if rate is not None and not 0 < rate < float("inf"):
        raise OptionError(f"{rate:g} Hz", key="--rate", way_out="give a positive number")
    if period is not None:
        check_period(period)
    if budget is not None:
        o.check_budget(budget)
    check_target(out, RESULT)
    with progress_bar():
        loaded = Scene.load(scene, limits.changes, check_ends=False)
    if o.names_robot(loaded, robot, hands_alone):
        if compare:
            raise OptionError(
                "other methods move hands alone, and the scene's robot would not be looked at",
                key="--compare",
                way_out="leave it out, or look at the --hands-alone",
            )
        if period is not None:
            rate = 1.0 / period
        how = SimulatedRun(
            rate or USUAL_RATE, grasp or SimulatedRun.grasp, perturbed, budget, pictures, film is True
        )
        if ros.wanted():
            return run_in_ros(loaded, scene, out, robot, how, ros, seed=seed, json=json)
        return run_joints(loaded, scene, out, robot, how, seed=seed, json=json)
    o.require_defaults(ros, "no robot carries the load", "leave it out, or name a --robot")
    refuse_robot_options("no robot carries the load", "leave it out, or name a --robot")
    if period is None:
        period = PERIOD if rate is None else 1.0 / rate
        check_period(period)
    pace = Pace(period=period)
    if loaded.is_timed or budget is not None:
        check_steps(budget or LONGEST * loaded.duration, period)
    with progress_bar():
        taught = demonstration_of(loaded)
        loaded = loaded.require_free_ends().in_one_way()
        require_no_rest(loaded)
        require(*SceneKind.of(loaded).jobs, "executions")
        if not loaded.is_timed:  # as long as it takes if all goes as foreseen
            planned = solve(loaded, demonstration=taught, seed=seed, budget=Budget(work=FORESEEN))
            if planned.interrupted:
                return INTERRUPTED
            loaded = planned.scene
        budget = budget or LONGEST * loaded.duration
        check_steps(budget, period)
        executor = Executor(loaded, seed=seed, pace=pace, demonstration=taught)
        record = executor.run(budget)
        report, interrupted = verify_execution(record, executor.blocker), executor.interrupted
        compared: list[Compared] = []
        if compare and not interrupted:
            compared, interrupted = compare_all(record, budget, seed=seed, pace=pace)
    with whole_folder(out, RESULT) as draft:
        save(draw_run(record), draft / "run.png")
        if film is not False:
            animate_run(record, draft / "run.gif")
        if compared:
            save(draw_comparison(compared), draft / "comparison.png")
            if film is not False:
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
        write_inputs(draft, loaded, command=command_words())
    if json:
        print((out / "run.json").read_text(encoding="utf-8"), end="")
    else:
        verdict = f"arrived, {HANDS_ALONE}" if summary["verified"] and loaded.file.robot is not None else ""
        print(run_text(summary, out, verdict) + (comparison_text(table, out) if compared else ""))
    if interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED


def check_period(period: float) -> None:
    """Raise if a control period is too short."""
    if 0 < period < SHORTEST:
        raise OptionError(
            f"{period} s is too short", key="--period", way_out=f"give {SHORTEST:g} s or more, such as 0.01"
        )


def check_steps(budget: float, period: float) -> None:
    """Raise if a run has too many steps to compute and store."""
    if budget / period > MAX_STEPS:
        raise OptionError(
            f"{budget:g} s in steps of {period:g} s are more than {MAX_STEPS:,} steps",
            key="--period",
            way_out=f"give {budget / MAX_STEPS:.2g} s or more, or less time by --budget",
        )
