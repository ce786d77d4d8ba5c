"""`comove demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb

if TYPE_CHECKING:
    from comove.dmp.demonstrations import Demonstration


@verb
def demo(
    out: Annotated[Path, typer.Option(help="Folder for results and figures.")] = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
) -> int:
    """Solve the examples and draw the paper's Figures 3 to 5. The demonstration is a person's recorded movement."""
    from comove.cli.progress import progress_bar, time_spent
    from comove.dmp import DMP
    from comove.io.folders import check_target, whole_folder
    from comove.lab.examples import EXAMPLES, copy_examples, example
    from comove.lab.paper.figures import draw_demo
    from comove.model import recording_of
    from comove.planning import LeastJerk, solve
    from comove.planning.warming import require, unfinished
    from comove.results import RESULT
    from comove.view.figures import save_result

    with progress_bar():
        require(*unfinished())
    jobs = [(name, name, LeastJerk()) for name in EXAMPLES]
    jobs.append(("narrow-free", "narrow", LeastJerk(resemblance=0.0)))
    for folder, _, _ in jobs:
        check_target(out / folder, RESULT)
    recording = cast("Demonstration", recording_of(example("narrow")))
    dmp = DMP.fit(recording)
    print(
        f"demonstration: {recording.name}, {recording.n_steps} samples of a person's hand, {recording.duration:.1f} s"
    )
    solutions = {}
    for folder, name, objective in jobs:
        scene = example(name)
        taught = dmp if scene.n_dims == recording.n_dims else None
        with progress_bar(30.0) as progress:
            solution = solve(scene, demonstration=taught, seed=seed, objective=objective, progress=progress)
        with whole_folder(out / folder, RESULT) as draft:
            drawn = None if solution.followed is None else dmp
            summary = save_result(solution, draft, wall_time_s=time_spent(), demonstration=drawn)
        solutions[folder] = solution
        verdict = "verified" if solution.verified else "NOT VERIFIED"
        first = summary["time_to_first_verified_s"]
        timing = f", first motion after {1e3 * first:.0f} ms" if first is not None else ""
        clearance = 1e3 * (summary["clearance_min"] or 0.0)
        near = (
            f", {100 * solution.followed.distance:.1f} cm from what was taught" if solution.followed else ""
        )
        peak = summary["acceleration_max"]
        print(
            f"{folder:12s} {verdict}: {peak:.3f} m/s^2 at most, clearance >= {clearance:.1f} mm{near}{timing}"
        )
        if solution.interrupted:
            return INTERRUPTED
    print(
        f"\nmain result: {out / 'narrow'} (solution.npz, solution.json, motion.png, progress.png)\npictures:"
    )
    for name, caption in draw_demo(out, solutions, dmp).items():
        print(f"  {out / name}: {caption}")
    copy_examples(out)
    print(
        f"\nthe scenes lie in {out} as well: try and change them there, `comove solve narrow.yaml --out result`"
    )
    return VERIFIED if all(s.verified for s in solutions.values()) else NOT_VERIFIED
