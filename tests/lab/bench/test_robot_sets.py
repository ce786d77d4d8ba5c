"""Every frozen scene of robots can be solved, as its witness of joints shows, and no straight motion does."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from comove.data.carried import robot_of
from comove.lab.bench.robot_drawing import JointWitness
from comove.lab.bench.runner import jobs_of, run
from comove.lab.bench.sets import SETS, RobotSet, draw_set, own_scenes, scene_text, scenes_of
from comove.lab.bench.workplaces import ROBOT_DIFFICULTIES, WORKPLACES
from comove.lab.registry import systems_named
from comove.model import Scene
from comove.model.motion import CoordinatedMotion
from comove.robots import RobotCarrier
from comove.robots.search.chains import turned_towards
from comove.robots.search.links import FATTEST
from comove.verification.verify import verify
from tests.lab.bench.witnesses import witness_of

ROBOTS = [name for name, one in SETS.items() if isinstance(one, RobotSet)]
FROZEN = [(name, scene) for name in ROBOTS for scene in scenes_of(name)]
SOME = {scene.path for name in ROBOTS for scene in scenes_of(name)[2:3]}  # two UR10


@pytest.mark.parametrize(
    "name, frozen",
    [
        pytest.param(
            name,
            scene,
            id=f"{name}-{scene.name}",
            marks=() if scene.path in SOME else pytest.mark.slow,
        )
        for name, scene in FROZEN
    ],
)
def test_the_witness_is_verified_with_room_to_spare(name, frozen):
    scene, spare = frozen.load(), ROBOT_DIFFICULTIES[name].spare
    assert spare > scene.clearance
    verdict = witness_of(frozen, scene).judged(scene.limited(clearance=spare))
    assert verdict.reasons == ()


@pytest.mark.parametrize("name, frozen", FROZEN, ids=[f"{name}-{scene.name}" for name, scene in FROZEN])
def test_the_straight_motion_is_not_possible(name, frozen):
    scene = frozen.load()
    assert scene.file.robot in WORKPLACES
    low, high = ROBOT_DIFFICULTIES[name].obstacles
    assert low <= len(scene.file.obstacles) <= high
    assert verify(CoordinatedMotion.straight(scene)).reasons


@pytest.mark.parametrize("frozen", [scene for scene in scenes_of("robots-extreme") if "baxter" in scene.name])
def test_a_search_knows_the_joints_with_which_a_witness_ends(frozen):
    """Also where what is nearer to home touches something: what touches nothing comes first."""
    scene, far = frozen.load(), 0.6  # rad; another branch is further away, a redundant arm at rest nearer
    carrier = RobotCarrier(robot_of(scene), scene)
    witness, first = witness_of(frozen, scene).position, carrier.arms.chains.first
    for joints, known in ((witness[0], carrier.starts), (witness[-1], carrier.goals)):
        for i, arm in enumerate(carrier.holders):
            part, wanted = slice(first[i], first[i + 1]), joints[arm.columns]
            turned = turned_towards(carrier.arms.chains, wanted[None], known[i], part)
            assert np.abs(turned - wanted).max(axis=1).min() < far


def test_ends_in_which_an_arm_touches_nothing_come_first():
    scene = scenes_of("robots-extreme")[17].load()
    carrier = RobotCarrier(robot_of(scene), scene)
    first, posture = carrier.arms.chains.first, carrier.arms.around.posture
    for end, known in (("start", carrier.starts), ("goal", carrier.goals)):
        for i, branches in enumerate(known):
            joints = np.repeat(posture[None], len(branches), axis=0)
            joints[:, first[i] : first[i + 1]] = branches
            links = carrier.arms.links.of(i)
            apart = carrier.ends.clearances(joints, scene.nodes_at(end), links)
            assert (np.diff((apart <= 0.0).astype(int)) >= 0).all() and (
                apart > scene.clearance - FATTEST
            ).all()


@pytest.mark.slow
def test_scenes_are_drawn_again_as_they_are_frozen():
    frozen = scenes_of("robots-easy")[2]
    data, witness = SETS["robots-easy"].draw(2)
    assert scene_text(data) == frozen.path.read_text(encoding="utf-8")
    kept = witness_of(frozen, frozen.load())
    assert witness.position == pytest.approx(kept.position, abs=1e-6)


def test_a_witness_that_ends_elsewhere_or_touches_something_is_no_witness():
    """A joint that is 1 mrad off in between, or an obstacle in the way."""
    frozen = scenes_of("robots-easy")[2]
    scene = frozen.load()
    witness = witness_of(frozen, scene)
    moved = witness.position.copy()
    moved[len(moved) // 2, 0] += 1e-3
    assert JointWitness(witness.weights, moved).judged(scene).verified is None
    middle = witness.motion(scene).hands(np.array([0.5]))[0, 0].mean(axis=0)
    ball = {"shape": "sphere", "center": middle.tolist(), "radius": 0.01}
    within = Scene.from_dict({**scene.file.model_dump(exclude_none=True), "obstacles": [ball]})
    assert witness.judged(within).verified is None


def test_systems_that_move_hands_refuse_robots():
    jobs = jobs_of(scenes_of("robots-easy", 1), systems_named(["paper", "leader-follower", "ompl-aorrtc"]))
    for job in jobs:
        row = run(job)
        assert (row.status, row.message) == (
            "refused",
            "It moves hands, and the scene asks for a robot's joints.",
        )


@pytest.mark.slow
def test_from_a_drawn_scene_to_a_delivered_load(tmp_path):
    draw_set("robots-easy", tmp_path / "mine", count=3, seed=4)
    assert (tmp_path / "mine" / "witnesses.npz").exists()
    (ur10,) = [scene for scene in own_scenes([tmp_path / "mine"]) if scene.name.startswith("two_ur10")]
    (job,) = jobs_of([ur10], systems_named(["comove"]), budget=20.0)
    row = run(job)
    assert row.status == "verified", row.message
    assert 0 < row.figures.first_verified <= row.figures.seconds
    assert row.figures.clearance_min >= 0.005
