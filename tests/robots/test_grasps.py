"""Which grasp is taken where a scene leaves it open, and that it holds: by Pinocchio, from the stored scene."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import comove
from comove.errors import SceneError
from comove.model import Scene
from comove.planning import Budget
from comove.planning.solver import problem_of
from comove.robots import JointVerdict, Robot, ends, solving
from comove.robots.ends import EndJoints
from comove.robots.files import read_joints
from comove.view.figures import save_result
from tests.robots.small_robots import CAMERA, lifts_scene, robot

EXAMPLE = Path(__file__).parents[2] / "examples" / "robots" / "from_the_side.yaml"


def example(**grasp):
    scene = Scene.load(EXAMPLE)
    return Scene.from_dict({**scene.file.model_dump(), "grasp": grasp}) if grasp else scene


@pytest.mark.slow
def test_a_bar_is_carried_from_the_side_where_hands_from_above_do_not_reach():
    robot, scene = Robot.load("two_xarm7"), example()
    found = comove.solve(scene, robot=robot, seed=0)
    assert found.verified
    chosen = found.scene
    assert len(chosen.alternatives) == 1
    assert chosen.file.grasp.orientation == "forward"
    assert chosen.sha256 in {choice.sha256 for choice in scene.alternatives}
    for q in found.joints.attempt.position[::200]:
        poses = [robot.tool_pose(q, arm) for arm in (robot.arm("left"), robot.arm("right"))]
        places = np.array([pose[:3, 3] for pose in poses])
        for pose, wanted in zip(poses, chosen.grasp.hand_rotations(places), strict=True):
            np.testing.assert_allclose(pose[:3, :3], wanted, atol=1e-6)
            assert abs(pose[2, 2]) < 1e-6  # the approach is level


@pytest.mark.slow
def test_a_grasp_by_which_nobody_reaches_is_told():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = example(any_of=[{"orientation": "down"}, {"orientation": "forward", "offset_deg": 90}])
    with pytest.raises(SceneError, match="cannot reach"):
        comove.solve(scene, robot=Robot.load("two_xarm7"), budget=1.0)


@pytest.mark.slow
def test_the_mesh_of_a_scene_is_found_from_the_results_folder(tmp_path):
    scene = Scene.load(EXAMPLE.with_name("over_a_sill.yaml"))
    found = comove.solve(scene, robot=Robot.load("two_ur10"), seed=0)
    assert found.verified
    save_result(found, tmp_path, wall_time_s=1.0)
    assert read_joints(tmp_path).scene.sha256 == found.scene.sha256, "the mesh is found, and the same one"


@pytest.mark.parametrize("missed", [(), (-90,), (90,), (-90, 90)], ids=str)
def test_grasps_missed_from_the_first_seeds_come_last_and_are_solved_from_all(monkeypatch, missed):
    """The seeds that are solved first are said to miss the poses of some grasps."""
    solved, patiently, asked = EndJoints._solutions, ends.patiently_solved, []

    def misses(self, *pose):
        joints, missing = solved(self, *pose)
        return joints, missing + (self.scene.file.grasp.offset_deg in missed)

    monkeypatch.setattr(EndJoints, "_solutions", misses)
    monkeypatch.setattr(ends, "patiently_solved", lambda *pose: asked.append(pose) or patiently(*pose))
    scene = lifts_scene(grasp={"any_of": [{"orientation": "down", "offset_deg": turn} for turn in (-90, 90)]})
    found, n_asked = [], []
    for way in solving._clear_ways(scene, robot("lifts"), {}, kept=True):
        found.append(way and way[0].file.grasp.offset_deg)
        n_asked.append(len(asked))
    at_once = [turn for turn in (-90, 90) if turn not in missed]
    assert sorted(found[: len(at_once)]) == at_once and not any(n_asked[: len(at_once)])
    rest = found[len(at_once) :]
    assert rest[: bool(at_once and missed)] == [None] * bool(at_once and missed)
    assert sorted(filter(None, rest)) == sorted(missed)


def test_a_grasp_missed_from_the_first_seeds_is_searched_where_others_lead_to_nothing(monkeypatch):
    solved, carried, searched = EndJoints._solutions, solving._carried, []

    def misses(self, *pose):
        joints, missing = solved(self, *pose)
        return joints, missing + (self.scene.file.grasp.offset_deg == -90)

    def searching(scene, *rest):
        solution = yield from carried(scene, *rest)
        if len(scene.alternatives) > 1:  # the whole, which calls for each grasp
            return solution
        searched.append(turn := scene.file.grasp.offset_deg)
        nothing = replace(solution.joints, verdict=JointVerdict(None, solution.joints.report, ("nothing",)))
        return solution if turn == -90 else replace(solution, joints=nothing)

    monkeypatch.setattr(EndJoints, "_solutions", misses)
    monkeypatch.setattr(solving, "_carried", searching)
    scene = lifts_scene(grasp={"any_of": [{"orientation": "down", "offset_deg": turn} for turn in (-90, 90)]})
    found = comove.solve(scene, robot=robot("lifts"), budget=5.0)
    assert searched == [90, -90] and found.verified and found.scene.file.grasp.offset_deg == -90


@pytest.mark.parametrize("away", [0.03, 0.3])
def test_exact_bodies_decide_on_grasps_only_where_capsules_are_near(monkeypatch, away):
    """A ball is beside the camera of the left hand at the start."""
    contact, asked = EndJoints.contact, []
    monkeypatch.setattr(EndJoints, "contact", lambda self, *end: asked.append(end[0]) or contact(self, *end))
    grasps = {"any_of": [{"orientation": "down", "offset_deg": turn} for turn in (-90, 90)]}
    scene = lifts_scene(grasp=grasps)
    turned = scene.alternatives[0].grasp.hand_rotations(scene.start)[0]
    place = scene.start[0] + (CAMERA[0] + np.copysign(away, CAMERA[0])) * turned[:, 0] + [0.0, 0.0, CAMERA[2]]
    ball = {"shape": "sphere", "center": place.tolist(), "radius": 0.01}
    comove.solve(lifts_scene((ball,), grasp=grasps), robot=robot("lifts"), budget=Budget(work=0.2))
    assert bool(asked) == (away < 0.1)


def test_grasps_that_collide_at_an_end_are_left_out_before_anything_is_searched(monkeypatch):
    """A ball is where the camera of the left hand is at the start, if the hands are turned the one way."""
    grasps = [{"orientation": "down", "offset_deg": turn} for turn in (-90, 90)]
    hands = [
        {"name": name, "start": [0.4, y, 0.3], "goal": [0.43, y, 0.3]}
        for name, y in (("left", 0.25), ("right", -0.25))
    ]
    wanted = {"manipulators": hands, "grasp": {"any_of": grasps}, "duration": 0.1}  # too short for any
    searched = []

    def counted(scene, **how):
        searched.append(scene.file.grasp.offset_deg)
        return problem_of(scene, **how)

    monkeypatch.setattr(solving, "problem_of", counted)
    balls = []
    scene = lifts_scene(**wanted)
    for choice in scene.alternatives:
        turned = choice.grasp.hand_rotations(scene.start)[0]
        place = scene.start[0] + CAMERA[0] * turned[:, 0] + [0.0, 0.0, CAMERA[2]]
        balls.append({"shape": "sphere", "center": place.tolist(), "radius": 0.02})
    for ball, other in zip(balls, reversed(grasps), strict=True):
        searched.clear()
        scene = lifts_scene((ball,), **wanted)
        assert not comove.solve(scene, robot=robot("lifts"), budget=Budget(work=0.2)).verified
        assert set(searched) == {other["offset_deg"]}
    searched.clear()
    with pytest.raises(
        SceneError, match=r"left_wrist and obstacles\[0\] \(sphere\) come too near .* at the start"
    ):
        comove.solve(lifts_scene(tuple(balls), **wanted), robot=robot("lifts"))
    assert not searched
