"""Reproduction of the paper: all runs and one Markdown page. The page holds pictures and claims."""

from __future__ import annotations

import resource
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comove._version import __version__
from comove.io.folders import Contents
from comove.lab.examples import example
from comove.lab.paper import tables
from comove.lab.paper.claims import Claim, ClaimFinding, ClaimVerdict, judge_all
from comove.lab.paper.figures import (
    BAXTER,
    FAILED,
    FIGURES,
    draw_all,
    failures,
    shown_failures,
    verdict,
)
from comove.lab.paper.jobs import CONTENDERS, Outcome, title_of
from comove.lab.paper.measures import count_verified, measure_motion
from comove.lab.paper.runs import (
    AT_ONCE,
    GAIT,
    INITIAL,
    RECORDING_SEEDS,
    SCENES,
    STORY,
    SWING,
    TWO,
    ReproductionPlan,
    Runs,
    run_everything,
)
from comove.lab.summaries import table
from comove.model.motion import CoordinatedMotion
from comove.view.figures.motion import N_STATES

LENGTH, TOLERANCE = "200 mm", "0.2 mm"  # of the bar in the three scenes
PAGE, FOLDER, RUNS = "paper.md", "paper", "runs.csv"
CONTENTS = Contents(
    "reproduction",
    frozenset({PAGE}),
    frozenset({PAGE, *(f"{FOLDER}/{name}" for name in (*FIGURES, *BAXTER.values(), *FAILED.values(), RUNS))}),
)
"""Contents of the folder that is written."""


@dataclass(frozen=True)
class Effort:
    """Computing effort of a reproduction.

    Attributes
    ----------
    seconds, processor : wall time, and time of all processors together [s]
    processes : number of processes at the same time
    """

    seconds: float
    processor: float
    processes: int


def reproduce(
    folder: Path, seeds: int, *, processes: int, tell: Callable[[str], None] = lambda words: None
) -> Counter[ClaimVerdict]:
    """Write the page, its figures and all runs into a folder. Return the number of claims by finding.

    Parameters
    ----------
    seeds : number of seeds in the large comparison
    processes : number of runs at the same time
    tell : function called with words on the progress
    """
    started, before = time.perf_counter(), _processor_time()
    runs = run_everything(ReproductionPlan(seeds), processes, tell)
    tell("pictures")
    draw_all(runs, folder / FOLDER)
    (folder / FOLDER / RUNS).write_text(tables.all_runs(runs), encoding="utf-8")
    findings = judge_all(runs)
    effort = Effort(time.perf_counter() - started, _processor_time() - before, processes)
    (folder / PAGE).write_text(write_page(runs, findings, effort, FOLDER), encoding="utf-8")
    return Counter(finding.verdict for _, finding in findings)


def _processor_time() -> float:
    """Return the processor time of this process and ended children [s]."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def write_page(
    runs: Runs, findings: Sequence[tuple[Claim, ClaimFinding]], effort: Effort, folder: str
) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    findings : findings of all claims
    effort : effort so far
    folder : path of the figures relative to the page
    """
    parts = [
        _head(runs, findings, effort, folder),
        _figures(runs, folder),
        _two_hands(runs, folder),
        _baxter(runs, folder),
        _systems(runs, folder),
        _story(runs, folder),
        _movements(runs),
        _recordings(runs, folder),
        _sensitivity(runs),
        CLAIMS_TEXT + "\n\n" + tables.claims_table(findings),
        ERRATA,
    ]
    return "\n\n".join(_wrapped(block) for part in parts for block in part.strip().split("\n\n")) + "\n"


def _wrapped(block: str, width: int = 118) -> str:
    """Wrap a paragraph into lines of at most `width`; return anything else unchanged."""
    if block.startswith(("#", "|", "!", "- ", "```")):
        return block
    return textwrap.fill(" ".join(block.split()), width, break_long_words=False, break_on_hyphens=False)


def _head(runs: Runs, findings: Sequence[tuple[Claim, ClaimFinding]], effort: Effort, folder: str) -> str:
    counts = Counter(finding.verdict for _, finding in findings)
    verdicts = ", ".join(f"{counts[v]} {v.value}" for v in ClaimVerdict)
    rows = []
    for who in CONTENDERS:
        found = [runs.measures("story", scene=scene, who=who) for scene in SCENES]
        rows.append([who, *map(count_verified, found)])
    return f"""
# The paper, reproduced

*Optimize and coordinate multiple DMPs under constraints to achieve a collaborative manipulation task*: every
experiment in simulation and every statement on results, beside the systems that the paper names. Everything below,
verdicts included, was computed by one command:

```sh
make reproduce
comove reproduce --seeds 2 --out look
```

The first writes this page, the second is a quick look at it. This page: version {__version__},
{runs.plan.seeds} seeds,
{len(runs.outcomes)} solutions and {len(runs.compared)} executions, {effort.processes} at a time, in
{effort.seconds / 60:.1f} minutes on the wall and {effort.processor / effort.processes / 60:.1f} minutes of
processor time each.
Budgets and times below are processor times: what else the machine did meanwhile does not count.
[Every run]({folder}/runs.csv) is one line of a table.

{_review(runs).strip()}

**Statements of the paper**: {len(findings)}; {verdicts} ([all of
them](#what-the-paper-says-and-what-this-run-says)).

**Verified** motions by method and scene. "Verified" is what an independent [judge](verification.md) says: ends
reached, limits kept, the distance within {TOLERANCE} of {LENGTH} and nothing touched, at every
instant.

{table(["method", *SCENES], rows)}
"""


def _figures(runs: Runs, folder: str) -> str:
    """Return the section on Figures 1 to 3."""
    first = runs.one("figure 1").measures
    straight = measure_motion(CoordinatedMotion.straight(example("wide")))
    initial, given, alone = (
        {scene: runs.one(purpose, scene=scene).measures for scene in INITIAL}
        for purpose in ("figure 3", "given", "straight")
    )
    return f"""
## Figures

The paper's numbers of figures are kept. Green circles are starts, red squares goals. A load is black; orange where
the distance of its ends is off by more than the tolerance, red where it touches something. The paper gives no
coordinates; the scenes are `wide`, `narrow` and `complex` of the package. In Figures 3 to 6 the weight of
velocities in (4) is {GAIT["velocity"]:g}, accelerations are limited to {GAIT["acceleration"]:g} m/s², and the band
of the distance is {1e3 * runs.plan.band:g} mm wide to either side. The paper says none of these.

### Figure 1: the pipeline

![From a recorded movement to a verified motion of two hands, in four steps]({folder}/figure1.png)

A person's handwriting; the one DMP that was learned from it; the same DMP modulated to the ends of both hands, on
one phase, before it knows of the wall; and what the optimiser makes of it when its shape still counts
(`--objective paper --resemblance {runs.plan.resemblance:g}`): {verdict(first)}, J =
{first.cost:.3f}. About the same by hand:
`comove solve narrow.yaml --out near --objective paper --resemblance {runs.plan.resemblance:g}`.

### Figure 2: a moving obstacle

![Two rules of one matrix for both hands, and comove's execution, as a disc crosses the way]({folder}/figure2.png)

Left: the modulation matrix of whichever hand is nearest to the disc, on both hands, as the paper proposes: it
{_outcome(runs, "nearest hand's matrix")}. Middle: the matrix of whichever point of hands and load
is nearest, which is
ours: it {_outcome(runs, "same matrix on all")}. Right: comove's [execution](execution.md) with
motions that are known.
All follow a straight primitive whose bar turns by a quarter. Numbers tell what was where at the same time. With three
more ways to do it (`comove run turning.yaml --out beside --compare`); tolerance of the distance
{1e3 * runs.compared[0].tolerance:g} mm:

{tables.encounters_table(runs)}

### Figure 3: the initial movement

![The path of one hand through two environments, and the same given to both hands]({folder}/figure3.png)

Left: movements of a library of a dozen handwritten shapes, combined and optimised for one hand, after [6]. Right: the
same DMP for both hands, before any optimisation. Above the wide passage: {verdict(initial["wide"])}, J =
{initial["wide"].cost:.3f}; given to both hands: {verdict(given["wide"])}. It asks for little: straight lines of both
hands are {verdict(straight)}. The searches of Figures 4, 5, 6a and 6b by the paper's method and after [22] begin with
it. Below the complex environment, where the straight line of one hand ends as: {verdict(alone["complex"])}. The
combination: {verdict(initial["complex"])}, J = {initial["complex"].cost:.3f}; given to both hands:
{verdict(given["complex"])}. The searches of Figure 6c begin with it. [By hand](#figures-3-to-6-by-hand); the whole
chain in one command, with a library of one's own: `comove solve SCENE --out both --library DIR --method paper`.
"""


def _two_hands(runs: Runs, folder: str) -> str:
    """Return the section on Figures 4 to 6."""
    paper, comove = (
        {scene: runs.one("figure 4", scene=scene, who=who) for scene in ("wide", "narrow")}
        for who in ("paper", "comove")
    )
    along, exact = (runs.along("figure 4", scene="narrow", who=who) for who in ("paper", "comove"))
    free = runs.one("figure 6", scene="narrow").measures
    complex_paper, complex_comove = (
        runs.one("figure 6", scene="complex", who=who).measures for who in ("paper", "comove")
    )
    return f"""
### Figure 4: wide and narrow passage

![Paths of two hands through both passages, by the paper's method and by comove]({folder}/figure4.png)

Above the paper's method (`--method paper`), below comove's default. The bar is {LENGTH} long, the gaps are
300 and 100 mm wide: in the narrow one it must turn, by {np.rad2deg(paper["narrow"].measures.turn):.0f}° (paper's
method) and {np.rad2deg(comove["narrow"].measures.turn):.0f}° (comove) at most.

| | J wide | J narrow | squared jerk wide [m²/s⁵] | squared jerk narrow [m²/s⁵] |
| --- | --- | --- | --- | --- |
| paper's method | {_pair(paper, "cost")} | {_pair(paper, "jerk")} |
| comove | {_pair(comove, "cost")} | {_pair(comove, "jerk")} |

### Figure 5: objective and constraint

![Objective and constraint along the motions of Figure 4b]({folder}/figure5.png)

Along the motions of Figure 4b, left the paper's method, right comove. Above (5a): the objective begins at
{along.at_start:.2f} and ends at {along.at_end:.0e} (paper's method) and {exact.at_end:.0e} (comove). Below (5b):
the paper's method may leave the distance by a band, and does, by {1e3 * along.error:.2f} mm at most; comove's
coordinates hold it, to {exact.error:.0e} m.

### Figure 6: every state with the bar

![States with the bar, with and without the constraint, and in the complex environment]({folder}/figure6.png)

Two hands at {N_STATES} equal times; "verified" with the band of {1e3 * runs.plan.band:g} mm. (a) Paper's
method: {verdict(paper["narrow"].measures)}. (b) Both hands taught at once in the wide passage, optimised in the
narrow one without the constraint, after [22]: {verdict(free)}. Their teacher is comove, whose motion of Figure 4a
stands in for a person with two hands. (c) The complex environment, from the combination of Figure 3:
{verdict(complex_paper)} by the paper's method, {verdict(complex_comove)} by comove.

### Figures 3 to 6 by hand

In a folder with the package's scenes (`comove demo` leaves them in `demo`):

```bash
{_by_hand(runs.plan.band)}
```

Comove's own rows: the same without `--method paper`. `taught` is Figure 4a by comove, and what Figure 6b begins with.
"""


def _by_hand(band: float, budget: float = 300.0) -> str:
    """Return the commands for Figures 3 to 6. The budget suffices for slow machines."""
    return f"""
how="--objective paper --weights 1,{GAIT["velocity"]:g},10 --budget {budget:g}"
how="$how --acceleration {GAIT["acceleration"]:g}"
banded() {{  # a scene with the band of the figures, and the movement of an earlier result to begin with
  grep -v ^demonstration $1.yaml
  echo "demonstration: {{file: $2/solution.npz}}"
  echo "constraints: [{{type: distance, between: [left, right], distance: 0.2, tolerance: {band:g}}}]"
}}
grep -v ^demonstration complex.yaml > bare.yaml
comove solve wide.yaml --out initial --method single $how           # Figure 3, above
comove solve bare.yaml --out winding --method single $how           # Figure 3, below
banded wide initial > banded_wide.yaml
banded narrow initial > banded_narrow.yaml
banded complex winding > banded_complex.yaml
comove solve banded_wide.yaml --out figure4a --method paper $how
comove solve banded_narrow.yaml --out figure4b --method paper $how  # Figures 5 and 6a as well
comove solve banded_complex.yaml --out figure6c --method paper $how
comove solve banded_wide.yaml --out taught $how
banded narrow taught > untied.yaml
comove solve untied.yaml --out figure6b --method unconstrained $how
""".strip()


def _baxter(runs: Runs, folder: str) -> str:
    """Return the section on Figures 7 to 9. If they cannot be simulated, it holds the reason."""
    if runs.absent:
        return f"""
### Figures 7 to 9: Baxter

Not here: {runs.absent}.
""".strip()
    pictures = [
        f"![Baxter carries the stick through the {t.passage.scene} passage, {title_of(t.passage.who)}, at five "
        f"times, from the front and from above]({folder}/{BAXTER[t.passage.scene, t.passage.who]})"
        for t in runs.transports
        if t.picture
    ]
    shown = "\n\n".join(pictures) or "Pictures cannot be drawn on the machine that made this page."
    return f"""
### Figures 7 to 9: Baxter

In MuJoCo, in place of the physical robot of Figures 8 and 9; Figure 7 is the upper row of each. A stick of 400 mm,
held at its ends, goes between two posts that stand 440 mm (Figure 8) and 220 mm (Figure 9) apart, from middle to
middle. The hands' movements are found by the paper's method, which asks the arms about every sample, or by comove;
arms follow them exactly, the joints are judged, and servos that know nothing of the load carry them out. The band of
the distance is 0.4 mm; the stick is fixed in the grippers. Both scenes are ours: arms reach both ends, and in the
second the stick must turn. Seeds from {runs.plan.fresh} on, with which nothing was tuned; drawn is the first. By
hand:
`comove solve baxter_narrow.yaml --method paper --weights 1,{GAIT["velocity"]:g},10 --out arms`, then
`comove simulate arms`.

{shown}

{tables.transports_table(runs)}
""".strip()


def _systems(runs: Runs, folder: str) -> str:
    return f"""
## What each of the other systems breaks

![Four other systems at the narrow passage]({folder}/systems.png)

The narrow passage from straight lines, [each system](compared.md) as the command line runs it (`comove solve` with
`--method unconstrained`, `leader-follower`, `speed-scaled`, `task-priority` on `narrow` without its demonstration).
The coupling of [7] is learned over 20 epochs. In the table the other columns begin with the scene's recorded
movement, at the same settings as the [large comparison](#over-seeds). A distance may be off by {TOLERANCE}.
Hands are free in all of them. [8] beside a human whose effort and variance change over 100 cycles:
[compared](compared.md#speed-scaled).

{tables.systems_table(runs)}

[22] is made for movements that both hands were taught at once, holding the load. Here the middle of the bar follows
handwriting ({AT_ONCE[0]}) and its direction other handwriting ({AT_ONCE[1]}, up to {np.rad2deg(SWING):.0f}° aside),
led from rest to rest; recordings 0 to {runs.plan.at_once - 1} of both shapes, settings and band of the figures. Then
[22] optimises it, where nothing is in the way, and in both passages:

{tables.at_once_table(runs)}
{_with_joints(runs)}

No wall is what [7] was made for: two hands that were taught different movements, here {TWO[0]} and {TWO[1]} of
people's handwriting, and nothing in the way but the border of the workspace, which it does not see either. The error
of the distance by epoch is its root mean square; at the end {TOLERANCE} are allowed at every instant. More pairs:
[compared](compared.md#leader-follower).

![The left hand leads, the right hand leads, both follow]({folder}/roles.png)

{tables.roles_table(runs)}
"""


def _with_joints(runs: Runs) -> str:
    """Return the paragraph on [5] with a robot's joints, if any."""
    if runs.absent:
        return ""
    return f"""
The source of [5] has a robot's joints. With those of Baxter, in the passages of Figures 8 and 9, from the scene's
recorded movement and from straight lines, without random numbers (`comove solve baxter_wide.yaml --method
task-priority --out joints`): its programmes run over the rates of all joints, links keep clear, and what is left to
choose draws the joints to where they began.

{tables.with_joints_table(runs)}
"""


def _story(runs: Runs, folder: str) -> str:
    fixed = " and ".join(f"`{who}`" for who, contender in CONTENDERS.items() if not contender.random)
    movements = ", ".join(f"{movement} on `{scene}`" for scene, movement in STORY.items())
    shown = "\n\n".join(f"### {scene}\n\n{tables.story_table(runs, scene)}" for scene in SCENES)
    return f"""
## Over seeds

![Measures by method and scene]({folder}/story.png)

Every method on every scene, {runs.plan.seeds} seeds each, from the same recorded movements ({movements}). {fixed}
draw
no random numbers and run once. Marks are medians, bars their 95 % bootstrap intervals; for shares of successes,
intervals after Wilson. A distance may be off by {TOLERANCE}. Measures are those of the motion handed out, verified or
not. Smoothness is the largest
acceleration of a hand and the squared jerk of both hands, integrated over the motion of 10 s. J rewards early
arrival, and the scenes limit no acceleration: on `narrow`, `comove` accelerates by {_fastest(runs, "comove")} m/s²
in the median, the paper's method by {_fastest(runs, "paper")} m/s². `comove, 1 m/s²` is the same method
under a limit of 1 m/s². Brackets hold intervals; "none" says that no run has the measure. Every run is
stopped after {runs.of("story")[0].job.budget:g} s of processor time.

{shown}
"""


def _movements(runs: Runs) -> str:
    return f"""
## Several movements

A straight line of minimum jerk, a smooth synthetic curve, and recorded handwriting (LASA), on the same scenes:
verified runs (a distance may be off by {TOLERANCE}) and the median of J over them.
`comove` keeps the movement's shape where it can (`--objective
paper --resemblance {runs.plan.resemblance:g}`: J then holds a term for it, and is larger); without the planner, and
for the
paper's method, the movement is where the search begins. A run has {runs.of("movements")[0].job.budget:g} s of
processor time. {_stopped(runs)}

{tables.movements_table(runs)}

"""


def _recordings(runs: Runs, folder: str) -> str:
    """Return the section on the paper's method from recordings. It shows the failed attempts."""
    parts = []
    for scene in RECORDING_SEEDS:
        failed, n = failures(runs, scene), len(runs.of("recordings", scene=scene))
        if not failed:
            parts.append(f"On `{scene}` none of {n} failed, so there is nothing to show.")
            continue
        parts.append(f"On `{scene}` {len(failed)} of {n} failed:")
        if shown_failures(runs, scene):
            parts.append(f"![Failed attempts on {scene}, by recording]({folder}/{FAILED[scene]})")
        parts.append(tables.failures_table(runs, scene))
    text = "\n\n".join(parts)
    return f"""
## Any recording

The paper's method from ten recordings that nobody chose, the first of the set in alphabetical order, with the
settings and the time of the table before. On `triangle` three hands begin with the recording laid into the
plane of x and y.
Verified runs, and the median of J over them; a distance may be off by a thousandth of it. By hand: `comove solve
complex.yaml --out one --method paper --budget {runs.of("recordings")[0].job.budget:g}`, with `demonstration: {{lasa:
LShape}}` in the file; in space `{{lasa: LShape, plane: xy}}`.

{tables.recordings_table(runs)}

Failed attempts are drawn, of each recording the first: what the search had when time was up, thick where it is
deepest in something and where a distance is most off; `triangle` is seen from above. The tables say of each what the
judge says. Where generations are 0, no way of the middle of the hands through the environment was found
("threading" in [the list
of repairs](ablation.md)); otherwise the band was still being narrowed, or the load did not get free.

{text}
"""


def _sensitivity(runs: Runs) -> str:
    return f"""
## Sensitivity of the paper's method

In the narrow passage from the recorded movement, with one thing changed at a time, {runs.plan.sensitivity}
seeds each at
most, as long as above; medians over what is verified, with the band of its line as tolerance.
Unchanged: a band of {TOLERANCE}, a gap of half the length,
8 basis functions, c_vel = 0.01.

{tables.sensitivity_table(runs)}
"""


CLAIMS_TEXT = """
## What the paper says, and what this run says

Quotes are the paper's. A verdict is what a function of this run's numbers returns, by the rule in the last column.
"Reproduced with a remark": it holds, but not as it is said, or not by the paper's method alone. "Holds by
construction": it cannot be otherwise, and a run only shows that nothing is broken. What no
software can test is called
so. "Verified" is with a thousandth of the distance (0.2 mm of 200 mm) over seeds, movements and recordings, and with
2 mm in Figures 3 to 6.
""".strip()

ERRATA = """
## Errata of the paper

What had to be read otherwise than it is printed:

- (1b) has lost a minus sign: the phase decays.
- (2) knows no scaling by the goal; here the ends are exact for all weights instead ([primitives](primitives.md)).
- (4) tests the hands alone against obstacles. A carried bar is tested along its whole length, and
  between samples too.
- (6) is not invariant to scale and can lose positive definiteness. Its factor form cannot
  ([optimisers](optimisers.md)).
- (7b) as two inequalities has no interior: resampling until nothing is violated needs a band.
- Algorithm 1, lines 10 and 11: c_mu belongs to c_cov. The 1/rho² of (3) belongs to older constants than c_mu and
  c_cov: with both, what (3) adds does not make up for what it takes away.
- II-B maximises J, (7a) minimises it, and (4) is a cost: it is minimised.
"""


def _review(runs: Runs) -> str:
    """Return the paragraph with the most important facts for a reviewer."""
    printed, paper = runs.measures("printed", who="printed"), runs.measures("story", who="paper")
    others = runs.of("recordings", scene="complex")
    ours, free = runs.measures("story", who="comove"), runs.measures("story", who="unconstrained [22]")
    return f"""
**What a reviewer needs to know.** The paper gives no code, no coordinates, no weights of (4), no numbers of samples,
basis functions or constraints, and no band for (7b). Assumed here: scenes of one metre with a bar of {LENGTH}, 8
basis functions a coordinate, 16 samples a generation, hard obstacles, a band of {1e3 * runs.plan.band:g} mm in
the figures and of {TOLERANCE} in the tables. The constrained CMA-ES as printed (`--method printed`) is verified in
{count_verified(printed)}
runs. The same idea with repairs, each of which is [left out by itself](ablation.md) elsewhere (`--method paper`): in
{count_verified(paper)}, within a band, as sampling cannot hold an equality; from [ten recordings](#any-recording)
that nobody chose, in {others[0].job.budget:g} s, in {count_verified([o.measures for o in others])} on `complex`.
comove's default holds
it by its coordinates:
{count_verified(ours)}. Joint demonstration without the constraint [22]: {count_verified(free)}. A
matrix of the nearest hand on both
hands {_outcome(runs, "nearest hand's matrix")}. No physical robot was used: Figures 7 to 9 are simulated.
"""


def _outcome(runs: Runs, method: str) -> str:
    e = runs.encounter(method)
    touched = f"is hit by {-1e3 * e.clearance:.0f} mm" if e.clearance < 0 else "touches nothing"
    return f"{touched}, and the distance is off by {1e3 * e.distance_error:.2g} mm"


def _fastest(runs: Runs, who: str) -> str:
    found = runs.measures("story", scene="narrow", who=who)
    return f"{np.median([m.acceleration for m in found]):.2g}"


def _stopped(runs: Runs) -> str:
    """Describe the effort of unverified runs in the table of movements."""
    used = [m.total for m in runs.measures("movements") if not m.verified]
    if not used:
        return ""
    return (
        f"The {len(used)} that ended without a verified motion had had {np.median(used):.1f} s in the median: "
        "with more they may succeed."
    )


def _pair(outcomes: Mapping[str, Outcome], name: str) -> str:
    return " | ".join(f"{getattr(outcomes[scene].measures, name):.3g}" for scene in ("wide", "narrow"))
