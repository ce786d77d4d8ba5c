"""
A library of movements
======================

Learn a library, find what resembles a new recording, and combine movements that get through two gaps.
"""

import tempfile

import comove
from comove.dmp import operations as op
from comove.lab.evolution import combine
from comove.planning import best_movement
from comove.view.figures import draw_library, save


def wall(x: float, gap: float) -> list[dict]:
    """Return a wall with a gap around a height [m]."""
    low, high = gap - 0.09, 1 - gap - 0.09
    return [
        {"shape": "box", "center": [x, low / 2], "size": [0.06, low]},
        {"shape": "box", "center": [x, 1 - high / 2], "size": [0.06, high]},
    ]


scene = comove.Scene.from_dict(
    {
        "name": "two-gaps",
        "duration": 5.0,  # s
        "workspace": {"lower": [0, 0], "upper": [1, 1]},  # m
        "obstacles": wall(0.35, 0.7) + wall(0.65, 0.3),
        "manipulators": [{"name": "hand", "start": [0.1, 0.5], "goal": [0.9, 0.5]}],
        "limits": {"speed": 3.0},  # m/s
    }
)

with tempfile.TemporaryDirectory() as folder:
    library = comove.Library(folder)
    for shape in ("Sine", "Worm", "NShape", "Snake"):
        library.add(comove.learn(comove.Demonstration.from_lasa(shape), name=shape))
    save(draw_library(library), "movements.png")
    print("most like another sine:", library.find(shape=comove.Demonstration.from_lasa("Sine", 4))[0].name)

    ranking = best_movement(library, scene).ranking
    print("movements that pass alone:", [candidate.name for candidate in ranking if candidate.passes])
    combination = combine(library, scene, seed=0)
    for name, coefficients in zip(combination.names, combination.coefficients, strict=True):
        print(f"  {coefficients[0]:+.2f}, {coefficients[1]:+.2f} of {name}")
    print("the combination is verified:", combination.verified)

    back = op.sequence(combination.dmp, op.reverse(combination.dmp))
    print("there and back ends at", back.rollout().position[-1].round(9))
