"""Scaling of times with problem size and difficulty.

Manipulators, basis functions, time steps and obstacles vary. Two times are measured: that of one generation of the
search (rollouts of a population and their evaluation), which is repeated in a search, and that of a whole `solve`,
which also depends on planning, certificates and chance. For each an exponent e is fitted, ``time ~ x^e``, once over
all points and once over the larger half of them, where constant parts weigh less. All times are processor times, so
that other work on the machine has little influence.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from comove.arrays import Array
from comove.dmp.basis import motion_basis, rollouts
from comove.errors import OptionError, near_name
from comove.io.folders import Contents, whole_folder
from comove.lab.bench.runner import machine
from comove.lab.examples import scene_contents, wall
from comove.lab.summaries import Interval, slope_interval, table
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.methods import Comove
from comove.planning.objective import N_STEPS, Objective
from comove.planning.objectives import PaperCost
from comove.planning.solver import solve
from comove.view.figures.style import COLOURS, new_figure, save

REPORT, PICTURE = "scaling.md", "scaling.png"
CONTENTS = Contents("report of growth", frozenset({REPORT}), frozenset({REPORT, PICTURE}))
POPULATION = 16  # candidates of a generation, as the report says


class Case(NamedTuple):
    """Point of a curve: scene, basis size, and number of samples."""

    scene: Scene
    n_basis: int = 30
    n_steps: int = N_STEPS


@dataclass(frozen=True)
class SceneFamily:
    """Family of scenes in which one quantity grows.

    Attributes
    ----------
    label : name of the quantity that grows
    x : values of this quantity
    case : function from a value to its case
    target : largest exponent wanted; None if there is none
    solves, generations : whether whole solves and generations are measured
    """

    label: str
    x: tuple[float, ...]
    case: Callable[[float], Case]
    target: float | None
    solves: bool = True
    generations: bool = True


@dataclass(frozen=True, eq=False)
class ScalingCurve:
    """Measured times of one family.

    Attributes
    ----------
    family : name of the family
    quantity : "generation" or "solve"
    x : array, shape (n_points,)
    times : array, shape (n_points, n_repeats) [s]
    verified : share of the solves that are verified; 1 for generations
    target : largest exponent wanted; None if there is none
    """

    family: str
    quantity: str
    x: Array
    times: Array
    verified: float
    target: float | None

    @property
    def exponent(self) -> Interval:
        """Return the exponent over all points."""
        return slope_interval(self.x, self.times)

    @property
    def exponent_end(self) -> Interval:
        """Return the exponent over the larger half of the points. The middle point is included."""
        half = (len(self.x) - 1) // 2
        return slope_interval(self.x[half:], self.times[half:])

    @property
    def verdict(self) -> str:
        """Return in a word whether both exponents meet the target."""
        if self.target is None:
            return "-"
        fits = self.exponent, self.exponent_end
        if all(fit.high <= self.target for fit in fits):
            return "met"
        return "missed" if any(fit.low > self.target for fit in fits) else "open"


def ring_scene(n_hands: int = 3, n_obstacles: int = 10, radius: float = 0.1, free: float = 0.2) -> Scene:
    """Return a spatial scene with a ring (or bar) among spheres.

    Parameters
    ----------
    radius : radius of the ring [m]
    free : radius of the tube around the straight path that is free of obstacles [m]
    """
    angles = 2 * np.pi * np.arange(n_hands) / n_hands
    ring = radius * np.stack([0 * angles, np.cos(angles), np.sin(angles)], axis=1)
    names = [f"hand{i}" for i in range(n_hands)]
    edges = [[names[i], names[(i + 1) % n_hands]] for i in range(n_hands if n_hands > 2 else 1)]
    rng = np.random.default_rng(n_obstacles)
    centers: list[Array] = []
    while len(centers) < n_obstacles:
        center = rng.uniform(0.0, 1.0, 3)
        if np.linalg.norm(center[1:] - 0.5) > free:
            centers.append(center)
    ends = [np.array([x, 0.5, 0.5]) + ring for x in (0.15, 0.85)]
    spheres = [{"shape": "sphere", "center": c.tolist(), "radius": 0.01} for c in centers]
    load = {"shape": "frame", "edges": edges, "radius": 0.005}
    return Scene.from_dict(scene_contents("ring", [1.0] * 3, spheres, load, ends, names=names))


def gap_scene(ratio: float) -> Scene:
    """Return a planar scene of a 0.2 m bar and a gap. The gap is `ratio` bars wide."""
    half = 0.1 * ratio
    ends = [np.array([[x, 0.4], [x, 0.6]]) for x in (0.15, 0.85)]
    walls = wall(0.5, 0.05, np.array([0.5 - half]), np.array([0.5 + half]))
    bar = {"shape": "bar", "length": 0.2}
    return Scene.from_dict(scene_contents("gap", [1.0] * 2, walls, bar, ends, names=("left", "right")))


FAMILIES = {
    "manipulators": SceneFamily("manipulators", (2, 3, 4, 5, 6, 8), lambda n: Case(ring_scene(int(n))), 1.0),
    "basis": SceneFamily(
        "basis functions", (10, 20, 40, 80), lambda n: Case(ring_scene(), n_basis=int(n)), 1.0
    ),
    "steps": SceneFamily(
        "time steps",
        (101, 201, 401, 801, 1601),
        lambda n: Case(ring_scene(), n_steps=int(n)),
        1.0,
        solves=False,
    ),
    "obstacles": SceneFamily(
        "obstacles", (1, 3, 10, 30, 100, 300, 1000), lambda n: Case(ring_scene(n_obstacles=int(n))), 1.0
    ),
    "difficulty": SceneFamily(
        "bar length / gap",
        (0.625, 1.0, 1.6, 2.5, 4.0, 6.0),
        lambda x: Case(gap_scene(1 / x)),
        None,
        generations=False,
    ),
}


def measure(names: Sequence[str], repeats: int, *, solves: bool = True) -> list[ScalingCurve]:
    """Measure the curves of these families.

    Raises
    ------
    OptionError
        If there is no such family, or `repeats` is below 1.
    """
    for name in names:
        if name not in FAMILIES:
            raise OptionError(f"there is no curve '{name}'", key="--of", way_out=near_name(name, FAMILIES))
    if repeats < 1:
        raise OptionError(f"repeats = {repeats}", key="--repeats", way_out="give 1 or more")
    load_kernels(SceneKind(2))
    load_kernels(SceneKind(3))
    found = []
    for name in names:
        family = FAMILIES[name]
        cases, x = [family.case(value) for value in family.x], np.array(family.x, dtype=float)
        if family.generations:
            times = np.array([generation_times(case, repeats) for case in cases])
            found.append(ScalingCurve(name, "generation", x, times, 1.0, family.target))
        if family.solves and solves:
            solved = [[_solved(case, seed) for seed in range(repeats)] for case in cases]
            times, verified = np.moveaxis(np.array(solved), 2, 0)
            found.append(ScalingCurve(name, "solve", x, times, float(verified.mean()), family.target))
    if not found:
        raise OptionError("there is nothing to measure", key="--of", way_out="leave out --no-solve")
    return found


def generation_times(case: Case, repeats: int, least: float = 0.02) -> list[float]:
    """Measure the time of a population's rollouts and evaluation [s].

    Parameters
    ----------
    least : least time of a measurement [s]
    """
    scene, coordinates = case.scene, load_coordinates(case.scene)
    basis, objective = motion_basis(case.n_basis, "velocity"), Objective(scene, coordinates)
    boundary = coordinates.boundary()
    shape = (POPULATION, coordinates.n_columns, case.n_basis)
    rng = np.random.default_rng(0)
    weights = 0.005 * rng.standard_normal(shape)

    def generation() -> None:
        objective.evaluate(rollouts(basis, boundary, weights, case.n_steps))

    generation()
    begun, count = time.process_time(), 0
    while time.process_time() < begun + least:
        generation()
        count += 1
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        for _ in range(count):
            generation()
        times.append((time.process_time() - begun) / count)
    return times


def _solved(case: Case, seed: int, budget: float = 20.0) -> tuple[float, bool]:
    method = replace(Comove(), n_basis=case.n_basis)
    begun = time.process_time()
    solution = solve(case.scene, seed=seed, method=method, budget=budget, objective=PaperCost())
    return time.process_time() - begun, solution.verified


def write_scaling(
    folder: str | Path, names: Sequence[str], repeats: int, *, solves: bool = True
) -> list[ScalingCurve]:
    """Measure the curves, and write `scaling.md` and `scaling.png`."""
    with whole_folder(folder, CONTENTS) as draft:
        curves = measure(names, repeats, solves=solves)
        (draft / REPORT).write_text(scaling_text(curves), encoding="utf-8")
        save(draw_growth(curves), draft / PICTURE)
    return curves


def draw_growth(curves: Sequence[ScalingCurve]) -> Figure:
    """Draw times and fitted power laws on logarithmic axes. Each curve has a panel."""
    columns = min(4, len(curves))
    rows = -(-len(curves) // columns)
    figure = new_figure(3.4 * columns, 3.0 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, curve in zip(panels, curves, strict=False):
        medians, exponent = np.median(curve.times, axis=1), curve.exponent.value
        axes.plot(
            np.repeat(curve.x, curve.times.shape[1]), curve.times.ravel(), ".", color="0.7", markersize=4
        )
        axes.plot(curve.x, medians, "o-", color=COLOURS[1], markersize=4)
        x, middle = np.asarray(curve.x, dtype=float), np.log(curve.x).mean()
        line = np.exp(np.log(medians).mean() + exponent * (np.log(x) - middle))
        axes.plot(x, line, "--", color=COLOURS[2], linewidth=1, label=f"exponent {exponent:.2f}")
        axes.set(
            xscale="log",
            yscale="log",
            title=f"{curve.family}, {curve.quantity}",
            xlabel=FAMILIES[curve.family].label,
            ylabel="time [s]",
        )
        axes.set_xticks(curve.x, [f"{value:g}" for value in curve.x], fontsize=7)
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=8)
        axes.grid(alpha=0.25)
    for axes in panels[len(curves) :]:
        axes.set_visible(False)
    return figure


def scaling_text(curves: Sequence[ScalingCurve]) -> str:
    """Return the report in Markdown."""
    where = machine()
    lines = ["# Scaling", "", f"On {where.cpu}, {where.cores} cores, Python {where.python}, one thread.", ""]
    rows = []
    for c in curves:
        all_of, end = (f"{e.value:.2f} ({e.low:.2f} to {e.high:.2f})" for e in (c.exponent, c.exponent_end))
        target = "-" if c.target is None else f"at most {c.target:g}"
        share = "-" if c.quantity == "generation" else f"{100 * c.verified:.0f} %"
        rows.append([c.family, c.quantity, all_of, end, target, c.verdict, share])
    head = ["what grows", "of what", "exponent", "over the larger half", "target", "verdict", "verified"]
    lines.append(table(head, rows))
    told = {v: [f"{c.family} ({c.quantity})" for c in curves if c.verdict == v] for v in ("missed", "open")}
    lines += ["", f"**Targets missed**: {', '.join(told['missed']) or 'none'}."]
    lines += [f"Not decided by these measurements: {', '.join(told['open']) or 'none'}.", ""]
    for c in curves:
        medians = "; ".join(
            f"{x:g}: {1e3 * t:.3g} ms" for x, t in zip(c.x, np.median(c.times, axis=1), strict=True)
        )
        lines.append(f"- {c.family}, {c.quantity}: {medians}")
    lines += [
        "",
        f"![Times against what grows]({PICTURE})",
        "",
        "Exponents e of processor time ~ x^e with intervals of 95 % by the bootstrap over "
        f"{curves[0].times.shape[1]} measurements a point. *Generation*: rollouts of {POPULATION} candidates and "
        "their evaluation. *Solve*: a whole search with as many seeds. A target is met where both intervals lie "
        "within it, missed where one lies beyond it, open otherwise.",
    ]
    return "\n".join(lines) + "\n"
