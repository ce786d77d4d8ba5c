"""The verification of joint motions lets good ones pass and says clearly why others do not."""

import copy
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

from comove.errors import ComoveWarning, OptionError
from comove.lab.examples import example
from comove.model import Scene
from comove.robots import JointMotion, verify_joints
from comove.robots.verification import checks
from comove.robots.verification.bodies import warn_of_buried_links
from comove.robots.verification.checks import unfit_scene
from comove.robots.verification.verify import JointReport, VerifiedJointMotion, tightened
from comove.verification.verify import verify
from tests.robots.known_carry import (
    TABLE,
    baxter,
    followed,
    grasp_frames,
    known_carry,
    on_scene,
    posts,
    scene_data,
    uncertain_baxter,
)
from tests.robots.known_path import DURATION


def verified_on(joints=None, **scene):
    """The verdict on the known movement, or on other joints, on the benchmark's scene, or on another one."""
    motion, known = known_carry()
    if scene:
        motion = on_scene(motion, Scene.from_dict(scene_data(**scene)))
    return verify_joints(baxter(), motion, known if joints is None else joints)


def moved(joints, change):
    """The joints with something added to the positions."""
    return JointMotion(joints.time, joints.joint_names, joints.position + change)


def test_what_was_verified_with_slack_is_tightened_to_what_is_verified_without():
    motion, joints = known_carry()
    loose, tight = (verify_joints(baxter(), motion, joints, slack=slack) for slack in (1.0, 0.0))
    assert loose.report.clearance_scene < tight.report.clearance_scene - 1e-3
    verdict = tightened(loose.verified)
    assert repr(verdict.report) == repr(tight.report)
    assert verdict.verified.report is verdict.report and verdict.verified.joints is loose.verified.joints
    assert verdict.reasons == ()


def test_the_known_path_passes_the_benchmark_with_the_measures_of_its_notes():
    verdict = verified_on()
    assert verdict.reasons == ()
    report = verdict.verified.report
    assert report.joint_margin_min == pytest.approx(0.325, abs=0.005)
    assert report.velocity_ratio_max == pytest.approx(0.39, abs=0.01)
    assert report.hand_error_sampled < 1e-11
    assert report.hand_error_max < 3e-6
    assert report.hand_turn_max < 3e-6
    assert report.distance_error_max < 6e-6
    assert report.clearance_scene == pytest.approx(0.0303, abs=1.5e-3)
    assert report.clearance_self == pytest.approx(0.0859, abs=1.5e-3)
    assert report.load_mass == 0.25
    assert verdict.verified.scene.name == "posts"


def test_a_verified_motion_of_the_hands_is_not_verified_again():
    motion, joints = known_carry()
    verified = verify(motion).verified
    assert verify_joints(baxter(), verified, joints).verified.motion is verified


def test_only_the_verification_makes_verified_joint_motions():
    verified = verified_on().verified
    with pytest.raises(TypeError, match="verify_joints"):
        VerifiedJointMotion(
            verified.robot, verified.motion, verified.joints, verified.report, verified.course
        )
    with pytest.raises(AttributeError):
        verified.joints = None
    with pytest.raises(AttributeError):
        del verified.report
    with pytest.raises(TypeError, match="not pickled"):
        pickle.dumps(verified)
    assert copy.copy(verified) is verified
    assert copy.deepcopy(verified) is verified


def test_what_was_verified_cannot_be_changed_from_outside():
    motion, known = known_carry()
    mine = JointMotion(known.time.copy(), known.joint_names, known.position.copy())
    verified = verify_joints(baxter(), motion, mine).verified
    mine.position[500] += 1.0
    np.testing.assert_array_equal(verified.joints.position, known.position)
    with pytest.raises(ValueError, match="read-only"):
        verified.joints.position[0] = 0.0


def test_a_post_in_the_way_of_a_link_is_named_with_the_link_and_the_time():
    post = {"shape": "cylinder", "center": [0.75, 0.35, 0.5], "radius": 0.03, "height": 0.4}
    verdict = verified_on(obstacles=(TABLE, post))
    assert verdict.verified is None
    assert len(verdict.reasons) == 1
    assert "obstacles[1] (cylinder)" in verdict.reasons[0]
    assert "left_" in verdict.reasons[0]
    assert " s (0.005 m is to be kept)" in verdict.reasons[0]


def test_hands_that_carry_the_load_through_a_post_are_refused_before_the_joints():
    verdict = verified_on(obstacles=(TABLE, *posts(0.10)))
    assert verdict.verified is None
    assert all("the motion of the hands is not verified" in reason for reason in verdict.reasons)


def test_limits_clearance_replaces_what_links_keep():
    ball = {"shape": "sphere", "center": [0.75, 0.35, 0.6], "radius": 0.05}  # 41 mm above a forearm
    assert verified_on(obstacles=(TABLE, ball)).verified is not None
    assert verified_on(obstacles=(TABLE, ball), limits={"clearance": 0.04}).verified is not None
    (reason,) = verified_on(obstacles=(TABLE, ball), limits={"clearance": 0.045}).reasons
    assert "obstacles[1] (sphere)" in reason
    assert "0.045 m is to be kept" in reason


def test_on_a_robot_the_load_keeps_5_mm_where_the_scene_does_not_say():
    narrower = (TABLE, *posts(0.215))  # the stick passes these posts with 4 mm
    (reason,) = verified_on(obstacles=narrower).reasons
    assert "clearance 0.005 m asked for" in reason
    assert verified_on(obstacles=narrower, limits={"clearance": 0.003}).verified is not None


@pytest.mark.parametrize("duration", [3.0])
def test_a_motion_that_is_too_fast_says_which_joint_and_how_much_longer_to_take(duration):
    motion, joints = known_carry(duration)
    verdict = verify_joints(baxter(), motion, joints)
    assert verdict.verified is None
    assert verdict.report.velocity_ratio_max == pytest.approx(1.31, abs=0.02)
    fast = next(reason for reason in verdict.reasons if "moves at" in reason)
    assert "left_e1" in fast
    assert "(limit 1.5)" in fast
    assert "1.32 times as long" in fast


def test_a_joint_beyond_its_limits_is_named():
    robot, (motion, joints) = baxter(), known_carry()
    upper = robot.upper.copy()
    upper[3] = joints.position[:, 3].max() - 1e-4
    verdict = verify_joints(replace(robot, upper=upper), motion, joints)
    assert verdict.report.joint_margin_min == pytest.approx(-1e-4, rel=1e-2)
    assert any("left_e1 is 0.000101 rad beyond its limits" in reason for reason in verdict.reasons)


def test_a_joint_may_go_up_to_its_limits():
    robot, (motion, joints) = baxter(), known_carry()
    upper = robot.upper.copy()
    upper[3] = joints.curve(np.linspace(0, 10, 100_001))[:, 3].max() + 1e-9
    assert verify_joints(replace(robot, upper=upper), motion, joints).verified is not None


def test_motors_that_are_too_weak_are_named_with_the_mass():
    robot, (motion, joints) = baxter(), known_carry()
    verdict = verify_joints(replace(robot, effort=robot.effort * 0.5), motion, joints)
    assert any("left_s1 needs up to" in reason and "0.25 kg" in reason for reason in verdict.reasons)


def torque_reasons(scale, mass=0.25, duration=None):
    """Reasons against the known carry with motors that have a share of their efforts."""
    robot = replace(baxter(), effort=baxter().effort * scale)
    _, joints = known_carry()
    curve = joints.curve if duration is None else joints.stretched(duration).curve
    return checks.torques(robot, curve, robot.arms, np.full(2, 0.5 * mass)).reasons


def test_the_advice_on_a_torque_is_one_that_helps():
    """A slower pace is advised where the motion asks too much, otherwise a lighter load, or neither."""
    (too_fast,) = torque_reasons(0.68, duration=1.5)
    assert "move slower" in too_fast
    assert torque_reasons(0.68, duration=40.0) == []
    (too_heavy,) = torque_reasons(0.68, mass=6.0)
    assert "slower" not in too_heavy
    assert "which no pace changes; move nearer to the base, or less mass than 6 kg" in too_heavy
    assert torque_reasons(0.68, mass=6.0, duration=40.0)
    assert torque_reasons(0.68, mass=0.2) == []
    (too_weak,) = torque_reasons(0.5)
    assert "slower" not in too_weak
    assert "without the load of 0.25 kg as well" in too_weak
    assert torque_reasons(0.5, mass=0.0, duration=40.0)


def test_hands_that_drift_by_two_micrometres_are_refused():
    robot, (motion, joints) = baxter(), known_carry()
    frames = grasp_frames(motion, joints.time)
    frames[:, 0, 2, 3] += 2e-6 * np.sin(np.pi * joints.time / DURATION)
    verdict = verified_on(
        JointMotion(joints.time, joints.joint_names, followed(robot, frames, joints.position[0]))
    )
    assert len(verdict.reasons) == 1
    assert "the hand 'left' is off the load by 2e-06 m at 5.00 s" in verdict.reasons[0]


def test_hands_that_turn_by_two_microradians_are_refused():
    robot, (motion, joints) = baxter(), known_carry()
    frames = grasp_frames(motion, joints.time)
    for k, angle in enumerate(2e-6 * np.sin(np.pi * joints.time / DURATION)):
        turn = np.eye(3) + angle * np.array([[0, 0, 0], [0, 0, -1], [0, 1, 0]])
        frames[k, 1, :3, :3] = turn @ frames[k, 1, :3, :3]
    verdict = verified_on(
        JointMotion(joints.time, joints.joint_names, followed(robot, frames, joints.position[0]))
    )
    assert len(verdict.reasons) == 1
    assert "the hand 'right' is turned by 2e-06 rad at 5.00 s" in verdict.reasons[0]


def test_an_edited_sample_is_refused_and_found():
    _, joints = known_carry()
    change = np.zeros_like(joints.position)
    change[321, 9] = 1e-4
    verdict = verified_on(moved(joints, change))
    assert any(
        "the hand 'right' is off the load" in reason and "3.21 s" in reason for reason in verdict.reasons
    )


def test_samples_that_are_exact_but_too_few_are_refused_for_what_may_be_between():
    _, joints = known_carry(rate=5.0)
    verdict = verified_on(joints)
    assert verdict.report.hand_error_sampled < 1e-11
    assert any("between two samples" in reason and "more finely" in reason for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda j: replace(j, joint_names=j.joint_names[::-1]), "in this order"),
        (lambda j: replace(j, position=j.position[:, :-1]), "a position of 14 joints"),
        (lambda j: replace(j, position=j.position[:-1]), "two samples or more"),
        (lambda j: replace(j, time=j.time[:1], position=j.position[:1]), "two samples or more"),
        (lambda j: replace(j, time=j.time[::-1]), r"does not come after time\[0\]"),
        (lambda j: replace(j, time=j.time + 0.1), "lasts from 0.1 s to 10.1 s"),
        (lambda j: j.stretched(9.0), "stretch it"),
        (
            lambda j: moved(j, np.where(np.arange(1001) == 7, np.nan, 0.0)[:, None]),
            r"position\[7, 0\] is nan",
        ),
        (lambda j: moved(j, 1e300), r"position\[0, 0\] is 1e\+300"),
        (lambda j: replace(j, position=np.full((1001, 14), "a")), "no numbers"),
    ],
)
def test_samples_that_are_no_motion_of_the_robot_are_refused_in_words(edit, told):
    verdict = verified_on(edit(known_carry()[1]))
    assert verdict.verified is None
    assert verdict.report.asdict().keys() == JointReport().asdict().keys()
    with pytest.raises(AssertionError, match=told):
        raise AssertionError(verdict.reasons[0])


def test_a_scene_that_no_robot_can_carry_out_is_refused_in_words():
    _, joints = known_carry()
    bare = Scene.from_dict({k: v for k, v in scene_data().items() if k != "grasp"})
    motion = on_scene(
        known_carry()[0], Scene.from_dict(scene_data(grasp=None, constraints=[{"type": "upright"}]))
    )
    assert bare.grasp is None
    assert "grasp: {orientation: down}" in verify_joints(baxter(), motion, joints).reasons[0]


def test_a_planar_scene_and_hands_without_arms_are_refused_in_words():
    motion, joints = known_carry()
    (reason,) = unfit_scene(baxter(), example("narrow"))
    assert "three coordinates" in reason
    data = scene_data()
    data["manipulators"][0]["name"] = "lefty"
    (reason,) = verify_joints(baxter(), on_scene(motion, Scene.from_dict(data)), joints).reasons
    assert "has no arm 'lefty'" in reason
    assert "did you mean 'left'" in reason


def test_something_else_than_a_motion_of_hands_is_an_error():
    with pytest.raises(OptionError, match="give the VerifiedMotion"):
        verify_joints(baxter(), known_carry()[1], known_carry()[1])


@pytest.mark.parametrize("top", [-0.15, 0.0])
def test_what_a_base_stands_on_or_in_is_no_fault_of_the_motion(top):
    """A plate through the robot's pedestal: neither moves, and links that move keep clear of both."""
    plate = {"shape": "box", "center": [0.0, 0.0, top - 0.025], "size": [0.3, 0.3, 0.05]}
    verdict = verified_on(obstacles=(plate, *posts(0.30)))
    assert verdict.verified is not None and verdict.report.clearance_scene >= 0.005
    near, _ = verdict.report.where["clearance_scene"]
    assert not near.startswith(("pedestal", "base", "torso"))


@pytest.mark.parametrize(("top", "is_deep"), [(-0.93, False), (-0.5, True)])
def test_a_base_deep_in_an_obstacle_is_warned_of(top, is_deep):
    """A floor under the pedestal may touch it; one that swallows it is named, with how deep it is."""
    floor = {"name": "floor", "shape": "box", "center": [0.0, 0.0, top - 0.5], "size": [2.0, 2.0, 1.0]}
    scene = Scene.from_dict(scene_data(obstacles=[floor]))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ComoveWarning)
        warn_of_buried_links(baxter(), scene)
    words = [str(warning.message) for warning in told]
    assert bool(words) == is_deep, words
    assert all("m deep in floor (box)" in line and "not checked" in line for line in words)


def test_a_load_that_touches_the_robot_is_refused():
    load = scene_data()["load"] | {"radius": 0.13}
    workspace = {"lower": [0.0, -1.4, -0.3], "upper": [1.4, 1.4, 1.0]}
    (reason,) = verified_on(obstacles=(), load=load, workspace=workspace, limits={"clearance": 0.06}).reasons
    assert reason.startswith("torso and the load come within")
    assert "another grasp" in reason


def test_arms_that_meet_are_refused():
    _, joints = known_carry()
    crossed = joints.position.copy()
    crossed[:, [0, 7]] += np.array([-0.9, 0.9]) * np.sin(np.pi * joints.time / DURATION)[:, None] ** 2
    verdict = verified_on(JointMotion(joints.time, joints.joint_names, crossed))
    reason = next(reason for reason in verdict.reasons if "SRDF" in reason)
    assert "left_" in reason or "l_gripper" in reason
    assert "right_" in reason or "r_gripper" in reason
    assert verdict.report.clearance_self < 0.005


def test_bases_that_may_stand_elsewhere_take_from_the_clearance():
    motion, joints = known_carry()
    sure = verify_joints(baxter(), motion, joints).report
    unsure = verify_joints(uncertain_baxter(position=0.01), motion, joints)
    assert unsure.report.hand_uncertainty == pytest.approx(0.01)
    assert unsure.report.clearance_scene == pytest.approx(sure.clearance_scene - 0.01, abs=1e-3)
    assert unsure.report.clearance_self == pytest.approx(sure.clearance_self, abs=1e-6)  # on one base
    assert unsure.verified is not None
    turned = verify_joints(uncertain_baxter(rotation_deg=1.0), motion, joints)
    reach = np.linalg.norm(motion.hands(np.linspace(0.0, 1.0, 1001))[0], axis=2).max()
    assert turned.report.hand_uncertainty == pytest.approx(np.deg2rad(1.0) * reach, rel=1e-6)
    assert any("0.005 m is to be kept" in reason for reason in turned.reasons)
    far = verify_joints(uncertain_baxter(position=0.029), motion, joints)
    assert any("where the bases stand" in reason for reason in far.reasons)
