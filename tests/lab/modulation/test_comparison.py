"""Every method on one scene: the judge is the same, and what it says agrees with plain sums over samples."""

import numpy as np
import pytest

from benchmarks.random_scenes import moving_scene
from comove.control import Executor
from comove.lab.examples import example
from comove.lab.modulation import Sharing
from comove.lab.modulation.comparison import METHODS, LooseRecord, compare, loose_run
from comove.verification.record import verify_execution
from tests.control.test_executor import crossing, disc

TURNING = example("turning")


@pytest.fixture(scope="module")
def compared():
    return compare(Executor(TURNING).run(12.0), 12.0)


def test_every_method_is_there_in_order(compared):
    rows, interrupted = compared
    assert tuple(c.method for c in rows) == METHODS
    assert not interrupted


def test_what_the_judge_says_agrees_with_sums_over_samples(compared):
    """The bar is a segment between the hands, 5 mm thick; the disc goes where its waypoints say."""
    for c in compared[0]:
        hands, time = c.record.position, c.record.time
        points = hands[:, :1] + np.linspace(0, 1, 401)[:, None] * (hands[:, 1:] - hands[:, :1])
        waypoints = np.array([[0.7, 0.9], [0.7, 0.7], [0.5, 0.5], [0.2, 0.2]])
        way = [np.interp(time, [0.0, 1.2, 2.5, 4.5], column) for column in waypoints.T]
        away = np.linalg.norm(points - np.stack(way, axis=1)[:, None], axis=2).min(axis=1) - 0.08 - 0.005
        away = np.minimum(away, np.minimum(points, 1 - points).min(axis=(1, 2)) - 0.005)
        np.testing.assert_allclose(c.clearances, away, atol=1e-4)
        assert away.min() + 1e-6 >= c.report.clearance_min >= away.min() - 2e-3
        off = np.abs(np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1) - 0.25)
        np.testing.assert_allclose(c.distance_errors, off, atol=1e-12)
        assert off.max() - 1e-12 <= c.report.distance_error_max <= off.max() + 1e-4  # between the steps too


def test_what_is_known_of_each_method_is_found(compared):
    """Nothing avoids without modulation; the same matrix loses the distance of a load that turns; ours keeps all."""
    by = {c.method: c for c in compared[0]}
    assert by["no modulation"].touching.any()
    assert by["same matrix on all"].off.any()
    for name in ("obstacles seen only", "motions known"):
        assert by[name].report.reasons == ()
        assert by[name].arrived
        assert not by[name].off.any()
        assert not by[name].touching.any()


def test_the_same_matrix_keeps_the_distance_of_what_does_not_turn():
    scene = crossing(disc([0.5, 0.9], {"velocity": [0.0, -0.2]}))
    assert verify_execution(loose_run(scene, Sharing.SAME, 8.0)).distance_error_max < 1e-9


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_hands_that_are_held_are_judged_alike_loose_or_not(seed):
    """In the plane and in space, two hands and three: the rigid execution, taken for one of free hands."""
    scene = moving_scene(seed)
    record = Executor(scene).run(1.0)
    loose = LooseRecord(
        scene,
        record.time,
        record.center,
        record.quaternion,
        record.obstacles,
        record.sagitta,
        record.nodes[:, : len(scene.manipulators)],
    )
    rigid, free = verify_execution(record), verify_execution(loose)
    assert free.clearance_min == pytest.approx(rigid.clearance_min, abs=1e-3)
    for name in ("distance_error_max", "end_error", "speed_max", "acceleration_max"):
        assert getattr(free, name) == pytest.approx(getattr(rigid, name), abs=1e-3)


def test_corners_of_a_load_lie_where_the_hands_put_them():
    data = {"shape": "box", "size": [0.2, 0.1], "grasps": {"left": [-0.1, 0.0], "right": [0.1, 0.0]}}
    scene = crossing(disc([0.5, 0.95], {"velocity": [0.0, -0.1]}), load=data)
    record = loose_run(scene, Sharing.NONE, 6.0)
    hands = record.hands[:, :, :2]
    np.testing.assert_array_equal(record.position, hands)
    corners, middle = record.nodes[:, 2:, :2], hands.mean(axis=1)
    np.testing.assert_allclose(corners.mean(axis=1), middle, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(corners - middle[:, None], axis=2), np.hypot(0.1, 0.05))


@pytest.mark.parametrize("obstacles", [[], [{"shape": "circle", "center": [0.5, 0.8], "radius": 0.05}]])
@pytest.mark.few(1)
def test_scenes_in_which_nothing_moves(obstacles):
    rows, _ = compare(Executor(crossing(*obstacles)).run(8.0), 8.0)
    assert all(c.arrived and c.report.clearance_min > 0 for c in rows)
