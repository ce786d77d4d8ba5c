"""One manipulator, a library, and a scene of one."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.compared import Single
from comove.lab.compared.single import alone
from comove.lab.evolution import combine
from comove.model import Scene, demonstration_of
from tests import brute_force
from tests.model.examples import POLYGON, TRAY
from tests.planning.two_gaps import bumps, two_gaps
from tests.solved import example


def test_the_scene_of_one():
    scene = example("window")
    one = alone(scene)
    assert one.manipulators == scene.manipulators[:1]
    assert np.array_equal(one.start, scene.start[:1]) and np.array_equal(one.goal, scene.goal[:1])
    assert np.array_equal(one.obstacles, scene.obstacles)
    assert (one.duration, one.speed_limit, one.clearance) == (
        scene.duration,
        scene.speed_limit,
        scene.clearance,
    )
    assert not one.constraints and one.body.n_nodes == 1
    assert alone(one).sha256 == one.sha256


@pytest.mark.slow
def test_movements_of_which_none_passes_alone_pass_together():
    scene = two_gaps()
    for dmp in bumps().values():
        motion = combine({"it": dmp}, scene, budget=0.5)
        if motion.verified:
            break
    solution = comove.solve(scene, method=Single(movements=bumps()))
    assert solution.verified
    assert solution.trajectory.position.shape[1:] == (1, 2)
    hands = solution.motion.motion.hands(np.linspace(0, 1, 4001))[0]
    assert brute_force.configuration_clearance(scene, hands).min() > 0


@pytest.mark.parametrize("name", ["narrow", "window"])
@pytest.mark.few(1)
def test_handwriting_gets_one_hand_through(name):
    """By default, in the plane and in space; cheaper than with a load to carry."""
    solution = comove.solve(example(name), method=Single())
    assert solution.verified
    assert solution.scene.manipulators == example(name).manipulators[:1]
    assert solution.scene is not example(name)
    assert solution.cost.total < 0.1


@pytest.mark.slow
def test_the_second_stage_improves_the_combination():
    scene = two_gaps()
    combined = combine(bumps(), scene)
    assert comove.solve(scene, method=Single(movements=bumps())).cost.total <= combined.cost * 1.001


@pytest.mark.slow
def test_a_demonstration_joins_the_library():
    scene = example("complex")
    assert comove.solve(scene, demonstration=demonstration_of(scene), method=Single(n_movements=1)).verified


@pytest.mark.parametrize("scene", [TRAY, POLYGON], ids=["tray", "polygon"])
@pytest.mark.few(1)
def test_whatever_the_load_is_it_is_left_behind(scene):
    assert comove.solve(scene, method=Single(n_movements=2)).verified


def test_what_goes_on_from_another_movement_is_refused():
    scene = example("narrow")
    group = scene.groups[0]
    later = scene.resumed(1.0, 9.0, (group.start,), np.ones((1, 6)) * [0.1, 0, 0, 0, 0, 0])
    assert isinstance(later, Scene)
    with pytest.raises(OptionError, match="goes on from another movement"):
        comove.solve(later, method=Single())


def test_slips_are_told():
    with pytest.raises(OptionError, match="n_movements"):
        Single(n_movements=0)
    with pytest.raises(OptionError, match="movements"):
        comove.solve(two_gaps(), method=Single(movements=[]))
