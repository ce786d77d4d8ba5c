"""Programmes find least jerk where it is known, keep margins and limits, and never give back what is worse."""

import numpy as np
import pytest

from comove.dmp.basis import motion_basis
from comove.model import Scene, load_coordinates
from comove.planning import LeastJerk
from comove.planning.convex.costs import N_SAMPLES, Moves, differences, jerk_cost, squares
from comove.planning.convex.limits import Limits
from comove.planning.convex.optimise import optimise
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings
from comove.verification import verify
from tests.solved import example, scene_of


def programme_of(scene, n_basis=20):
    coordinates = load_coordinates(scene)
    return ConvexProgramme(scene, coordinates, motion_basis(n_basis, "jerk"), coordinates.boundary())


def one_hand(obstacles=(), **more):
    return Scene.from_dict(
        {
            "name": "one hand",
            "duration": 2.0,
            "workspace": {"lower": [-1, -1], "upper": [2, 2]},
            "manipulators": [{"name": "a", "start": [0, 0.5], "goal": [1, 0.5]}],
            "obstacles": list(obstacles),
            **more,
        }
    )


def by_one_function(moves):
    """Derivatives of any form are those of a basis of one function, which is 1."""
    return Moves(moves, np.ones((len(moves), 1)), np.zeros(moves.shape[2], dtype=bool))


@pytest.mark.parametrize("name", ["one hand", "wide", "bar 0"])
def test_where_nothing_is_in_the_way_the_minimum_jerk_motion_is_found(name):
    """From random weights; its value is 1 for one hand, and for a load that is carried without turning."""
    scene = one_hand() if name == "one hand" else scene_of(name)
    free = Scene.from_dict(scene.file.model_dump() | {"obstacles": []}) if scene.file.obstacles else scene
    programme = programme_of(free)
    z = 0.01 * np.random.default_rng(0).standard_normal(programme.curves.n)
    cost = squares(free, LeastJerk(), None)
    found = optimise(programme, cost, z, ConvexSettings(iterations=60))
    straight = programme.curves.motion(np.zeros(programme.curves.n))
    least = jerk_cost(straight, LeastJerk(), None)
    assert jerk_cost(programme.curves.motion(found.z), LeastJerk(), None) <= least * 1.002
    if len(scene.manipulators) == 1:
        assert least == pytest.approx(1.0, abs=2e-3)
        assert np.abs(found.z).max() < 1e-3


def test_around_a_disc_margins_are_kept_and_both_sides_cost_the_same():
    scene = one_hand([{"shape": "circle", "center": [0.5, 0.5], "radius": 0.1}])
    programme, values = programme_of(scene, 24), []
    for side in (1.0, -1.0):
        s = np.linspace(0.0, 1.0, 201)[:, None]
        way = np.concatenate([s**3 * (10 + s * (6 * s - 15)), 0.5 + side * 0.2 * np.sin(np.pi * s)], axis=1)
        found = optimise(
            programme,
            squares(scene, LeastJerk(), None),
            programme.curves.fit(way, 1e-8),
            ConvexSettings(wish=0.0),
            way,
        )
        report = verify(programme.curves.motion(found.z)).report
        assert 0.0 < report.clearance_min < 3e-3
        values.append(found.value)
    assert values[0] == pytest.approx(values[1], rel=5e-3)
    assert values[0] > 1.1


def test_what_a_known_motion_beats_is_not_optimised_to_the_end():
    """A motion that may still become as good is: nothing changes there."""
    scene = one_hand([{"shape": "circle", "center": [0.5, 0.5], "radius": 0.2}])
    programme, s = programme_of(scene, 24), np.linspace(0.0, 1.0, 201)[:, None]
    way = np.concatenate([s**3 * (10 + s * (6 * s - 15)), 0.5 + 0.4 * np.sin(np.pi * s) ** 2], axis=1)
    cost, z = squares(scene, LeastJerk(), None), programme.curves.fit(way, 1e-8)
    best, beaten = (
        optimise(programme, cost, z, ConvexSettings(), way, known=known) for known in (np.inf, 0.0)
    )
    equal = optimise(programme, cost, z, ConvexSettings(), way, known=best.value)
    np.testing.assert_array_equal(equal.z, best.z)
    assert beaten.iterations < best.iterations
    assert beaten.missed == 0.0
    assert verify(programme.curves.motion(beaten.z)).verified is not None


def test_a_wish_for_room_is_met_where_it_costs_little():
    scene = one_hand([{"shape": "circle", "center": [0.5, 0.42], "radius": 0.1}])
    programme, clearances, jerks = programme_of(scene, 24), [], []
    for wish in (0.0, 0.01, 0.02):
        found = optimise(
            programme,
            squares(scene, LeastJerk(), None),
            np.zeros(programme.curves.n),
            ConvexSettings(wish=wish),
        )
        motion = programme.curves.motion(found.z)
        clearances.append(verify(motion).report.clearance_min)
        jerks.append(jerk_cost(motion, LeastJerk(), None))
    assert clearances[0] < 3e-3 < 6e-3 < clearances[1] < clearances[2]
    assert jerks[0] < jerks[1] < jerks[2] < 1.3 * jerks[0]


def test_limits_are_kept():
    """The straight motion of least jerk peaks at 1.875 times its mean speed and 5.77 m/s^2 in unit duration."""
    free = verify(programme_of(one_hand()).curves.motion(np.zeros(40))).report
    assert free.speed_max == pytest.approx(1.875 / 2, rel=1e-2)
    scene = one_hand(limits={"speed": 0.8})
    programme = programme_of(scene, 24)
    found = optimise(
        programme, squares(scene, LeastJerk(), None), np.zeros(programme.curves.n), ConvexSettings()
    )
    motion = programme.curves.motion(found.z)
    assert verify(motion).verified is not None
    assert 0.75 < verify(motion).report.speed_max <= 0.8


def test_limits_are_linear_in_what_they_say():
    """Of one hand: rows are slopes of the ratios that they bound."""
    rng = np.random.default_rng(2)
    hands, moves = np.cumsum(rng.standard_normal((30, 2)), axis=0), rng.standard_normal((30, 2, 5))
    limits, step = Limits(2, (20.0, 500.0, 4e4)), 1e-6 * rng.standard_normal(5)
    rows, bounds = limits.linear(hands, by_one_function(moves)).cuts(np.zeros(5), 0.0, 0.7)
    after, before = (
        np.concatenate([r.ravel() ** (1 / order) for order, r in limits._ratios(h)])
        for h in (hands + moves @ step, hands)
    )
    orders = np.repeat([1, 2, 3], [29, 28, 29])
    active = before**orders > 0.7
    np.testing.assert_allclose(bounds, ((before**orders - 1.0) / orders)[active], atol=1e-12)
    change = (after**orders - before**orders) / orders
    np.testing.assert_allclose(-rows @ step, change[active], rtol=1e-3, atol=1e-10)


def test_cuts_hold_what_keeps_the_limits():
    """Whatever a trial cuts off, changes within the limits stay within; and a slower pace lets more of them."""
    rng = np.random.default_rng(3)
    hands, moves = 0.1 * rng.standard_normal((30, 2)), rng.standard_normal((30, 2, 5))
    limits, checked = Limits(2, (20.0, 500.0, 4e4)), 0
    linear = limits.linear(hands, by_one_function(moves))
    for _ in range(300):
        trial, inside, slower = rng.standard_normal(5), 0.05 * rng.standard_normal(5), rng.uniform(0, 0.5)
        rates = limits._ratios(hands + moves @ inside)
        rows, bounds = linear.cuts(trial, 0.0, 1.0)
        if all((rate <= 1.0 + order * slower).all() for order, rate in rates):
            assert (rows @ inside + slower >= bounds - 1e-9).all()
            checked += len(rows) > 0
    assert checked > 50


def test_the_cost_is_the_integral_of_its_definition():
    """Against plain quadrature of the curve's own third derivative, with a demonstration and without."""
    scene = example("narrow")
    programme = programme_of(scene, 12)
    motion = programme.curves.motion(1e-3 * np.random.default_rng(1).standard_normal(programme.curves.n))
    s = np.linspace(0.0, 1.0, 8001)
    acceleration = motion.hands(s)[2]
    way = np.linalg.norm(scene.goal - scene.start)
    jerk = (np.diff(acceleration, axis=0) ** 2).sum() * 8000 / (720 * way**2)
    assert jerk_cost(motion, LeastJerk(), None) == pytest.approx(jerk, rel=0.02)
    taught = np.zeros((N_SAMPLES, 2, 3))
    taught[..., :2] = motion.hands(np.linspace(0, 1, N_SAMPLES))[0] + [0.1, 0.0]
    away = jerk_cost(motion, LeastJerk(0.5), taught)
    assert away == pytest.approx(LeastJerk(0.5).pull(True) * 2 * 0.01 / way**2, rel=0.05)


def test_third_differences_of_a_quintic():
    """y = s^3 (10 - 15 s + 6 s^2) has y''' = 60 - 360 s + 360 s^2, and no acceleration at its ends."""
    s = np.linspace(0.0, 1.0, 401)
    middle = 0.5 * (s[1:] + s[:-1])
    found = differences((s**3 * (10 + s * (6 * s - 15)))[:, None], 3)[:, 0]
    np.testing.assert_allclose(found, 60 - 360 * middle + 360 * middle**2, atol=0.2)
