"""What a search hands its motions to: arms follow, the judge speaks, and the last answer is remembered."""

import re

import pytest

from comove.errors import SceneError
from comove.planning import solve
from comove.robots import VerifiedJointMotion
from comove.robots.check import RobotCheck
from comove.robots.search.carrying import Carrying, robot_method
from comove.scenes import Scene
from comove.verification import verify
from tests.robots.known_carry import TABLE, known_carry, on_scene, scene_data
from tests.robots.small_robots import gantry_scene, movement, robot, task


def test_a_motion_that_the_robot_can_carry_out_has_no_reasons_against_it():
    motion, _ = known_carry()
    check = RobotCheck(Carrying(robot("baxter"), motion.scene))
    assert check(motion) == ()
    done = check.carried_out(motion)
    assert isinstance(done.verdict.verified, VerifiedJointMotion)
    assert check.carried_out(motion) is done  # asked again, it is not judged again
    assert verify(motion, [check]).verified is not None
    assert check.carried_out(motion) is done
    other = movement(motion.scene)
    assert check.carried_out(other) is not done


def test_a_motion_out_of_reach_is_refused_with_arm_instant_and_distance():
    check = RobotCheck(Carrying(robot("gantry"), gantry_scene(())))
    (reason,) = check(movement(check.task.scene, (0.0, 0.8)))
    told = re.fullmatch(
        r"the arm 'right' does not reach its hand's pose at (\S+) s: (\S+) m are missing", reason
    )
    assert float(told[1]) == pytest.approx(3.0, abs=0.3)
    assert float(told[2]) == pytest.approx(0.15, abs=0.01)
    done = check.carried_out(movement(check.task.scene, (0.0, 0.8)))
    assert done.verdict.verified is None
    assert done.joints.duration == 6.0


def test_what_the_judge_of_joints_has_against_a_motion_are_the_reasons():
    motion, _ = known_carry()
    post = {"shape": "cylinder", "center": [0.75, 0.35, 0.5], "radius": 0.03, "height": 0.4}
    scene = Scene.from_dict(scene_data(obstacles=(TABLE, post)))
    check = RobotCheck(Carrying(robot("baxter"), scene))
    reasons = check(on_scene(motion, scene))
    assert any("obstacles[1] (cylinder)" in reason for reason in reasons)
    verdict = verify(on_scene(motion, scene), [check])
    assert verdict.verified is None
    assert set(reasons) <= set(verdict.reasons)


def test_ends_out_of_reach_are_told_before_a_search_begins():
    file = gantry_scene(()).file.model_dump(mode="json", exclude_none=True)
    file["workspace"] = {"lower": [-2, -2, 0], "upper": [2, 2, 1]}
    for hand in file["manipulators"]:
        hand["goal"][0] = 1.5
    with pytest.raises(SceneError, match="'left' cannot reach its goal"):
        RobotCheck(Carrying(robot("gantry"), Scene.from_dict(file))).prepare()


def test_a_search_with_the_gantry_ends_with_verified_joints():
    """From a scene whose straight way is blocked to joints that the judge takes."""
    carrying = task("gantry")
    check = RobotCheck(carrying)
    check.prepare()
    solution = solve(
        carrying.scene, method=robot_method(), carrier=carrying, checks=[check], budget=20.0, seed=1
    )
    assert solution.verified
    done = check.carried_out(solution.attempt)
    assert done.verdict.reasons == ()
    assert done.verdict.report.clearance_scene >= 0.005
