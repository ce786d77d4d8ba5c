"""A small execution, which needs all kernels of free end effectors."""

from comove.control.executor import Executor
from comove.planning.kernels import SceneKind, small_scene


def execute(budget: float = 0.5) -> None:
    """Execute in small planar and spatial scenes with a moving obstacle.

    Parameters
    ----------
    budget : time that passes in each at most [s]
    """
    for n_dims in (2, 3):
        Executor(small_scene(SceneKind(n_dims, moving=True))).run(budget)
