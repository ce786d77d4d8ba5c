"""Many scenes on several processes: what each gives is what `solve` gives."""

import numpy as np
import pytest

import comove
from comove.data import many
from comove.errors import OptionError
from comove.lab.examples import example_path
from comove.model import demonstration_of
from comove.planning import PaperCost
from comove.planning.methods import Quick
from tests.robots.small_robots import gantry, gantry_scene, robot


def scenes(*goals):
    """The wide scene with goals at several heights [m]."""
    for goal in goals:
        scene = comove.Scene.load(example_path("wide"))
        hands = [
            {**hand, "goal": [hand["goal"][0], hand["goal"][1] + goal]}
            for hand in scene.file.model_dump()["manipulators"]
        ]
        yield comove.Scene.from_dict(scene.file.model_dump() | {"manipulators": hands}, folder=scene.folder)


def test_each_scene_gives_what_solve_gives():
    given = list(scenes(0.0, 0.05))
    found = sorted(comove.solve_many(given, workers=2, seed=3), key=lambda one: one.number)
    assert [one.number for one in found] == [0, 1]
    for one, scene in zip(found, given, strict=True):
        alone = comove.solve(scene, demonstration=demonstration_of(scene), seed=3)
        assert one.verified and one.reasons == ()
        assert np.array_equal(one.solution.attempt.weights, alone.attempt.weights)
        assert one.solution.report == alone.report
        assert one.found.motion is None  # a seal does not pass between processes
        assert one.solution.verified and one.motion is one.solution.motion
        assert one.motion.clearance_min == alone.motion.clearance_min


@pytest.mark.slow
def test_a_robot_carries_as_it_does_alone(tmp_path):
    """Named by the scenes or given, as a name or loaded; joints are verified anew here, and none are left out."""
    named = gantry_scene().file.model_dump(mode="json", exclude_none=True)
    named["robot"] = str(gantry(tmp_path))
    scene = comove.Scene.from_dict(named, folder=tmp_path)
    alone = comove.solve(scene, seed=3, effort="quick")
    assert alone.verified
    given = {"robot": robot("gantry")}, {"robot": named["robot"]}, {}
    for options in given:
        of = scene if not options else gantry_scene()
        (one,) = comove.solve_many([of], workers=1, seed=3, effort="quick", **options)
        assert one.status == "verified" and one.solution.verified and one.reasons == ()
        joints = one.solution.joints
        assert joints.motion.motion.motion is one.solution.attempt
        np.testing.assert_array_equal(joints.attempt.position, alone.joints.attempt.position)
    (free,) = comove.solve_many([scene], workers=1, robot=False)
    assert free.verified and free.solution.joints is None
    scene = comove.Scene.from_dict(named | {"robot": "none.yaml"}, folder=tmp_path)
    (refused,) = comove.solve_many([scene], workers=1)
    assert refused.status == "refused" and "none.yaml" in refused.reasons[0]


def test_kernels_are_compiled_before_processes_that_would_compile_alone(monkeypatch):
    done = []
    monkeypatch.setattr(many, "require", lambda *names: done.append({*names}))
    monkeypatch.setattr(many, "run_tasks", lambda *_, **__: done.append("processes") or ())
    list(comove.solve_many(scenes(0.0), workers=2))
    assert done == [{"planar plans", "planar motions"}, "processes"]


@pytest.mark.slow
def test_scenes_are_taken_as_they_are_needed():
    taken = []

    def endless():
        for number, scene in enumerate(scenes(*[0.0] * 100)):
            taken.append(number)
            yield scene

    solving = comove.solve_many(endless(), workers=1, method=Quick())
    assert next(solving).verified
    solving.close()
    assert len(taken) <= 3


@pytest.mark.slow
def test_an_error_in_one_scene_leaves_the_others_alone():
    blocked = comove.Scene.load(example_path("wide"), {"demonstration": {"lasa": "NoShape"}})
    found = {one.number: one for one in comove.solve_many([blocked, *scenes(0.0)], workers=1)}
    assert found[0].status == "refused" and "NoShape" in found[0].reasons[0]
    assert found[0].motion is None and found[0].solution is None
    assert found[1].verified


@pytest.mark.slow
def test_options_reach_the_search():
    (found,) = comove.solve_many(scenes(0.0), workers=1, objective=PaperCost(), budget=2.0)
    assert isinstance(found.solution.objective, PaperCost)


def test_bad_options_are_refused_at_once():
    with pytest.raises(OptionError, match="workers = 0"):
        comove.solve_many([], workers=0)
    with pytest.raises(OptionError, match="effort"):
        comove.solve_many([], effort="hard")
    with pytest.raises(OptionError, match="budget = -1; give a positive number of seconds"):
        comove.solve_many([], budget=-1)
    assert list(comove.solve_many([])) == []
