"""Meshes that pass each other between two instants are nearer there than at both: what is certified says so."""

import numpy as np
import pytest

from comove.model import Scene
from comove.robots import JointMotion, Robot
from comove.robots.verification.bodies import SCENE, bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import JointCertificateSettings, certify
from comove.robots.verification.kinematics import Bases
from tests.meshes import write_obj
from tests.robots.small_robots import urdf, written
from tests.robots.test_model import joint, link

LENGTH, DURATION = 0.8, 1.0  # m, s
LIMIT = ' <limit lower="-9" upper="9" effort="300" velocity="50"/>'
MASS = '<inertial><mass value="1"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial>'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A bent strip, which is not convex, with its tip farthest out; and a speck as an obstacle."""
    folder = tmp_path_factory.mktemp("far")
    strip = np.array([[0, 0, 0], [0.4, 0.03, 0], [LENGTH, 0, 0], [0.4, 0.03, 0.01]], dtype=float)
    write_obj(folder / "strip.obj", strip, np.array([[0, 1, 3], [1, 2, 3]]))
    speck = 1e-5 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    write_obj(folder / "speck.obj", speck, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    return folder


@pytest.fixture(scope="module")
def robot(folder):
    """An arm that turns the strip about the vertical axis."""
    body = MASS + '<collision><geometry><mesh filename="strip.obj"/></geometry></collision>'
    text = urdf(
        link("arm", body)
        + joint("turn", "base", "arm", "revolute", LIMIT, axis="0 0 1", xyz="0 0 0.3")
        + link("hand", MASS)
        + joint("slide", "arm", "hand", "prismatic", LIMIT, axis="1 0 0", xyz=f"{LENGTH} 0 0")
    )
    arms = {"left": {"tip": "hand"}}
    return Robot.load(written(folder, {"r.urdf": text}, {"models": [{"urdf": "r.urdf"}], "arms": arms}))


@pytest.mark.parametrize("slack", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("parts", [1, 4])
@pytest.mark.parametrize("gap", [0.3, 2.0, 6.0])
def test_a_tip_that_passes_between_two_instants_is_nearest_there(folder, robot, gap, parts, slack):
    """At the speed w the distance dips by r (w t)² / 2 (1 + r / gap), which no straight line between ends shows."""
    for angle in np.linspace(-0.31, 0.29, 7):  # of the speck; the tip goes from -0.4 to 0.4 rad
        speck = (LENGTH + gap) * np.array([np.cos(angle), np.sin(angle), 0.0]) + [0.0, 0.0, 0.3]
        ends = [{"start": [0, y, 6], "goal": [0.3, y, 6]} for y in (0.15, -0.15)]
        scene = Scene.from_dict(
            {
                "name": "far",
                "duration": DURATION,
                "workspace": {"lower": [-9] * 3, "upper": [9] * 3},
                "load": {"shape": "bar", "length": 0.3, "radius": 0.02, "mass": 0.1},
                "manipulators": [{"name": n, **e} for n, e in zip(("left", "right"), ends, strict=True)],
                "obstacles": [{"shape": "mesh", "file": "speck.obj", "center": speck.tolist()}],
            },
            folder=folder,
        )
        time = np.linspace(0.0, DURATION, 5)
        q = np.stack([np.interp(time, [0.0, DURATION], [-0.4, 0.4]), np.zeros(5)], axis=1)
        motion = JointMotion(time, robot.joint_names, q)
        carried = Carried.straight(scene)
        bases = Bases(robot, robot.description.uncertainty)
        hands = carried.hands(carried.time).positions
        bodies = bodies_of(bases, (robot.arm("left"),) * 2, carried, hands, 1e-9, holding=())
        settings = JointCertificateSettings(parts=parts)
        found = certify(bodies, carried, motion.curve, slack, settings)[SCENE]
        assert 0.5 * gap < found.lower <= gap + 1e-9
