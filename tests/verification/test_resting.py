"""The certificate of motions that begin and end in contact, against distances sampled from the file alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comove import Scene
from comove.dmp.basis import motion_basis
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.resting import SLOPE, TOLERANCE, recession_sagittas, recessions
from comove.planning import solve
from comove.verification import verify
from comove.verification.record import RecordSamples, verify_execution
from tests.brute_force import obstacle_distance
from tests.model.test_resting import tray

FINE = np.linspace(0.0, 1.0, 4001)


def sampled(scene, motion, parts=0):
    """Distances of the box from every obstacle, and its displacements from start and goal [m], from the file alone.

    Over a table the corners of a box are nearest; beside other boxes, one of the `parts` of its edges.
    """
    nodes = motion.coordinates.nodes(np.ascontiguousarray(motion.at(FINE)[0].T[None]))[0]
    corners = nodes[:, len(scene.manipulators) :]
    share = np.linspace(0.0, 1.0, 2 + parts)[:, None]
    edges = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]
    points = np.concatenate(
        [corners[:, [a]] * share + corners[:, [b]] * (1 - share) for a, b in edges], axis=1
    )
    away = [obstacle_distance(obstacle, points).min(axis=1) for obstacle in scene.file.obstacles]
    ends = [np.linalg.norm(nodes - nodes[k], axis=2).max(axis=1) for k in (0, -1)]
    return np.array(away), np.array(ends)


def carried(scene, way, n_basis=60):
    """The motion along a path of the box's centre, (n, 3), at even times; its heading does not change."""
    coordinates = load_coordinates(scene)
    boundary, basis = coordinates.boundary(), motion_basis(n_basis, "jerk")
    q = np.repeat(boundary[:1], len(way), axis=0)
    q[:, :3] += way - way[0]
    blank = CoordinatedDMP(scene, coordinates, basis, boundary, np.zeros((coordinates.n_columns, n_basis)))
    return blank.fitted(np.linspace(0.0, 1.0, len(way)), q).rollout()


def eased(n=401):
    s = np.linspace(0.0, 1.0, n)
    return s**3 * (10 - 15 * s + 6 * s**2)


def hop(lift, along=1.0, sideways=0.0, n=401):
    """A path that rises first to `lift`, drifting `sideways` on the way, then goes along, then sinks."""
    s = np.linspace(0.0, 1.0, n)
    up = np.clip(s / 0.3, 0.0, 1.0)
    up = up**3 * (10 - 15 * up + 6 * up**2)
    high = up * up[::-1]
    over = np.clip((s - 0.25) / 0.5, 0.0, 1.0)
    over = over**3 * (10 - 15 * over + 6 * over**2)
    return np.stack([along * over, sideways * high, lift * high], axis=1)


@pytest.mark.parametrize("above", [0.0, 0.002])
def test_a_hop_is_verified_and_sliding_is_not(above):
    scene = Scene.from_dict(tray(0.06 + above))
    verdict = verify(carried(scene, hop(0.1)))
    assert verdict.verified is not None, verdict.reasons
    assert 0.0 < verdict.report.support_left < 0.3 * scene.duration
    assert verdict.report.support_met > 0.7 * scene.duration
    slid = verify(carried(scene, np.stack([eased(), 0 * eased(), 0 * eased()], axis=1)))
    assert slid.verified is None
    assert "table" in slid.reasons[0]


@pytest.mark.parametrize("rise", [0.35, 0.75])
def test_how_steeply_the_payload_leaves_decides(rise):
    """It leaves and comes back along a straight line: the distance grows by `rise` a metre of displacement."""
    scene = Scene.from_dict(tray())
    sideways = 0.1 * np.sqrt(1 - rise**2) / rise
    verdict = verify(carried(scene, hop(0.1, sideways=sideways)))
    assert (verdict.verified is not None) == (rise > SLOPE), verdict.reasons


def test_a_payload_that_is_pressed_into_its_support_is_rejected():
    scene = Scene.from_dict(tray())
    way = hop(0.1)
    way[:, 2] -= 8e-3 * np.sin(np.pi * np.clip(np.linspace(0, 1, len(way)) / 0.1, 0, 1)) ** 2
    assert verify(carried(scene, way)).verified is None


@pytest.mark.parametrize("key", ["support", None])
def test_only_supports_are_relieved(key):
    """A wall that is as near as the table, and that the payload leaves as steeply, needs the key as well."""
    beside = {"name": "wall", "shape": "box", "center": [0.1, 0.153, 0.1], "size": [0.2, 0.2, 0.2]}
    scene = Scene.from_dict(tray(supports=[beside | ({key: True} if key else {})]), check_ends=False)
    verdict = verify(carried(scene, hop(0.1, sideways=-0.1)))
    assert (verdict.verified is not None) == (key is not None)
    assert key or "wall" in verdict.reasons[0]


@given(
    lift=st.floats(0.008, 0.15),
    sideways=st.floats(-0.2, 0.2),
    clearance=st.floats(0.0, 0.02),
    above=st.floats(-5e-5, 0.01),
    turn=st.floats(-3.0, 3.0),
    wave=st.floats(-0.01, 0.01),
)
@settings(max_examples=15, deadline=None)
def test_what_is_verified_keeps_what_is_required(lift, sideways, clearance, above, turn, wave):
    """At no sample is a verified motion nearer than its displacement allows, and once away it stays away."""
    data = tray(0.06 + above, clearance=clearance)
    data["obstacles"][0]["quaternion_wxyz"] = [np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)]
    scene = Scene.from_dict(data, check_ends=False)
    way = hop(lift, sideways=sideways)
    way[:, 2] += (
        wave * np.sin(np.pi * np.linspace(0, 1, len(way))) ** 4 * np.sin(9 * np.linspace(0, 1, len(way)))
    )
    motion = carried(scene, way)
    verdict, (away, ends) = verify(motion), sampled(scene, motion)
    relief = [rest.distance - TOLERANCE + SLOPE * ends[int(rest.end == "goal")] for rest in scene.rests]
    required = np.min([np.full(len(FINE), clearance), *relief], axis=0)
    if verdict.verified is not None:
        assert (away[0] >= required - 1e-7).all()
        assert not scene.rests or away[0].min() >= verdict.report.support_distance_min - 1e-7
        if len(scene.rests) == 2:
            time = FINE * scene.duration
            between = (time >= verdict.report.support_left) & (time <= verdict.report.support_met)
            assert (away[0][between] >= clearance - 1e-7).all()
    elif (away[0] >= required + 2e-4).all():
        raise AssertionError(verdict.reasons)


def test_samples_of_an_execution_are_judged_by_the_same_rule():
    data = tray()
    data["load"] = {"shape": "bar", "length": 0.2, "radius": 0.03}
    data["constraints"] = []
    for hand in data["manipulators"]:
        hand["start"][2] = hand["goal"][2] = 0.03
    scene = Scene.from_dict(data)
    for lift, fine in ((0.1, True), (0.0, False)):
        way = hop(lift, n=1201)
        position = scene.start + way[:, None, :]
        report = verify_execution(RecordSamples(scene, np.linspace(0.0, 4.0, len(way)), position))
        assert (report.clearance_min >= scene.clearance) == fine, report.reasons


def test_a_planned_motion_lifts_off_and_sets_down():
    wall = {"shape": "box", "center": [0.5, 0.0, 0.1], "size": [0.1, 0.6, 0.2]}
    scene = Scene.from_dict(tray(supports=[wall]))
    solution = solve(scene, seed=0, budget=60)
    assert solution.verified, solution.reasons
    away, ends = sampled(scene, solution.motion.motion, parts=9)
    near = ends.min(axis=0) < 0.0102
    assert (away[0][~near] >= scene.clearance - 1e-7).all()
    assert (away[0] >= np.minimum(scene.clearance, -TOLERANCE + SLOPE * ends.min(axis=0)) - 1e-7).all()
    assert (away[1] >= scene.clearance - 1e-7).all()


@given(
    seed=st.integers(0, 10**6),
    size=st.floats(1e-4, 0.02),
    apart=st.floats(0.0, 0.03),
    bent=st.floats(0.0, 0.003),
)
@settings(max_examples=60, deadline=None)
def test_interpolated_recessions_are_ahead_by_their_sagittas_at_most(seed, size, apart, bent):
    """Nodes are anywhere within their deviation of the chords; the supports of start and goal are one table."""
    data = tray()
    for hand in data["manipulators"]:
        hand["goal"] = (np.array(hand["start"]) + [apart, 0.0, 0.0]).tolist()
    scene, rng = Scene.from_dict(data), np.random.default_rng(seed)
    shape = (6, *scene.rests[0].nodes.shape)
    nodes = (
        scene.rests[rng.integers(2)].nodes + size * rng.standard_normal((6, 1, 3)) + 1e-4 * rng.random(shape)
    )
    deviation = bent * rng.random((5, shape[1]))
    moved = recessions(scene, nodes)
    sagitta = recession_sagittas(scene, nodes, deviation, moved)[:, 0]
    for share in rng.random(40):
        stray = rng.standard_normal((5, shape[1], 3))
        stray *= (deviation * rng.random(deviation.shape) / np.linalg.norm(stray, axis=2))[..., None]
        allowed = np.linalg.norm(
            recessions(scene, (1 - share) * nodes[:-1] + share * nodes[1:] + stray)[:, 0], axis=1
        )
        interpolated = np.linalg.norm((1 - share) * moved[:-1, 0] + share * moved[1:, 0], axis=1)
        assert (interpolated <= allowed + sagitta + 1e-12).all()
