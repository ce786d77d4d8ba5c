"""Candidates come best first, and kinematics are asked only while the answer may change which comes next."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.basis import motion_basis
from comove.model import Scene
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.planning.objective import Evaluation, Objective
from comove.planning.search import Candidates, Search
from tests.cases import examples

SCENE = Scene.from_dict(
    {
        "name": "free",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "load": {"shape": "bar", "length": 0.1},
        "limits": {"speed": 1.0, "acceleration": 1.0},
        "manipulators": [
            {"name": "left", "start": [0.1, 0.55], "goal": [0.9, 0.55]},
            {"name": "right", "start": [0.1, 0.45], "goal": [0.9, 0.45]},
        ],
    }
)
OBJECTIVE = Objective(SCENE, load_coordinates(SCENE))


def evaluation(rng, n):
    """Costs of which some are equal, and rollouts of which some touch something."""
    cost = rng.integers(0, 6, n) / 4.0
    touching = rng.random(n) < 0.3
    none = np.zeros(n)
    return Evaluation(
        cost, 0.25 * touching, np.where(touching, -1.0, 1.0), none, none, none, np.zeros((n, 3))
    )


@examples(60)
@given(st.integers(0, 10**6))
def test_candidates_come_as_if_all_were_asked_about_and_no_more_than_needed_are(seed):
    rng = np.random.default_rng(seed)
    n, asked = 12, list[int]()
    penalty, executable = rng.integers(0, 4, n) / 4.0, rng.random(n) < 0.6
    worth_it = rng.random(n) < 0.7

    def answer(k):
        yield 0.5 * penalty[k], True, False
        asked.append(k)
        yield penalty[k], bool(executable[k]), True

    known = {k: answer(k) for k in np.flatnonzero(worth_it).tolist()}
    candidates = Candidates(OBJECTIVE, evaluation(rng, n), worth_it.copy(), known)
    bound, alone = candidates.rank, candidates.value.penalty.copy()
    order = candidates.best_first()
    first = next(order)
    least = candidates.rank[first]
    # whoever was asked about might have been better by what was known of it
    assert all(bound[k] + 0.5 * penalty[k] <= least for k in asked) and set(asked) <= set(
        np.flatnonzero(worth_it)
    )
    came = [first, *order]
    value = candidates.value
    np.testing.assert_array_equal(value.penalty, alone + np.where(worth_it, penalty, 0.0))
    assert len(asked) == len(set(asked)) == worth_it.sum()
    whole = Candidates(OBJECTIVE, value, worth_it & executable)
    assert came == np.argsort(whole.rank, kind="stable").tolist()


@pytest.mark.parametrize("seed", range(3))
def test_obstacles_of_rollouts_beyond_the_limits_are_left_out_until_they_may_matter(seed):
    rng, basis = np.random.default_rng(seed), motion_basis(20)
    ball = {"shape": "circle", "center": [0.5, 0.3], "radius": 0.05}
    scene = Scene.from_dict(SCENE.file.model_dump() | {"obstacles": [ball]})
    coordinates = load_coordinates(scene)
    shape = 24, coordinates.n_columns, basis.n_basis
    weights = np.linspace(0.0, 0.02, shape[0])[:, None, None] * rng.standard_normal(shape)
    objective = Objective(scene, coordinates)
    search = Search(objective, taught=None, hard=True, rng=rng)
    dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), weights[0])
    whole, lazy = (search.candidates(dmp, weights, 5, limited) for limited in (False, True))
    left_out = np.isnan(lazy.value.clearance)
    beyond = (np.array(objective.limit_ratios(whole.value)) > [[objective.penalty.near], [1.0]]).any(axis=0)
    assert (
        4 < left_out.sum() < 20 and (left_out == beyond).all() and not np.isnan(whole.value.clearance).any()
    )
    np.testing.assert_array_equal(lazy.sound, whole.sound)
    assert lazy.gentlest == whole.gentlest and (np.isnan(lazy.value.clearance) == left_out).all()
    order = lazy.best_first()
    came = [next(order)]
    assert (np.isnan(lazy.value.clearance) == left_out).all()
    assert [*came, *order] == [*whole.best_first()]
    np.testing.assert_array_equal(lazy.value.penalty, whole.value.penalty)
    np.testing.assert_array_equal(lazy.value.clearance, whole.value.clearance)
