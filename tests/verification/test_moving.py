"""The certificate of clearance among obstacles that move."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.model.files.keys import Workspace
from comove.verification import verify
from comove.verification.certificate import Paths, certify, certify_curve
from comove.verification.clearance_kernels import CurveArrays
from tests import brute_force
from tests.cases import examples
from tests.verification.random_motions import random_obstacle

ROUNDING = 1e-9  # m
DURATION = 4.0  # s


def carrying(n_dims, load, obstacles):
    """A scene in which two hands go past obstacles."""
    ends = [[[x, y, 0.5][:n_dims] for y in (0.4, 0.6)] for x in (0.1, 0.9)]
    return Scene.from_dict(
        {
            "name": "moving",
            "duration": DURATION,
            "workspace": {"lower": [-1] * n_dims, "upper": [2] * n_dims},
            "obstacles": obstacles,
            "load": load,
            "constraints": [{"type": "upright"}] if load["shape"] == "box" else [],
            "manipulators": [{"name": n, "start": s, "goal": g} for n, s, g in zip("ab", *ends, strict=True)],
        }
    )


def random_obstacles(rng, n_dims):
    """Obstacles that stand above the hands' way at first and move in all ways."""
    obstacles = []
    for kind in rng.permutation(3)[: rng.integers(1, 4)]:
        center = [float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.85, 1.0)), float(rng.uniform(0.4, 0.6))][
            :n_dims
        ]
        size = float(rng.uniform(0.02, 0.08))
        shape = [{"shape": "sphere", "radius": size}, {"shape": "box", "size": [2 * size] * n_dims}]
        obstacle = {**shape[rng.integers(2)], "center": center}
        points = [center, *rng.uniform(0.1, 0.9, (3, n_dims)).tolist()]
        obstacle["motion"] = [
            {"velocity": rng.uniform(-0.3, 0.3, n_dims).tolist()},
            {"waypoints": points, "times": np.cumsum(rng.uniform(0.02, 1.0, 4)).tolist()},
            {"circle": {"radius": float(rng.uniform(0.05, 0.3)), "period_s": float(rng.uniform(1.0, 6.0))}},
        ][kind]
        obstacles.append(obstacle)
    return obstacles


def random_motion(scene, rng, sigma=0.03):
    coordinates, basis = load_coordinates(scene), motion_basis(20, "velocity")
    weights = coordinates.search @ (sigma * rng.standard_normal((coordinates.search.shape[1], basis.n_basis)))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)


def sampled_clearance(motion, n_samples=3001):
    """Least clearance at even times, one configuration after the other."""
    s = np.linspace(0.0, 1.0, n_samples)
    nodes = motion.coordinates.nodes(np.ascontiguousarray(motion.at(s)[0].T[None]))[0]
    return min(motion.scene.clearance_at(x, t)[0] for x, t in zip(nodes, s * DURATION, strict=True))


@pytest.mark.parametrize(
    ("n_dims", "load"),
    [
        (2, {"shape": "bar", "length": 0.2, "radius": 0.01}),
        (3, {"shape": "bar", "length": 0.2, "radius": 0.01}),
        (3, {"shape": "box", "size": [0.1, 0.3, 0.05], "grasps": {"a": [0, -0.1, 0], "b": [0, 0.1, 0]}}),
    ],
)
@examples(12)
@given(seed=st.integers(0, 2**32 - 1))
def test_nothing_is_certified_above_the_truth_and_hardly_below(n_dims, load, seed):
    rng = np.random.default_rng(seed)
    motion = random_motion(carrying(n_dims, load, random_obstacles(rng, n_dims)), rng)
    clearance, truth = certify(motion), sampled_clearance(motion)
    assert clearance.lower <= truth + ROUNDING
    if truth > 0.0:  # deep inside, where distances have kinks, samples say less
        assert clearance.lower >= truth - 3e-3
        assert clearance.upper >= clearance.lower


@pytest.mark.parametrize("n_dims", [2, 3])
@examples(40)
@given(seed=st.integers(0, 2**32 - 1), n_knots=st.integers(2, 30))
def test_what_turns_between_knots_far_apart_is_met(n_dims, seed, n_knots):
    """A bar that goes straight, known at few instants, among obstacles that turn up to three times a second."""
    rng = np.random.default_rng(seed)
    obstacles = [random_obstacle(rng, n_dims, 1.0) for _ in range(3)]
    for obstacle in obstacles:
        obstacle["center"] = rng.uniform(0.3, 0.7, n_dims).tolist()
    scene = carrying(n_dims, {"shape": "bar", "length": 0.2, "radius": 0.01}, obstacles)
    ends, share = np.stack([scene.nodes_at(end) for end in ("start", "goal")]), np.linspace(0.0, 1.0, n_knots)
    nodes = ends[0] + share[:, None, None] * (ends[1] - ends[0])
    straight = CurveArrays(nodes, np.zeros((n_knots - 1, nodes.shape[1])))
    time, dense = DURATION * share, np.linspace(0.0, DURATION, 3001)
    found = certify_curve(scene, straight, time, Paths.of(scene, time))
    hands = scene.start + dense[:, None, None] / DURATION * (scene.goal - scene.start)
    a, b, radii = brute_force.body_of(scene, hands)
    points = a[:, :1] + np.linspace(0.0, 1.0, 41)[:, None] * (b - a)[:, :1]
    truth = brute_force.point_clearance(scene, points, dense).min() - radii[0]
    assert found.lower <= truth + ROUNDING


@given(velocity=st.tuples(*[st.floats(-1.0, 1.0)] * 3), seed=st.integers(0, 1000))
def test_what_moves_along_is_as_far_away_as_if_both_stood(velocity, seed):
    """Galileo: to move load and obstacles by the same changes no clearance."""
    rng = np.random.default_rng(seed)
    scene = carrying(
        3, {"shape": "bar", "length": 0.2}, [{"shape": "sphere", "center": [0.5, 0.9, 0.5], "radius": 0.1}]
    )
    motion = random_motion(scene, rng)
    nodes = motion.coordinates.nodes(np.ascontiguousarray(motion.knots[0].T[None]))[0]
    n_knots = len(nodes)
    straight, time = np.zeros((n_knots - 1, nodes.shape[1])), np.linspace(0.0, DURATION, n_knots)
    shift = np.linspace(0.0, 1.0, n_knots)[:, None] * np.array(velocity)
    still = Paths.of(scene, time)
    workspace = Workspace(lower=(-9.0, -9.0, -9.0), upper=(9.0, 9.0, 9.0))
    wide = replace(scene, file=scene.file.model_copy(update={"workspace": workspace}))
    at_rest = certify_curve(wide, CurveArrays(nodes, straight), time, still)
    moved = CurveArrays(nodes + shift[:, None], straight)
    together = certify_curve(wide, moved, time, still._replace(offset=shift[:, None]))
    assert together.lower == pytest.approx(at_rest.lower, abs=2e-4)
    assert together.upper == pytest.approx(at_rest.upper, abs=2e-4)


def test_what_comes_between_the_samples_is_met():
    """A disc that jumps across the bar's way within a hundredth of a second and stands before and after."""
    disc = {"shape": "circle", "center": [0.5, 1.2], "radius": 0.05}
    jump = {"waypoints": [[0.5, 1.2], [0.5, -0.2]], "times": [2.0, 2.008]}
    scene = carrying(2, {"shape": "bar", "length": 0.2}, [{**disc, "motion": jump}])
    verdict = verify(random_motion(scene, np.random.default_rng(0), 0.0))
    assert verdict.verified is None
    assert "obstacles[0] (sphere) at 2.0" in verdict.reasons[0]
    late = {**jump, "times": [3.9, 3.95]}
    scene = carrying(2, {"shape": "bar", "length": 0.2}, [{**disc, "motion": late}])
    assert verify(random_motion(scene, np.random.default_rng(0), 0.0)).verified is not None


def test_the_end_of_the_movement_counts():
    visitor = {"shape": "circle", "center": [0.9, -0.445], "radius": 0.05, "motion": {"velocity": [0.0, 0.2]}}
    scene = carrying(
        2, {"shape": "bar", "length": 0.2}, [visitor]
    )  # 5 mm deep in the lower hand when all stops
    (reason,) = verify(random_motion(scene, np.random.default_rng(0), 0.0)).reasons
    assert "obstacles[0] (sphere) at 4.00 s" in reason


@examples(20)
@given(seed=st.integers(0, 2**32 - 1), since=st.floats(0.01, 0.97))
def test_of_the_rest_of_a_motion_only_the_rest_counts(seed, since):
    rng = np.random.default_rng(seed)
    motion = random_motion(
        carrying(2, {"shape": "bar", "length": 0.2, "radius": 0.01}, random_obstacles(rng, 2)), rng
    )
    s = np.linspace(since, 1.0, 1500)
    nodes = motion.coordinates.nodes(np.ascontiguousarray(motion.at(s)[0].T[None]))[0]
    truth = min(motion.scene.clearance_at(x, t)[0] for x, t in zip(nodes, s * DURATION, strict=True))
    rest, whole = certify(motion, since=since), certify(motion)
    assert whole.lower - 1e-3 <= rest.lower <= truth + ROUNDING
    assert rest.time >= since * DURATION - 1e-9
    if truth > 0.0:
        assert rest.lower >= truth - 3e-3
