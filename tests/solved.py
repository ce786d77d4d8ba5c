"""Scenes and solved motions that several tests look at; each is made once a session."""

from functools import cache
from importlib.resources import files

import comove
from benchmarks.random_scenes import planar_scene, spatial_bar_scene, spatial_triangle_scene
from comove.model import Scene

EXAMPLES = files("comove") / "examples"
RANDOM = {"planar": planar_scene, "bar": spatial_bar_scene, "triangle": spatial_triangle_scene}


@cache
def example(name):
    """One of the scenes that come with the package."""
    return Scene.load(str(EXAMPLES / f"{name}.yaml"))


@cache
def random_scene(kind, seed):
    """A random scene: "planar", "bar" or "triangle" in space."""
    return RANDOM[kind](seed)


def scene_of(name):
    """An example by its name, or a random scene by a name such as "planar 3"."""
    kind, _, number = name.partition(" ")
    return random_scene(kind, int(number)) if number else example(name)


@cache
def solved(name, seed=0, **options):
    """The solution of an example, or of a random scene by a name such as "planar 3"."""
    return comove.solve(scene_of(name), seed=seed, **options)
