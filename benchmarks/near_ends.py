"""Adaptation of demonstrations whose ends nearly coincide.

- loop: x = 0.14 (1 - cos 2 pi s) + gap s, y = 0.05 sin 2 pi s, adapted to the ends of the left hand of the narrow
  scene, 0.7 m apart, for gaps from 0 to 30 cm: size (greatest distance between two points) of the adapted movement;
- handwriting: the 30 LASA shapes, 28 cm in size, whose last part is bent so that they end where they start but for
  the gap, in the direction of their own displacement: largest size over all shapes, the same over the larger of a
  shape's own size and 5 displacements, and the steepest change of a path with the gap;
- solved: mean distance of the verified motion from the adapted demonstration, in the narrow scene.

    python benchmarks/near_ends.py [--shapes 30] [--picture near_ends.png]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from timing import on_one_thread, print_table

import comove
from comove.dmp import DMP
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.dmp.variants import APART, CLOSED, extent_of
from comove.errors import ComoveWarning
from comove.model.adaptation import modulate

Array = NDArray[np.float64]

S = np.linspace(0.0, 1.0, 201)
SIZE = 0.28  # m, of the loop and of the handwriting
GAPS = (0.0, 1e-9, 1e-6, 1e-3, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1, 0.2, 0.3)
VARIANTS = ("closed-form", "pastor", "dmp++", "classic")
SOLVER, ALONE = "solve", "similarity alone"
SCENE = comove.Scene.load(str(files("comove") / "examples" / "narrow.yaml"))
START, GOAL = SCENE.start[0], SCENE.goal[0]
WAY = float(np.linalg.norm(GOAL - START))


def main() -> None:
    """Print tables for the loop, the handwriting, and the solutions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=30)
    parser.add_argument("--picture", metavar="PNG")
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore", ComoveWarning)  # of what is shown here
    print_table(
        ("gap", *SYSTEMS),
        [(f"{gap:g} m", *(f"{size(loop(gap), own):.3g} m" for own in SYSTEMS)) for gap in GAPS],
    )
    print()
    shapes = [closed(name) for name in lasa_names()[: asked.shapes]]
    print_table(
        ("", "largest size", "over the bound", "steepest change with the gap"),
        map(handwriting_row(shapes), SYSTEMS),
    )
    print()
    print_table(("gap", "size", "mean distance of the motion", "verified"), solved_rows())
    if asked.picture:
        picture(asked.picture, shapes)


def loop(gap: float) -> Demonstration:
    """Return a path out and back, with ends `gap` apart along x."""
    x, y = 0.14 * (1 - np.cos(2 * np.pi * S)) + gap * S, 0.05 * np.sin(2 * np.pi * S)
    return Demonstration(5.0 * S, np.stack([x, y], axis=1), "loop")


def closed(name: str) -> Callable[[float], Demonstration]:
    """Return handwriting bent to end at its start, but for a gap."""
    shown = Demonstration.from_lasa(name).resampled(len(S))
    position = shown.position - shown.position[0]
    position *= SIZE / extent_of(position)
    end = position[-1]
    u = np.clip(2 * S - 1, 0.0, 1.0)
    back = u**3 * (10 - 15 * u + 6 * u**2)

    def at(gap: float) -> Demonstration:
        away = gap * end / np.linalg.norm(end)
        return Demonstration(5.0 * S, position + np.outer(back, away - end), name, unit="any")

    return at


def by_variant(variant: str) -> Callable[[Demonstration], Array]:
    """Return a function from demonstrations to rollouts between the scene's ends."""
    return lambda shown: DMP.fit(shown, variant=variant).rollout(start=START, goal=GOAL).position


def by_solver(shown: Demonstration) -> Array:
    """Return the adapted demonstration of the left end effector."""
    dmp = DMP.fit(shown)
    return modulate(dmp, START, GOAL).at(S * dmp.duration).position


def by_similarity(shown: Demonstration) -> Array:
    """Return the demonstration, mapped by a similarity to the scene's ends."""
    position = shown.position @ [1, 1j]
    gap = position[-1] - position[0]
    way = (GOAL - START) @ [1, 1j]
    moved = (position - position[0]) * (way / gap if abs(gap) > 1e-12 else 1.0)
    return np.stack([moved.real, moved.imag], axis=1)


SYSTEMS: dict[str, Callable[[Demonstration], Array]] = {
    SOLVER: by_solver,
    **{variant: by_variant(variant) for variant in VARIANTS},
    ALONE: by_similarity,
}


def size(shown: Demonstration, system: str) -> float:
    """Return the size of the adapted movement [m]."""
    return extent_of(SYSTEMS[system](shown)[::2])


def handwriting_row(shapes: list[Callable[[float], Demonstration]]) -> Callable[[str], tuple[str, ...]]:
    """Return a function from a system to its row of the table."""
    gaps = np.concatenate([[0.0], np.geomspace(1e-4, 1e-3, 3), np.linspace(0.004, 0.088, 22)])

    def row(system: str) -> tuple[str, ...]:
        largest, over, steepest = 0.0, 0.0, 0.0
        for shape in shapes:
            paths = [SYSTEMS[system](shape(gap)) for gap in gaps]
            extents = np.array([extent_of(path[::2]) for path in paths])
            bounds = np.array([max(extent_of(shape(gap).position[::2]), WAY / APART) for gap in gaps])
            change = np.linalg.norm(np.diff(paths, axis=0), axis=2).max(axis=1) / np.diff(gaps)
            largest, over = max(largest, extents.max()), max(over, float((extents / bounds).max()))
            steepest = max(steepest, change.max())
        return system, f"{largest:.3g} m", f"{over:.3g}", f"{steepest:.3g} m/m"

    return row


def solved_rows() -> list[tuple[str, ...]]:
    """Return the rows of solutions with the loop."""
    rows = []
    for gap in GAPS:
        found = comove.solve(SCENE, demonstration=loop(gap), seed=0)
        near = "-" if found.followed is None else f"{found.followed.distance:.3g} m"
        rows.append(
            (f"{gap:g} m", f"{size(loop(gap), SOLVER):.3g} m", near, "yes" if found.verified else "no")
        )
    return rows


def picture(path: str, shapes: list[Callable[[float], Demonstration]]) -> None:
    """Draw adapted loops, and relative sizes over the gap."""
    from comove.view.figures import save_picture
    from comove.view.figures.style import COLOURS, new_figure

    figure = new_figure(13.0, 4.6)
    axes = figure.add_subplot(1, 3, 1)
    for k, gap in enumerate((0.0, 0.01, 0.02, 0.03, 0.1, 0.3)):
        axes.plot(*by_solver(loop(gap)).T, color=COLOURS[k], linewidth=1.4, label=f"{100 * gap:g} cm")
    axes.plot(*np.stack([START, GOAL]).T, "o", color="0.1", markersize=5)
    axes.set(title="a loop between the scene's ends", xlabel="x [m]", ylabel="y [m]")
    axes.set(ylim=(-0.35, 0.5))
    axes.legend(title="gap, size 28 cm", frameon=False, fontsize="small", loc="lower left", ncols=3)
    sizes = (
        (figure.add_subplot(1, 3, 2), {name: [loop] for name in SYSTEMS}),
        (
            figure.add_subplot(1, 3, 3),
            {name: shapes for name in (SOLVER, ALONE)},
        ),
    )
    for (axes, drawn), title in zip(sizes, ("the loop", f"{len(shapes)} LASA shapes, closed"), strict=True):
        for k, name in enumerate(SYSTEMS):
            for i, shape in enumerate(drawn.get(name, [])):
                gaps = np.concatenate([[1e-4, 3e-4], np.linspace(1e-3, 0.3, 150 if shape is loop else 60)])
                shown = [shape(gap) for gap in gaps]
                own = np.array([extent_of(one.position[::2]) for one in shown])
                style = {"linestyle": "--", "color": "0.55"} if name == ALONE else {"color": COLOURS[k]}
                axes.plot(
                    100 * gaps / own,
                    [size(one, name) for one in shown],
                    linewidth=1.6 if shape is loop else 0.6,
                    label=name if i == 0 else None,
                    **style,
                )
        axes.axhline(WAY / APART, color="0.1", linestyle=":", linewidth=1.2, label="5 displacements")
        axes.axvspan(100 * CLOSED, 100 * APART, color="0.93", zorder=0)
        axes.set(title=title, xlabel="gap [% of the size]", ylabel="size of the adapted movement [m]")
        axes.set(yscale="log", ylim=(0.5, 200.0), xlim=(0.0, 50.0))
        axes.legend(frameon=False, fontsize="small", loc="upper right")
    save_picture(figure, path)
    print(f"drawn: {path}")


if __name__ == "__main__":
    main()
