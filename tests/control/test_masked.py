"""What constraints keep of a payload's pose is kept step by step too, with an obstacle that moves in the way."""

from copy import deepcopy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.control.executor import Executor
from comove.control.safety.cbf_qp import SafetyFilter, Sighting
from comove.control.safety.twists import advanced, hand_velocities, nodes_of
from comove.geometry.rotations import matrices
from comove.model import Scene
from comove.model.coordinates import HandPoses
from comove.verification.record import verify_execution

AXIS = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
SCENE = {
    "version": 2,
    "name": "met",
    "duration": 4.0,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "obstacles": [
        {"shape": "sphere", "center": [0.5, 0.1, 0.5], "radius": 0.06, "motion": {"velocity": [0, 0.1, 0]}}
    ],
    "payload": {"shape": "box", "size": [0.3, 0.1, 0.05], "start": {"position": [0.3, 0.3, 0.5]}},
    "grasps": {"a": {"position": [-0.15, 0, 0]}, "b": {"position": [0.15, 0, 0]}},
}


@pytest.mark.parametrize(
    ("constraint", "turn"),
    [
        ({"type": "planar"}, Rotation.from_euler("z", 90, degrees=True)),
        ({"type": "axis", "axis": [1, 1, 0]}, Rotation.from_rotvec(1.2 * AXIS)),
        ({"type": "upright", "tolerance_deg": 10}, Rotation.from_euler("xyz", [0, 6, 90], degrees=True)),
    ],
)
def test_an_execution_keeps_what_is_kept(constraint, turn):
    data = deepcopy(SCENE) | {"constraints": [constraint]}
    quaternion = turn.as_quat(scalar_first=True).tolist()
    data["payload"]["goal"] = {"position": [0.7, 0.7, 0.5], "quaternion_wxyz": quaternion}
    executor = Executor(Scene.from_dict(data), seed=0)
    record = executor.run(20.0)
    report = verify_execution(record, executor.blocker)
    assert report.reasons == ()
    turned = Rotation.from_quat(record.quaternion[:, 0], scalar_first=True)
    if constraint["type"] == "upright":
        leaning = np.arctan2(np.hypot(*turned.as_matrix()[:, :2, 2].T), turned.as_matrix()[:, 2, 2])
        assert leaning.max() <= report.tilt_max <= np.deg2rad(10.0)
        return
    kept = AXIS if constraint["type"] == "axis" else [0.0, 0.0, 1.0]
    assert np.linalg.norm(np.cross(turned.as_rotvec(), kept), axis=1).max() < 1e-9
    if constraint["type"] == "planar":
        assert np.ptp(record.center[:, 0, 2]) < 1e-9


def test_a_body_at_its_tolerance_may_turn_sideways_and_leans_no_further():
    """To first order nothing leans further as it turns about the direction in which it leans; in a step it does."""
    tilt = np.deg2rad(10.0)
    data = deepcopy(SCENE) | {"constraints": [{"type": "upright", "tolerance_deg": 10}]}
    data["payload"]["goal"] = {"position": [0.7, 0.7, 0.5], "rpy_deg": [0, 6, 90]}
    scene = Scene.from_dict(data)
    safety, period = SafetyFilter(scene, period=0.02), 0.02
    turned = Rotation.from_rotvec([tilt - 1e-9, 0.0, 0.0])
    center = np.array([[0.4, 0.6, 0.5]])
    poses = HandPoses(center, turned.as_quat(scalar_first=True)[None])
    before, leaning = np.zeros((2, 3)), []
    for _ in range(40):
        up = matrices(poses.quaternion[0])[:, 2]
        spin = 2.0 * np.array([up[0], up[1], 0.0]) / np.hypot(up[0], up[1])
        hands = nodes_of(scene, poses)[:2]
        wanted = np.cross(spin, hands - poses.center[0])
        twists = safety.allowed(poses, before, wanted, Sighting.still(scene)).twists
        before, poses = hand_velocities(scene, poses, twists), advanced(poses, twists, period)
        up = matrices(poses.quaternion[0])[:, 2]
        leaning.append(np.arctan2(np.hypot(up[0], up[1]), up[2]))
    assert np.linalg.norm(twists[:, 3:]) > 0.1
    assert max(leaning) <= tilt + 1e-12
