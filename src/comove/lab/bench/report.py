"""Reports on a run database: tables, figures, and missing runs."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from comove.arrays import Array
from comove.errors import ResultError
from comove.io.folders import Contents, whole_folder
from comove.lab.bench.store import Configuration, Run, RunStore
from comove.lab.summaries import (
    Interval,
    mean_interval,
    median_interval,
    table,
    wilson,
)
from comove.view.figures.motion import draw_legend
from comove.view.figures.style import COLOURS, new_figure, save

REPORT, SHARES, RATIOS = "report.md", "shares.png", "costs.png"
CONTENTS = Contents("report of runs", frozenset({REPORT}), frozenset({REPORT, SHARES, RATIOS}))
REFERENCE = "comove"
STYLES = ("-", "--", "-.", ":")
FIGURES = {  # column: figure, factor
    "path [m]": ("path_length", 1.0),
    "peak acceleration [m/s²]": ("acceleration_max", 1.0),
    "peak jerk [m/s³]": ("jerk_max", 1.0),
    "squared jerk / straight": ("jerk_ratio", 1.0),
    "duration [s]": ("duration", 1.0),
    "distance error [mm]": ("distance_error_max", 1e3),
    "clearance [mm]": ("clearance_min", 1e3),
}


LEGEND = (
    "Shares of runs with their Wilson interval; where scenes were run with several seeds, the interval is by "
    "the bootstrap over scenes. Times, ratios and their intervals are medians over scenes (of the median over "
    "seeds), intervals of 95 % by the bootstrap; never counts as infinite. *First verified*: until the first "
    "motion that the judge accepts. *Near the best*: until a verified motion that costs at most 5 % more than "
    "the best one that any system has found for the scene. *Cost / best* and what follows are over the runs "
    "whose last motion is verified, so systems that solve less are shown on what they solve. *Refused* scenes "
    "are no failures in the tables; in the pictures they count as not solved."
)


@dataclass(frozen=True)
class Standing:
    """Results of a system on a set.

    Attributes
    ----------
    set, system : names; with budget and versions if a database holds several
    runs : runs that ended and were not refused
    refused : number of scenes for which the system is not made
    best : the best cost known, by scene
    """

    set: str
    system: str
    runs: tuple[Run, ...]
    refused: int
    best: dict[str, float]

    def by_scene(self, of: Callable[[Run], float]) -> dict[str, float]:
        """Return the median of a quantity over the seeds, by scene."""
        found = defaultdict(list)
        for run in self.runs:
            found[run.configuration.scene].append(of(run))
        return {scene: float(np.median(values)) for scene, values in found.items()}

    @property
    def n_verified(self) -> int:
        """Return the number of runs that ended with a verified motion."""
        return sum(run.status == "verified" for run in self.runs)

    @property
    def success(self) -> Interval:
        """Return the share of verified runs with an interval. It is Wilson's, or over scenes with several seeds
        each."""
        shares = defaultdict(list)
        for run in self.runs:
            shares[run.configuration.scene].append(run.status == "verified")
        if len(shares) == len(self.runs):
            return wilson(self.n_verified, len(self.runs))
        return mean_interval([np.mean(of) for of in shares.values()])

    def first(self, run: Run) -> float:
        """Return the time to the first verified motion [s]; infinite if there is none."""
        return run.history[0][0] if run.history else np.inf

    def near_best(self, run: Run, within: float = 0.05) -> float:
        """Return the time to a cost near the best [s], or infinity."""
        best = self.best.get(run.configuration.scene, np.inf)
        return next((seconds for seconds, cost in run.history if cost <= (1.0 + within) * best), np.inf)

    def cost_ratio(self, run: Run) -> float:
        """Return the final cost divided by the best known; infinite if unverified."""
        if run.status != "verified" or run.figures.cost is None:
            return np.inf
        return run.figures.cost / self.best[run.configuration.scene]

    def median_of(self, figure: str) -> float:
        """Return the median of a figure over the verified runs; NaN if there are none."""
        values = [getattr(run.figures, figure) for run in self.runs if run.status == "verified"]
        return float(np.median([v for v in values if v is not None] or [np.nan]))


def standings(runs: Sequence[Run]) -> list[Standing]:
    """Return the standings by set and system, in order of appearance."""
    best: dict[tuple[str, str], float] = defaultdict(lambda: np.inf)
    for run in runs:
        c = run.configuration
        for _, cost in run.history:
            best[c.set, c.scene] = min(best[c.set, c.scene], cost)
    label = _labels(runs)
    groups: dict[tuple[str, str], list[Run]] = defaultdict(list)
    for run in runs:
        groups[run.configuration.set, label(run)].append(run)
    found = []
    for name in dict.fromkeys(name for name, _ in groups):
        of_set = {scene: cost for (other, scene), cost in best.items() if other == name}
        for (other, system), those in groups.items():
            if other == name:
                tried = tuple(run for run in those if run.status != "refused")
                found.append(Standing(name, system, tried, len(those) - len(tried), of_set))
    return found


def _labels(runs: Iterable[Run]) -> Callable[[Run], str]:
    """Return a function that names a run's system, unique in the database."""
    all_of = [run.configuration for run in runs]
    versions, budgets = {c.version for c in all_of}, {c.budget for c in all_of}
    tools = defaultdict(set)
    for c in all_of:
        tools[c.system].add(c.tool)

    def label(run: Run) -> str:
        c = run.configuration
        parts = [c.system]
        parts += [f"comove {c.version}"] if len(versions) > 1 else []
        parts += [c.tool or "no version"] if len(tools[c.system]) > 1 else []
        parts += [f"{c.budget:g} s"] if len(budgets) > 1 else []
        return ", ".join(parts)

    return label


def paired_ratio(one: dict[str, float], other: dict[str, float]) -> tuple[Interval, int]:
    """Return the median of one / other, and the number of scenes. The scenes are those where both are finite."""
    one, other = _finite(one), _finite(other)
    ratios = [one[scene] / other[scene] for scene in one if other.get(scene, 0.0) > 0.0]
    return median_interval(ratios), len(ratios)


def write_report(store: RunStore, folder: str | Path) -> str:
    """Write `report.md` and its pictures; return the text.

    Raises
    ------
    ResultError
        If no run has ended, or the folder holds something else or cannot be written.
    """
    runs = list(store.runs())
    if not runs:
        raise ResultError("no run has ended yet", file=store.path, way_out="run some: comove bench run")
    found = standings(runs)
    text = report_text(runs, found, missing_of(store, runs))
    with whole_folder(folder, CONTENTS) as draft:
        (draft / REPORT).write_text(text, encoding="utf-8")
        for draw, of, file in ((draw_shares, "first", SHARES), (draw_cost_ratios, "cost_ratio", RATIOS)):
            values: dict[str, dict[str, Array]] = defaultdict(dict)
            for s in found:
                those = [getattr(s, of)(run) for run in s.runs] + [np.inf] * s.refused
                values[s.set][s.system] = np.array(those)
            save(draw(values), draft / file)
    return text


def missing_of(store: RunStore, runs: Sequence[Run]) -> list[str]:
    """Return lines on sets and systems with missing runs."""
    ended = {run.configuration.key for run in runs}
    planned: Counter[tuple[str, str]] = Counter()
    missing: dict[tuple[str, str], list[Configuration]] = defaultdict(list)
    for c in store.planned():
        planned[c.set, c.system] += 1
        if c.key not in ended:
            missing[c.set, c.system].append(c)
    return [
        f"{len(those)} of {planned[name, system]} runs of {system} on {name} "
        f"(the next: {those[0].scene}, seed {those[0].seed}, {those[0].budget:g} s)"
        for (name, system), those in missing.items()
    ]


def report_text(runs: Sequence[Run], found: Sequence[Standing], missing: Sequence[str]) -> str:
    """Return the report in Markdown."""
    lines = ["# Benchmark", "", *_about(runs)]
    if missing:
        lines += ["", "**Incomplete**: still to be run are", "", *(f"- {line}" for line in missing)]
    for name in dict.fromkeys(s.set for s in found):
        of_set = [s for s in found if s.set == name]
        lines += ["", f"## {name}", "", _success_table(of_set), "", _figure_table(of_set)]
        against = _against_table(of_set)
        lines += ["", against] if against else []
        failures = _failures(of_set)
        lines += ["", "Not verified:", "", *failures] if failures else []
    lines += ["", "## Pictures", ""]
    lines += [f"![Share of runs with a verified motion against time]({SHARES})", ""]
    lines += [f"![Share of runs within a ratio of the best cost known]({RATIOS})", "", LEGEND]
    return "\n".join(lines) + "\n"


def _about(runs: Sequence[Run]) -> list[str]:
    machines = sorted({f"{r.machine.cpu}, {r.machine.cores} cores, Python {r.machine.python}" for r in runs})
    versions = sorted({r.configuration.version for r in runs})
    budgets = sorted({r.configuration.budget for r in runs})
    seeds = len({r.configuration.seed for r in runs})
    tools = sorted({f"{r.configuration.system} {r.configuration.tool}" for r in runs if r.configuration.tool})
    lines = [
        f"{len(runs)} runs with comove {', '.join(versions)}, {seeds} seed{'' if seeds == 1 else 's'} a scene, "
        f"budget {', '.join(f'{b:g}' for b in budgets)} s, from {min(r.started for r in runs)[:16]} to "
        f"{max(r.started for r in runs)[:16]} UTC, on {'; '.join(machines)}."
    ]
    return lines + ([f"Tools: {', '.join(tools)}."] if tools else [])


def _success_table(of_set: Sequence[Standing]) -> str:
    columns: dict[str, Callable[[Standing], str]] = {
        "system": lambda s: s.system,
        "verified": lambda s: f"{s.n_verified}/{len(s.runs)}",
        "success": lambda s: _percent(s.success) if s.runs else "-",
        "refused": lambda s: str(s.refused or "-"),
        "first verified [s]": lambda s: _over_scenes(s.by_scene(s.first), "never"),
        "near the best [s]": lambda s: _over_scenes(s.by_scene(s.near_best), "never"),
        "cost / best": lambda s: _over_scenes(_finite(s.by_scene(s.cost_ratio)), "-"),
    }
    return table(list(columns), [[cell(s) for cell in columns.values()] for s in of_set])


def _percent(share: Interval) -> str:
    return f"{100 * share.value:.0f} % ({100 * share.low:.0f}-{100 * share.high:.0f})"


def _over_scenes(by_scene: dict[str, float], otherwise: str) -> str:
    return _with_interval(median_interval(list(by_scene.values())), otherwise)


def _finite(by_scene: dict[str, float]) -> dict[str, float]:
    return {scene: value for scene, value in by_scene.items() if np.isfinite(value)}


def _figure_table(of_set: Sequence[Standing]) -> str:
    rows = [
        [s.system, *(_number(factor * s.median_of(figure)) for figure, factor in FIGURES.values())]
        for s in of_set
    ]
    return table(["system", *FIGURES], rows)


def _against_table(of_set: Sequence[Standing]) -> str:
    """Return a table of systems against the reference, scene by scene. It is empty without a reference."""
    reference = next((s for s in of_set if s.system.split(",")[0] == REFERENCE), None)
    others = [s for s in of_set if s is not reference]
    if reference is None or not others:
        return ""
    rows = []
    for s in others:
        mine, first = s.by_scene(s.first), reference.by_scene(reference.first)
        costs = paired_ratio(s.by_scene(s.cost_ratio), reference.by_scene(reference.cost_ratio))
        ratios = [
            f"{_with_interval(ratio, '-')}, {n} scenes" for ratio, n in (paired_ratio(mine, first), costs)
        ]
        solved, by_reference = (_finite(of).keys() & mine.keys() & first.keys() for of in (mine, first))
        rows.append([s.system, *ratios, str(len(solved - by_reference)), str(len(by_reference - solved))])
    head = [
        f"against {reference.system}",
        "first verified, ratio",
        "final cost, ratio",
        "solved by it alone",
        "by comove alone",
    ]
    return table(head, rows)


def _failures(of_set: Sequence[Standing], most: int = 12) -> list[str]:
    """Return a line for each unverified run, `most` per system."""
    lines = []
    for s in of_set:
        failed = [run for run in s.runs if run.status != "verified"]
        for run in failed[:most]:
            c = run.configuration
            lines.append(f"- {s.system}, {c.scene}, seed {c.seed}: {run.status}: {run.message[:200]}")
        if len(failed) > most:
            lines.append(f"- {s.system}: {len(failed) - most} more")
    return lines


def _with_interval(interval: Interval, otherwise: str) -> str:
    if np.isnan(interval.value):
        return "-"
    if not np.isfinite(interval.low):
        return otherwise
    value, low, high = (_number(x) if np.isfinite(x) else otherwise for x in interval)
    return f"{value} ({low}-{high})"


def _number(value: float) -> str:
    """Format a number with three digits.

    >>> _number(0.012345), _number(1234.5)
    ('0.0123', '1230')
    """
    if np.isnan(value):
        return "-"
    text = f"{value:.3g}"
    return f"{float(text):.0f}" if "e+" in text else text


def draw_shares(times: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw the share of verified runs against time, by set. It is a cactus plot with swapped axes.

    Parameters
    ----------
    times : by set and system, array, shape (n_runs,), time to the first verified motion, infinite if none [s]
    """
    finite = [t for of in times.values() for runs in of.values() for t in runs[np.isfinite(runs)]]
    least = max(1e-4, 0.5 * min(finite, default=0.0))  # below, no times are drawn
    figure = _draw_below(times, least, 1.5 * max(finite, default=1.0))
    for axes in figure.axes:
        axes.set(xscale="log", xlabel="time to the first verified motion [s]")
    return figure


def draw_cost_ratios(ratios: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw the share of runs below a cost ratio, by set. The ratio is that of the final cost to the best known.

    Parameters
    ----------
    ratios : by set and system, array, shape (n_runs,), ratios of cost, infinite where nothing is verified
    """
    largest = 10.0
    figure = _draw_below(ratios, 1.0, largest)
    for axes in figure.axes:
        axes.set(xscale="log", xlabel="final cost / best cost known", xlim=(0.98, largest))
        axes.set_xticks([1, 1.5, 2, 3, 5, 10], ["1", "1.5", "2", "3", "5", "10"])
        axes.minorticks_off()
    return figure


def _draw_below(values: Mapping[str, Mapping[str, Array]], least: float, most: float) -> Figure:
    """Draw the share of runs below a limit, one panel a set."""
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    figure = new_figure(4.2 * len(values) + 0.6, 4.0)
    panels = figure.subplots(1, len(values), squeeze=False, sharey=True)[0]
    for axes, (title, of) in zip(panels, values.items(), strict=True):
        for name, runs in of.items():
            ordered = np.sort(runs[runs <= most])
            share = np.arange(len(ordered) + 1) / len(runs)
            k = names.index(name)
            axes.step(
                np.concatenate([[least], np.maximum(ordered, least), [most]]),
                np.append(share, share[-1]),
                where="post",
                color=COLOURS[k % len(COLOURS)],
                linestyle=STYLES[k // len(COLOURS) % len(STYLES)],
                label=name,
            )
        axes.set(title=title, ylim=(-0.02, 1.02))
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("share of runs")
    draw_legend(figure, min(5, max(1, len(names))))
    return figure
