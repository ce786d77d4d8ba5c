"""Peers keep to what they are asked; each is skipped where it is not installed."""

import sys

import numpy as np
import pytest
import scipy

from comove.errors import ExtraError
from comove.lab.peers.common import (
    clearance_slopes,
    clearances,
    first_hands,
    independent_distances,
    timed,
)
from comove.lab.peers.shapes import Shapes
from comove.lab.registry import PEERS, SYSTEMS
from comove.lab.systems import N_SAMPLES, Offers, SystemProblem, cost_of, measured
from comove.model import Scene

MODULES = {
    "ompl-rrtconnect": "ompl",
    "ompl-rrtconnect-raw": "ompl",
    "ompl-projected": "ompl",
    "ompl-aorrtc": "ompl",
    "pycma-al": "cma",
    "slsqp": "scipy",
    "trust-constr": "scipy",
    "ipopt": "casadi",
    "movement-primitives": "movement_primitives",
    "drake": "pydrake",
}
TIMELESS = (
    "ompl-rrtconnect",
    "ompl-rrtconnect-raw",
    "ompl-projected",
    "slsqp",
    "movement-primitives",
)  # end before their budget does
SLOW = ("trust-constr", "pycma-al")  # reach the distances late, or not at all
BUDGET = 2.0  # s


def easy(n_dims, *, n_hands=2, **more):
    """A bar, or a triangle of three, straight past a ball."""
    hands = {"a": [0.0, 0.4, 0.5], "b": [0.0, 0.6, 0.5], "c": [0.1, 0.5, 0.6]}
    names = list(hands)[:n_hands]
    load = {"shape": "bar", "length": 0.2}
    if n_hands == 3:
        load = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]]}
    ball = {"shape": "sphere", "center": [0.5, 0.15, 0.5][:n_dims], "radius": 0.1}
    return Scene.from_dict(
        {
            "name": "easy",
            "duration": 5.0,
            "workspace": {"lower": [0] * n_dims, "upper": [1] * n_dims},
            "obstacles": [ball],
            "load": load,
            "manipulators": [
                {"name": n, "start": [0.15 + x, *yz][:n_dims], "goal": [0.75 + x, *yz][:n_dims]}
                for n, (x, *yz) in ((n, hands[n]) for n in names)
            ],
            "limits": {"speed": 1.0},
            **more,
        }
    )


def peers(names=MODULES):
    marks = {name: [pytest.mark.slow] for name in SLOW}
    return [pytest.param(name, marks=marks.get(name, [])) for name in names]


def offered(name, scene, *, budget=BUDGET, seed=0):
    pytest.importorskip(MODULES[name])
    problem, offers = SystemProblem(scene, seed=seed, budget=budget), Offers()
    PEERS[name].warm_up(problem)
    offers.__init__()
    PEERS[name].run(problem, offers)
    return offers


def test_the_registry_names_its_systems():
    assert set(PEERS) == set(MODULES)
    assert all(system.name == name for name, system in PEERS.items())


@pytest.mark.parametrize("name", peers())
@pytest.mark.parametrize("n_dims", [2, 3])
def test_offers_lead_from_start_to_goal_in_time(name, n_dims):
    scene = easy(n_dims)
    offers = offered(name, scene)
    assert offers.seconds < 1.2 * BUDGET + 0.3
    assert offers.taken
    for _, hands in offers.taken:
        assert hands.shape == (N_SAMPLES, *scene.start.shape)
        np.testing.assert_allclose(hands[0], scene.start, atol=1e-6)
        np.testing.assert_allclose(hands[-1], scene.goal, atol=1e-3)


@pytest.mark.parametrize("name", peers([name for name in MODULES if name not in SLOW]))
def test_the_judge_accepts_what_they_find_where_it_is_easy(name):
    pytest.importorskip(MODULES[name])
    outcome = measured(PEERS[name], SystemProblem(easy(2), budget=BUDGET))
    assert outcome.verified, outcome.reasons
    assert outcome.first_verified <= outcome.seconds


@pytest.mark.parametrize("name", ["ompl-rrtconnect", "ompl-projected", "slsqp"])
def test_three_hands_in_space(name):
    pytest.importorskip(MODULES[name])
    assert measured(PEERS[name], SystemProblem(easy(3, n_hands=3), budget=2 * BUDGET)).verified


@pytest.mark.parametrize("name", TIMELESS)
def test_a_seed_repeats_the_run(name):
    """As far as both got: how far that is, the clock decides."""
    first, again = (offered(name, easy(2)).taken for _ in range(2))
    assert first and again
    for one, other in zip(first, again, strict=False):
        np.testing.assert_array_equal(one[1], other[1])


def test_no_peer_draws_from_the_global_random_state():
    pytest.importorskip("cma")
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.get_state()[1].copy()  # noqa: NPY002
    offered("pycma-al", easy(2), budget=0.3)
    assert (np.random.get_state()[1] == expected).all()  # noqa: NPY002


@pytest.mark.parametrize("name", ["pycma-al", "ipopt", "drake", "ompl-aorrtc"])
def test_no_peer_prints_or_writes(name, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    offered(name, easy(2), budget=0.5)
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")
    assert not list(tmp_path.iterdir())


PASSING = {"shape": "circle", "center": [0.5, 0.9], "radius": 0.02, "motion": {"velocity": [0, 0.01]}}
REFUSED = {
    "moving": {"obstacles": [PASSING]},
    "upright": {"constraints": [{"type": "upright"}]},
    "polygon": {"load": {"shape": "box", "size": [0.2, 0.02]}},
}


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.parametrize("what", REFUSED)
def test_refusals_are_one_sentence(name, what):
    reason = PEERS[name].refuses(easy(2, **REFUSED[what]))
    assert reason.endswith(".") and reason.count(".") == 1


def test_what_only_some_can_do():
    assert "two hands" in PEERS["movement-primitives"].refuses(easy(2, n_hands=3))
    loose = {
        "load": None,
        "constraints": [{"type": "separation", "between": ["a", "b"], "distance": 0.1}],
    }
    assert "one load" in PEERS["ompl-rrtconnect"].refuses(easy(2, **loose))
    assert "project" in PEERS["ompl-projected"].refuses(easy(2, **loose))
    assert PEERS["slsqp"].refuses(easy(2, **loose)) == ""


@pytest.mark.parametrize("name", [name for name in MODULES if MODULES[name] != "scipy"])
def test_a_peer_that_is_not_installed_says_how(name, monkeypatch):
    class Missing:
        @staticmethod
        def find_spec(module, path=None, target=None):
            if module.split(".")[0] == MODULES[name]:
                raise ModuleNotFoundError(module)

    for module in [m for m in sys.modules if m.split(".")[0] == MODULES[name]]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(sys, "meta_path", [Missing, *sys.meta_path])
    with pytest.raises(ExtraError, match=r"pip install 'comove\[bench\]'"):
        PEERS[name].warm_up(SystemProblem(easy(2)))


def test_distances_that_follow_from_others_are_left_out():
    assert len(independent_distances(easy(3, n_hands=3))) == 3
    flat = easy(2, n_hands=3)
    assert len(flat.distances) == len(independent_distances(flat)) == 3


def test_slopes_of_clearances():
    scene = easy(3, n_hands=3)
    rng = np.random.default_rng(0)
    hands = first_hands(SystemProblem(scene), np.linspace(0, 1, 7)) - [0.0, 0.1, 0.0]
    hands += rng.normal(0, 0.01, hands.shape)  # away from kinks
    shift, step = rng.normal(0, 1, hands.shape), 1e-5
    expected = (clearances(scene, hands + step * shift) - clearances(scene, hands - step * shift)) / (
        2 * step
    )
    found = (clearance_slopes(scene, hands) * shift).sum(axis=(1, 2))
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_slopes_of_shape_weights(n_dims):
    limits = {"speed": 0.5, "acceleration": 1.0}
    problem = SystemProblem(easy(n_dims, n_hands=3, limits=limits), budget=60.0)
    shapes, rng = Shapes(problem, Offers(), 8), np.random.default_rng(1)
    x, shift, step = rng.normal(0, 0.05, shapes.n), rng.normal(0, 1, shapes.n), 1e-6

    def at(x):
        hands = shapes.hands(x[None])
        return cost_of(problem.scene, hands)[0], shapes.constraints(shapes.demands(hands)), hands[0]

    (more, constrained_more, _), (less, constrained_less, _) = at(x + step * shift), at(x - step * shift)
    assert shapes.cost_slope(at(x)[2]) @ shift == pytest.approx((more - less) / (2 * step), rel=1e-5)
    expected = (constrained_more - constrained_less) / (2 * step)
    np.testing.assert_allclose(shapes.constraint_slopes(at(x)[2]) @ shift, expected, atol=1e-4)
    assert len(at(x)[2]) == shapes.n_steps


def test_paths_keep_the_speed_limit():
    """1 m in 2 s: minimum jerk would reach 0.94 m/s."""
    scene = easy(2, duration=2.0, limits={"speed": 0.6})
    hands = timed(lambda u: scene.start + u[:, None, None] * [1.0, 0.0], SystemProblem(scene))
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=2) * (N_SAMPLES - 1) / 2.0
    assert speed.max() <= 0.6
    assert speed[[0, -1]].max() < 1e-3
    np.testing.assert_allclose(hands[-1] - hands[0], [[1.0, 0.0]] * 2)


def test_peers_tell_the_versions_of_their_packages():
    assert SYSTEMS["slsqp"].version == f"scipy {scipy.__version__}"
    assert SYSTEMS["comove"].version == ""
