"""The movement that suits a scene best is found, by the same measures that the search uses."""

import numpy as np
import pytest

from comove.dmp import DMP, Library, Primitive, learn, motion_basis
from comove.dmp import operations as op
from comove.dmp.demonstrations import Demonstration
from comove.errors import OptionError
from comove.lab.examples import example
from comove.model import CoordinatedDMP, load_coordinates
from comove.planning import PaperCost, best_movement, carried_demonstration
from comove.planning.choice import N_BASIS
from comove.planning.objective import N_STEPS, Objective
from comove.verification.verify import verify
from tests.planning.two_gaps import bump, bumps, two_gaps

LASA = {name: DMP.fit(Demonstration.from_lasa(name)) for name in ("Angle", "Sine", "Worm", "GShape", "Line")}


@pytest.mark.parametrize("bar", [None, 0.1])
def test_the_movement_that_passes_comes_first(bar):
    scene = two_gaps(gap=0.3, bar=bar, upper=0.65, lower=0.65)
    movements = {"below": bump(0.5, -0.25), "wide": bump(0.5, 0.5), **LASA, "above": bump(0.5, 0.25)}
    choice = best_movement(movements, scene)
    passing = {c.name: c.passes for c in choice.ranking}
    assert choice.best.passes and not passing["below"]
    for candidate in choice.ranking[:1]:
        motion = _carried(candidate.dmp, scene)
        assert candidate.passes == (verify(motion).verified is not None)
    flags = [c.passes for c in choice.ranking]
    assert flags == sorted(flags, reverse=True)
    assert choice.best is choice.ranking[0]


def _carried(dmp, scene):
    basis = motion_basis(N_BASIS, "velocity")
    return CoordinatedDMP.from_demonstration(dmp, scene, load_coordinates(scene), basis).rollout()


@pytest.mark.parametrize("name", ["wide", "narrow"])
def test_all_at_once_is_one_by_one(name):
    scene = example(name)
    objective = Objective(scene, load_coordinates(scene))
    for candidate in best_movement(LASA, scene).ranking:
        cost = objective.cost(_carried(candidate.dmp, scene))
        assert candidate.cost == pytest.approx(cost.goal + cost.velocity, rel=1e-12)
        alone = best_movement([candidate.dmp], scene).best
        assert (alone.passes, alone.cost, alone.penalty, alone.clearance) == (
            candidate.passes,
            candidate.cost,
            candidate.penalty,
            candidate.clearance,
        )


def test_scale_place_and_direction_of_the_recording_do_not_matter():
    scene = two_gaps()
    for dmp in (LASA["Sine"], bump(0.3)):
        moved = op.retime(op.scale(op.rotate(dmp, 2.0, about=[5, 5]), 7.0), 3.0)
        a, b = (best_movement([d], scene).best for d in (dmp, moved))
        assert a.cost == pytest.approx(b.cost, rel=1e-9)
        assert a.penalty == pytest.approx(b.penalty, rel=1e-6)


def test_every_way_to_give_movements(tmp_path):
    scene, library = two_gaps(), Library(tmp_path)
    for name in ("Angle", "Sine"):
        library.add(learn(Demonstration.from_lasa(name), name=name))
    names = [c.name for c in best_movement(library, scene).ranking]
    assert sorted(names) == ["Angle", "Sine"]
    assert [c.name for c in best_movement(list(library), scene).ranking] == names
    assert [c.name for c in best_movement({p.name: p.dmp for p in library}, scene).ranking] == names
    by_number = {"Angle": "0", "Sine": "1"}
    assert [c.name for c in best_movement([p.dmp for p in library], scene).ranking] == [
        by_number[n] for n in names
    ]
    weights = PaperCost(goal=0.0, velocity=1.0)
    assert (
        best_movement(library, scene, objective=weights).best.cost != best_movement(library, scene).best.cost
    )


def test_what_cannot_be_carried_is_left_out():
    scene, planar = two_gaps(), bump(0.5)
    cycle = DMP(np.ones((2, 5)), *np.zeros((4, 2)), 1.0, variant="rhythmic")
    given = [
        Primitive("plane", planar),
        Primitive("space", op.in_space(planar, "xy")),
        Primitive("cycle", cycle),
    ]
    assert [c.name for c in best_movement(given, scene).ranking] == ["plane"]
    with pytest.raises(OptionError, match="none of the 1 movements has the scene's 2 dimensions"):
        best_movement([cycle], scene)
    with pytest.raises(OptionError, match="none of the 0 movements"):
        best_movement([], scene)
    window = example("window")
    with pytest.raises(OptionError, match="3 dimensions"):
        best_movement([planar], window)
    assert best_movement([planar], window, plane="xz").best.dmp.n_dims == 3


@pytest.mark.parametrize("variant", ["classic", "pastor", "dmp++"])
def test_variants_are_carried_as_the_movement_is(variant):
    recording = Demonstration.from_lasa("Sine")
    a = best_movement([DMP.fit(recording)], two_gaps()).best
    b = best_movement([DMP.fit(recording, variant=variant)], two_gaps()).best
    assert a.cost == pytest.approx(b.cost, rel=1e-2)


@pytest.mark.parametrize("variant", ["closed-form", "classic", "pastor", "dmp++"])
def test_the_solver_carries_every_variant_by_the_similarity_of_its_ends(variant):
    """Also where the movement was turned to another goal before."""
    scene, recording = two_gaps(bar=0.1), Demonstration.from_lasa("Worm")
    dmp = DMP.fit(recording, variant=variant)
    dmp = dmp.towards(goal=dmp.goal + [3.0, 9.0], start_velocity=[0.0, 0.0])
    position = dmp.rollout(n_steps=N_STEPS).position @ [1, 1j]
    for hand, start, goal in zip(
        carried_demonstration(dmp, scene).swapaxes(0, 1), scene.start, scene.goal, strict=True
    ):
        start, goal = start @ [1, 1j], goal @ [1, 1j]
        share = (position - position[0]) / (position[-1] - position[0])
        assert np.abs(hand[:, :2] @ [1, 1j] - (start + share * (goal - start))).max() < 1e-9
    with pytest.raises(OptionError, match="rhythmic"):
        carried_demonstration(DMP(np.ones((2, 5)), *np.zeros((4, 2)), 1.0, variant="rhythmic"), scene)


def test_bumps_alone_do_not_pass():
    assert not any(c.passes for c in best_movement(bumps(), two_gaps()).ranking)


def test_movements_of_joints_are_no_candidates():
    scene = two_gaps(gap=0.3, bar=None, upper=0.65, lower=0.65)
    arm = Primitive("arm", bump(0.5, 0.25), unit="rad")
    hand = Primitive("hand", bump(0.5, 0.25))
    assert [candidate.name for candidate in best_movement([arm, hand], scene).ranking] == ["hand"]
    with pytest.raises(OptionError, match="1 are of joints, which are no path"):
        best_movement([arm], scene)
