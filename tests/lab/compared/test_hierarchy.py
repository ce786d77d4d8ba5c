"""Lexicographic programmes against another solver and by what they promise."""

import numpy as np
import pytest
from scipy.optimize import minimize

from comove.lab.compared.hierarchy import PriorityTask, lexicographic


def problem(seed):
    """Two tasks of three and two rows in six variables, and ten rows of which some are active."""
    rng = np.random.default_rng(seed)
    tasks = [PriorityTask(rng.standard_normal((m, 6)), 2 * rng.standard_normal(m)) for m in (3, 2)]
    tasks.append(PriorityTask(np.eye(6), rng.standard_normal(6)))
    return tasks, rng.standard_normal((10, 6)), -np.abs(rng.standard_normal(10))


def misses(tasks, x):
    return [float(np.sum((task.matrix @ x - task.target) ** 2)) for task in tasks]


@pytest.mark.parametrize("seed", range(8))
def test_every_level_is_as_good_as_another_solver_makes_it(seed):
    """Level by level with SLSQP, the former levels' values held as constraints."""
    tasks, rows, low = problem(seed)
    x, slack = lexicographic(tasks, rows, low)
    assert slack == 0.0
    assert (rows @ x >= low - 1e-7).all()
    held = [{"type": "ineq", "fun": lambda z: rows @ z - low}]
    start = np.zeros(6)
    for k, task in enumerate(tasks):
        best = minimize(
            lambda z, task=task: np.sum((task.matrix @ z - task.target) ** 2),
            start,
            constraints=held,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert misses(tasks, x)[k] == pytest.approx(best.fun, abs=2e-4)
        matrix, at = task.matrix, task.matrix @ best.x
        held.append({"type": "eq", "fun": lambda z, matrix=matrix, at=at: matrix @ z - at})
        start = best.x


def test_a_lower_task_never_costs_a_higher_one():
    tasks, rows, low = problem(3)
    alone, _ = lexicographic(tasks[:1], rows, low)
    together, _ = lexicographic(tasks, rows, low)
    assert misses(tasks, together)[0] == pytest.approx(misses(tasks, alone)[0], abs=1e-5)


def test_rows_that_contradict_give_way_least():
    rows, low = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, 0.0])  # x >= 1 and x <= 0
    x, slack = lexicographic([PriorityTask(np.eye(2), np.array([5.0, 3.0]))], rows, low)
    assert slack == pytest.approx(0.5, abs=1e-3)
    assert x == pytest.approx([0.5, 3.0], abs=1e-3)


def test_tasks_without_rows_and_rows_without_effect():
    empty = PriorityTask(np.zeros((0, 3)), np.zeros(0))
    x, slack = lexicographic([empty, PriorityTask(np.eye(3), np.arange(3.0))], np.zeros((0, 3)), np.zeros(0))
    assert slack == 0.0
    assert x == pytest.approx(np.arange(3.0), abs=1e-6)
