"""`solve` finds motions under every constraint, with and without the planner; brute force judges them again."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import comove
from comove.dmp.basis import rollouts
from comove.errors import OptionError
from comove.lab.evolution import Paper, Projection
from comove.model import Scene, load_coordinates
from comove.model.constraints import SameHeightConstraint, SeparationConstraint, UprightConstraint
from comove.planning.configurations import configuration_space
from comove.planning.objective import N_STEPS, Objective
from comove.planning.planner import plan
from tests import brute_force
from tests.cases import examples
from tests.planning.test_planner import between as along_edges
from tests.planning.test_solver import assert_verified, scene_of
from tests.verification.random_motions import held_scene, motion_on, scene_data

DENSE = np.linspace(0.0, 1.0, 40_001)
HAND = np.zeros((1, 3))
TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.15, 0.0]])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FRAME = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], "radius": 0.005}
BAR = {"shape": "bar", "length": 0.2, "radius": 0.01, "overhang": 0.05}
DISC = {"shape": "circle", "center": [0.5, 0.5], "radius": 0.1}
BALL = {"shape": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.1}
WALL = {"shape": "box", "center": [0.5, 0.5, 0.25], "size": [0.1, 1.2, 0.5]}
SLIT = [{"shape": "box", "center": [0.5, y, 0.5], "size": [0.05, 0.5, 1.2]} for y in (0.2, 0.8)]
UPRIGHT = {"type": "upright", "tolerance_deg": 1.0}


def between(kind, first="a", second="b", **more):
    return {"type": kind, "between": [first, second], **more}


def swap(n_dims, *obstacles, distance=0.3):
    """Two hands that change places."""
    left, right = ([x, *[0.5] * (n_dims - 1)] for x in (0.1, 0.9))
    apart = between("separation", distance=distance)
    return scene_of([left, right], [right, left], *obstacles, constraints=[apart])


SCENES = {
    "swap": lambda: swap(2),
    "swap round a disc": lambda: swap(2, DISC),
    "swap in space": lambda: swap(3, BALL),
    "bar and hand": lambda: scene_of(
        [[0.15, 0.4], [0.15, 0.6], [0.85, 0.5]],
        [[0.85, 0.4], [0.85, 0.6], [0.15, 0.5]],
        load={"shape": "bar", "length": 0.2, "held_by": ["a", "b"]},
        constraints=[between("separation", hand, "c", distance=0.12) for hand in "ab"],
    ),
    "tray of three": lambda: scene_of(
        (TRIANGLE + [0.1, 0.4, 0.2]).tolist(),
        (TRIANGLE @ QUARTER.T + [0.8, 0.4, 0.2]).tolist(),
        WALL,
        load=FRAME,
        constraints=[UPRIGHT],
    ),
    "tray of two": lambda: scene_of(
        [[0.15, 0.4, 0.2], [0.15, 0.6, 0.2]],
        [[0.85, 0.4, 0.2], [0.85, 0.6, 0.2]],
        WALL,
        load=BAR,
        constraints=[UPRIGHT],
    ),
    "leaning bar": lambda: scene_of(
        [[0.15, 0.4, 0.2], [0.15, 0.52, 0.36]],
        [[0.85, 0.4, 0.2], [0.97, 0.4, 0.36]],
        WALL,
        load={"shape": "bar", "length": 0.2},
        constraints=[UPRIGHT],
    ),
    "planar tray": lambda: scene_of(
        [[0.1, 0.2], [0.3, 0.2]],
        [[0.7, 0.2], [0.9, 0.2]],
        {"shape": "box", "center": [0.5, 0.2], "size": [0.05, 0.5]},
        load={"shape": "bar", "length": 0.2},
        constraints=[UPRIGHT],
    ),
    "level hands": lambda: scene_of(
        [[0.1, 0.3], [0.3, 0.3]],
        [[0.7, 0.3], [0.9, 0.3]],
        {"shape": "circle", "center": [0.5, 0.3], "radius": 0.15},
        constraints=[between("same_height")],
    ),
    "level hands in space": lambda: scene_of(
        [[0.1, 0.3, 0.3], [0.1, 0.7, 0.3]],
        [[0.9, 0.3, 0.6], [0.9, 0.7, 0.6]],
        {"shape": "sphere", "center": [0.5, 0.3, 0.4], "radius": 0.2},
        {"shape": "box", "center": [0.5, 0.7, 0.6], "size": [0.1, 0.4, 0.2]},
        constraints=[between("same_height"), between("separation", distance=0.1)],
    ),
    "level bar": lambda: scene_of(
        [[0.1, 0.3], [0.3, 0.3]],
        [[0.7, 0.3], [0.9, 0.3]],
        {"shape": "circle", "center": [0.5, 0.3], "radius": 0.1},
        load={"shape": "bar", "length": 0.2},
        constraints=[between("same_height")],
    ),
    "pose through a slit": lambda: scene_of(
        [[0.15, 0.4, 0.5], [0.15, 0.6, 0.5]],
        [[0.85, 0.4, 0.5], [0.85, 0.6, 0.5]],
        *SLIT,
        constraints=[between("relative_pose")],
    ),
    "chain of poses": lambda: scene_of(
        (TRIANGLE + [0.1, 0.4, 0.2]).tolist(),
        (TRIANGLE @ QUARTER.T + [0.8, 0.4, 0.2]).tolist(),
        WALL,
        constraints=[between("relative_pose", "a", "b"), between("relative_pose", "b", "c")],
    ),
}


def assert_kept(solution):
    """Verified, and at forty thousand instants every constraint holds as the report says."""
    assert_verified(solution)
    scene, report = solution.scene, solution.report
    hands = brute_force.hands_at(solution.attempt, DENSE)
    for c in scene.constraints:
        if isinstance(c, SeparationConstraint):
            met = brute_force.separations(hands, c.first, c.second).min()
            assert met >= c.least
            assert report.separation_spare_min <= met - c.least + 1e-12
        elif isinstance(c, UprightConstraint):
            assert brute_force.tilts(hands[:, list(c.members)]).max() <= 1e-11
            assert report.tilt_max <= 1e-11
        elif isinstance(c, SameHeightConstraint):
            met = brute_force.height_differences(hands, c.first, c.second).max()
            assert met <= report.height_error_max + 1e-15 <= 1e-14


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.few(13)
def test_a_motion_is_found(name, seed):
    solution = comove.solve(SCENES[name](), seed=seed)
    assert_kept(solution)
    assert solution.effort.first_verified < 5.0


@pytest.mark.parametrize(
    "name",
    ["swap round a disc", "tray of three", "planar tray", "level hands", "pose through a slit"],
)
@pytest.mark.few(1)
def test_a_motion_is_found_without_the_planner(name):
    assert_kept(comove.solve(SCENES[name](), seed=0, planner=False))


@pytest.mark.parametrize("name", ["swap", "bar and hand", "planar tray", "level hands in space", "level bar"])
@pytest.mark.few(2)
def test_a_motion_is_found_by_projection(name):
    assert_kept(comove.solve(SCENES[name](), seed=0, method=Projection()))


def test_the_papers_method_holds_heights_and_separations():
    level = Scene.from_dict(scene_data(SCENES["level bar"]()))
    solution = comove.solve(level, seed=0, method=Paper())
    assert solution.verified, solution.reasons
    assert solution.report.height_error_max == 0.0
    hands = brute_force.hands_at(solution.attempt, DENSE)
    assert np.array_equal(hands[:, 0, 1], hands[:, 1, 1])
    apart = np.abs(brute_force.separations(hands, 0, 1) - 0.2).max()
    assert apart <= solution.report.distance_error_max <= 2e-4


@pytest.mark.parametrize(
    ("name", "method", "word"),
    [
        ("tray of three", Projection(), "upright"),
        ("pose through a slit", Projection(), "relative poses"),
        ("planar tray", Paper(), "upright"),
        ("pose through a slit", Paper(), "relative pose"),
        ("swap", Paper(), "no distance ties"),
    ],
)
def test_what_a_method_does_not_hold_it_refuses(name, method, word):
    with pytest.raises(OptionError, match=word):
        comove.solve(SCENES[name](), method=method)


@pytest.mark.parametrize("name", ["planar tray", "level hands", "swap"])
@pytest.mark.few(1)
def test_a_demonstration_is_followed_where_the_constraints_allow(name):
    taught = comove.DMP.fit(comove.Demonstration.from_lasa("Sine"))
    scene = SCENES[name]()
    near, far = (
        comove.solve(scene, demonstration=taught, objective=comove.PaperCost(resemblance=weight))
        for weight in (20.0, 0.0)
    )
    assert_kept(near)
    s = np.linspace(0.0, 1.0, N_STEPS)
    wanted = comove.planning.carried_demonstration(taught, scene)[..., : scene.n_dims]
    away = [np.linalg.norm(x.attempt.hands(s)[0] - wanted, axis=-1).mean() for x in (near, far)]
    assert away[0] < away[1]


def test_no_way_past_each_other():
    """Two hands in a corridor narrower than their separation: nothing is found, and the best attempt says why."""
    scene = Scene.from_dict(scene_data(swap(2)) | {"workspace": {"lower": [0.0, 0.4], "upper": [1.0, 0.6]}})
    solution = comove.solve(scene, seed=0, budget=1.5)
    assert not solution.verified
    assert solution.report.separation_spare_min < 0
    assert any("'a' and 'b' come as near as" in reason for reason in solution.reasons)


# --- The planner and the search on the way ---


@pytest.mark.parametrize(
    "name", ["swap round a disc", "swap in space", "bar and hand", "level hands in space"]
)
@pytest.mark.parametrize("margin", [0.008, 0.002])
def test_every_edge_keeps_the_separation_and_the_height(name, margin):
    scene = SCENES[name]()
    coordinates = load_coordinates(scene)
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    path = plan(space, ends[0], ends[2], margin, np.random.default_rng(1))
    q = path if name.startswith("level") else along_edges(coordinates, path)
    hands = brute_force.hands_of(coordinates, q, scene.file)
    for c in scene.constraints:
        if isinstance(c, SeparationConstraint):
            spare = brute_force.separations(hands, c.first, c.second).min() - c.least
            assert spare >= 2 * margin - 1e-6  # both hands come nearer: twice what one of them keeps
        elif isinstance(c, SameHeightConstraint):
            assert np.array_equal(hands[:, c.first, -1], hands[:, c.second, -1])
    assert brute_force.configuration_clearance(scene, hands).min() >= margin - 1e-6


@examples(60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_the_search_feels_a_separation_as_it_feels_an_obstacle(seed, n_dims):
    """Nothing above its margin, a slope below, a step where it is broken; between the samples too."""
    rng = np.random.default_rng(seed)
    free = held_scene(rng, n_dims, [HAND, HAND])
    motion = motion_on(free, rng, rng.choice([0.01, 0.05]))
    met = brute_force.separations(brute_force.hands_at(motion, DENSE), 0, 1).min()
    offset = float(rng.choice([-0.01, -1e-3, 2e-3, 8e-3, 0.02]))
    ends = [np.linalg.norm(np.subtract(*hands)) for hands in (free.start, free.goal)]
    if not 0.0 < met - offset < min(ends):
        return
    data = scene_data(free) | {"constraints": [between("separation", distance=float(met - offset))]}
    data["limits"] = {"clearance": float(rng.choice([0.0, 0.005]))}
    scene = Scene.from_dict(data)
    objective = Objective(scene, load_coordinates(scene))
    value = objective.evaluate(rollouts(motion.basis, motion.boundary, motion.weights[None], N_STEPS))
    chords = 1e-3  # m, that the chords of so few samples may miss
    if offset > objective.penalty.margin + chords:
        assert value.penalty[0] == 0.0
        assert value.clearance[0] == objective.penalty.margin + scene.clearance
    if offset < objective.penalty.margin - chords:
        assert value.penalty[0] > 0.0
        assert value.clearance[0] == pytest.approx(offset + scene.clearance, abs=chords)
    if offset < -chords:
        assert value.penalty[0] >= 10.0 / N_STEPS
        assert not objective.feasible(value)[0]
    assert value.hits[0] == 0.0  # the objective (4) counts obstacles alone


def test_hands_that_rush_past_each_other_between_two_samples_are_felt():
    """No sample shows them nearer than a centimetre, and they nearly meet."""
    left, right = [-1.5, 0.0], [1.5, 0.001]
    scene = Scene.from_dict(
        scene_data(swap(2))
        | {
            "workspace": {"lower": [-9.0, -9.0], "upper": [9.0, 9.0]},
            "manipulators": [
                {"name": "a", "start": left, "goal": right},
                {"name": "b", "start": [x - 0.01 * (i == 0) for i, x in enumerate(right)], "goal": left},
            ],
            "constraints": [between("separation", distance=0.005)],
        }
    )
    motion = motion_on(scene, np.random.default_rng(0), 0.0)
    hands = brute_force.hands_at(motion, np.linspace(0.0, 1.0, N_STEPS))
    assert brute_force.separations(hands, 0, 1).min() > 0.01
    value = Objective(scene, motion.coordinates).evaluate(
        rollouts(motion.basis, motion.boundary, motion.weights[None], N_STEPS)
    )
    assert value.clearance[0] < 0
    assert value.penalty[0] > 0.01


def test_the_same_seed_is_the_same_motion():
    first, second = (comove.solve(SCENES["swap in space"](), seed=5) for _ in range(2))
    assert np.array_equal(first.attempt.weights, second.attempt.weights)
