"""Effect of each repair of the paper's method. The method without it runs on the same scenes with the same seeds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from comove.dmp.system import ExponentialPhase
from comove.lab.bench.sets import BenchScene, scenes_of
from comove.lab.bench.store import Run
from comove.lab.evolution.paper import OPTIMISER, Paper
from comove.lab.evolution.printed import Printed
from comove.lab.examples import example_path
from comove.lab.summaries import Interval, table, wilson
from comove.lab.systems import OwnSystem
from comove.optim import FactorForm, NoForm, PrintedForm, StaleForm
from comove.planning.method import Method
from comove.planning.objective import N_STEPS

EXAMPLES = ("wide", "narrow", "complex")
SET = "easy"
WHOLE = "paper"


def _with(**changes: Any) -> Paper:
    return Paper(optimiser=replace(OPTIMISER, **changes))


VARIANTS: dict[str, tuple[str, Method]] = {
    WHOLE: ("all repairs; (6) in the space of z", Paper()),
    "factor": ("(6) on a factor of the covariance (3), records carried along", _with(form=FactorForm)),
    "stale": ("the same, records left as they are (Arnold and Hansen, 2012)", _with(form=StaleForm)),
    "printed-form": ("(6) as printed, on the covariance", _with(form=PrintedForm)),
    "no-reduction": ("no (6): samples are drawn again from the same distribution", _with(form=NoForm)),
    "one-pass": ("samples are drawn again once, not 8 times", _with(passes=1)),
    "many-passes": ("... 100 times", _with(passes=100)),
    "no-narrowing": ("the final band from the beginning", Paper(narrowing=False)),
    "no-growing": ("the whole load from the beginning", Paper(growing=False)),
    "no-schedules": ("both", Paper(narrowing=False, growing=False)),
    "one-window": (
        "one constraint a side for the whole movement, not for each of 20 windows",
        Paper(windows=1),
    ),
    "all-instants": ("one constraint a side for each of 201 samples", Paper(windows=N_STEPS)),
    "no-centring": ("no cost of errors within the band", Paper(centring=0.0)),
    "no-threading": (
        "the demonstration as it is, not first led through the environment",
        Paper(threading=False),
    ),
    "16-basis": ("16 basis functions a coordinate, not 8", Paper(n_basis=16)),
    "exponential": ("the exponential phase of (1b)", Paper(phase=ExponentialPhase())),
    "printed": ("none of all this: Algorithm 1 with (3), (5), (6)", Printed()),
}
"""What is different, and the method."""


def systems() -> dict[str, OwnSystem]:
    """Return the variants as systems, by name."""
    return {name: OwnSystem(name, method) for name, (_, method) in VARIANTS.items()}


def scenes(count: int) -> list[BenchScene]:
    """Return the paper's three scenes, and the first easy ones. These are half planar, half spatial."""
    return [BenchScene("examples", example_path(name)) for name in EXAMPLES] + scenes_of(SET, count)


def page(runs: list[Run], budget: float) -> str:
    """Return the page about these runs, in Markdown."""
    seeds = len({run.configuration.seed for run in runs})
    count = len({run.configuration.scene for run in runs if run.configuration.set == SET})
    known = _verified(runs, WHOLE)
    rows = []
    for name, (what, _) in VARIANTS.items():
        mine = [run for run in runs if run.configuration.system == name]
        if not mine:
            continue
        times = [run.figures.first_verified for run in mine if run.status == "verified"]
        first = [seconds for seconds in times if seconds is not None]
        rows.append(
            [
                f"`{name}`",
                what,
                *(_share([run for run in mine if run.configuration.scene == scene]) for scene in EXAMPLES),
                _share([run for run in mine if run.configuration.set == SET]),
                _percent(_verified(runs, name)),
                f"{np.median(first):.1f}" if first else "none",
                "" if name == WHOLE else _verdict(_verified(runs, name), known),
            ]
        )
    head = [
        "variant",
        "what is different",
        *EXAMPLES,
        f"{count} of `{SET}`",
        "all [%]",
        "first [s]",
        "verdict",
    ]
    stale, carried = (_verdict(_verified(runs, name), known) for name in ("stale", "factor"))
    return PAGE.format(
        table=table(head, rows),
        runs=len(runs),
        seeds=seeds,
        count=count,
        budget=f"{budget:g}",
        whole=WHOLE,
        why=WHY if stale == "worse" and carried != "worse" else "",
    )


def _verified(runs: list[Run], name: str) -> Interval:
    mine = [run.status == "verified" for run in runs if run.configuration.system == name]
    return wilson(sum(mine), len(mine))


def _share(runs: list[Run]) -> str:
    return f"{sum(run.status == 'verified' for run in runs)} of {len(runs)}"


def _percent(share: Interval) -> str:
    return f"{100 * share.value:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})"


def _verdict(without: Interval, whole: Interval) -> str:
    if without.high < whole.low:
        return "worse"
    return "better" if without.low > whole.high else "no difference seen"


PAGE = """\
# What each repair of the paper's method is worth

`comove solve --method printed` runs Algorithm 1 of the paper with its equations (3), (5) and (6) line by line;
`--method paper` runs it with repairs. Here every repair is left out by itself.

```sh
make ablation
comove bench ablation --out ablated --scenes 1 --seeds 1 --budget 1
```

The first writes this page from 20 scenes and 10 seeds, in hours; the second is a quick look. This page was written by
`comove bench ablation --out ablated --scenes {count} --seeds {seeds} --budget {budget}`: the paper's three scenes,
from their recorded movements, and the first {count} of the frozen set `easy`, half of them planar and half spatial,
from straight lines; {runs} runs in all. A cell
says how many runs ended with a verified motion (the distance within 0.1 % at every instant, nothing touched, limits
kept); "all" is their share with its 95 % interval after Wilson, "first" the median time of the verified ones. Budgets
and times are processor times: what else the machine did meanwhile does not count.
The verdict compares that interval with the one of `{whole}`: "worse" or "better" where the two do not meet. Seeds on
one scene are not independent of each other, so the intervals are rather too narrow.

{table}
{why}"""

WHY = """
**Why the factor form fails and how it is mended.** Equation (6) shortens steps along the records v_j, equation (5) of
steps that violated a constraint. Arnold and Hansen's form of it divides by the length of w_j = A^-1 v_j. A record
keeps steps from before earlier reductions, which are long along the very directions that these have shortened; A^-1
makes them longer still. So w_j turns towards what has been shortened already, and the same directions are shortened
again, whatever is violated now: the distribution collapses where it should turn. In their algorithm, with one sample
an iteration and beta a tenth of c_v, records fade faster than that; here a population is drawn again several times a
generation. With records that are carried along, v_j <- A' A^-1 v_j, it does not happen (`factor`), and
the form that keeps records of z, which need not be carried along, is the same thing without decomposition (`paper`).
"""
