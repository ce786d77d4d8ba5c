"""`solve`: verified motions for whatever scenes allow, the same for the same seed, within the budget.

Every motion handed out as verified is judged again by brute force.
"""

import os
import signal
import time

import numpy as np
import pytest

import comove
from comove import DMP, Demonstration, PaperCost
from comove.errors import OptionError
from comove.lab.evolution import Projection
from comove.model import Scene
from comove.planning import Comove, carried_demonstration
from comove.planning.methods import MethodSettings
from comove.planning.objective import N_STEPS
from tests import brute_force
from tests.solved import example, random_scene, solved
from tests.verification.random_motions import scene_data

S = np.linspace(0.0, 1.0, 4001)
DISC = {"shape": "circle", "center": [0.5, 0.5], "radius": 0.15}
BALL = {"shape": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.15}
FRAME = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], "radius": 0.01}


def scene_of(starts, goals, *obstacles, **more):
    """Hands a, b, .. from `starts` to `goals` past `obstacles` in a unit workspace."""
    n_dims = len(starts[0])
    return Scene.from_dict(
        {
            "name": "test",
            "duration": 10.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": list(obstacles),
            "manipulators": [
                {"name": name, "start": start, "goal": goal}
                for name, start, goal in zip("abcdef", starts, goals, strict=False)
            ],
            "limits": {"speed": 1.0},
            **more,
        }
    )


def tied(first, second, distance):
    return {"type": "distance", "between": [first, second], "distance": distance}


def limited(name, **limits):
    """An example with these limits instead of its own."""
    return Scene.from_dict(scene_data(example(name)) | {"limits": limits, "demonstration": None})


def closed(n_dims=2):
    """A wall without a gap."""
    rest = [0.5] * (n_dims - 2)
    wall = {"shape": "box", "center": [0.5, 0.5, *rest], "size": [0.1, *[1.2] * (n_dims - 1)]}
    starts, goals = ([[x, 0.4, *rest], [x, 0.6, *rest]] for x in (0.15, 0.85))
    return scene_of(starts, goals, wall, load={"shape": "bar", "length": 0.2})


def assert_verified(solution):
    """Verified, and by brute force too."""
    scene, motion = solution.scene, solution.attempt
    assert solution.verified, solution.reasons
    assert solution.reasons == ()
    assert solution.motion.motion is motion
    position, velocity, acceleration = motion.hands(S)
    duration = scene.duration
    assert np.abs(position[0] - scene.start).max() <= 1e-9
    assert np.abs(position[-1] - scene.goal).max() <= 1e-9
    assert np.abs(velocity[-1]).max() / duration <= 1e-9
    for c in scene.distances:
        apart = np.linalg.norm(position[:, c.first] - position[:, c.second], axis=1)
        assert np.abs(apart - c.distance).max() <= 1e-9
    assert np.linalg.norm(velocity, axis=-1).max() / duration <= scene.speed_limit
    assert np.linalg.norm(acceleration, axis=-1).max() / duration**2 <= scene.acceleration_limit
    truth = brute_force.least_clearance(motion)[0]
    assert solution.report.clearance_min <= truth + 1e-9
    assert truth >= scene.clearance
    assert 0 < solution.effort.first_verified <= solution.effort.seconds
    assert solution.cost.total > 0


# --- Examples ---


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["wide", "narrow", "complex", "window", "triangle"])
@pytest.mark.few(4)
def test_examples(name, seed):
    assert_verified(solved(name, seed))


@pytest.mark.parametrize("name", ["wide", "narrow"])
@pytest.mark.few(1)
def test_examples_without_planner(name):
    solution = solved(name, planner=False)
    assert_verified(solution)
    assert solution.cost.total < 1.5 * solved(name).cost.total


@pytest.mark.parametrize(("kind", "n"), [("planar", 4), ("bar", 2), ("triangle", 1)])
def test_random_scenes(kind, n):
    for i in range(n):
        assert_verified(comove.solve(random_scene(kind, i), seed=0))


@pytest.mark.slow
@pytest.mark.parametrize("planner", [True, False])
def test_many_random_planar_scenes(planner):
    """Nearly all of them are solved; `comove bench` counts how many."""
    solutions = [comove.solve(random_scene("planar", i), seed=0, planner=planner) for i in range(8)]
    for solution in solutions:
        if solution.verified:
            assert_verified(solution)
    assert sum(s.verified for s in solutions) >= (8 if planner else 7)


# --- The same run twice ---


@pytest.mark.parametrize("options", [{}, {"planner": False}, {"method": Projection()}])
@pytest.mark.few(1)
def test_the_same_seed_gives_the_same_motion(options):
    first, second, other = (comove.solve(example("narrow"), seed=seed, **options) for seed in (3, 3, 4))
    assert np.array_equal(first.attempt.weights, second.attempt.weights)
    assert np.array_equal(first.attempt.boundary, second.attempt.boundary)
    assert first.effort.evaluations == second.effort.evaluations > 0
    assert first.effort.generations == second.effort.generations > 0
    assert first.cost == second.cost
    assert not np.array_equal(first.attempt.weights, other.attempt.weights)
    assert (first.seed, first.method) == (3, options.get("method", Comove()).name)


def test_global_random_state_does_not_matter():
    np.random.seed(1)  # noqa: NPY002
    first = comove.solve(example("wide"), seed=0)
    np.random.seed(2)  # noqa: NPY002
    assert np.array_equal(first.attempt.weights, comove.solve(example("wide"), seed=0).attempt.weights)


# --- Budget and interruption ---


@pytest.mark.parametrize("budget", [0.3, 2.0])
@pytest.mark.parametrize("options", [{}, {"planner": False}, {"obstacles": "cost"}])
@pytest.mark.few(3)
def test_the_budget_is_kept_where_there_is_no_solution(budget, options):
    begun = time.process_time()
    solution = comove.solve(closed(), budget=budget, **options)
    assert time.process_time() - begun < budget + 5.0  # a second at most
    assert not solution.verified
    assert solution.motion is None
    assert any("obstacles[0] (box)" in reason for reason in solution.reasons)
    assert np.isfinite(solution.attempt.hands(S)[0]).all()
    assert not solution.interrupted


@pytest.mark.slow
@pytest.mark.parametrize("budget", [6.0, 8.0])
def test_the_budget_is_kept_among_many_obstacles(budget):
    """Where the planner, which tries again with ever more nodes, finds no way."""
    rng, data = np.random.default_rng(0), scene_data(closed(3))
    centers = rng.uniform([0.25, 0.0, 0.0], [0.75, 1.0, 1.0], (40, 3)).tolist()
    balls = [{"shape": "sphere", "center": center, "radius": 0.05} for center in centers]
    scene = Scene.from_dict(data | {"obstacles": [*data["obstacles"], *balls]})
    comove.solve(scene, budget=0.01)
    begun = time.process_time()
    assert not comove.solve(scene, budget=budget).verified
    assert time.process_time() - begun < budget + 5.0  # a second at most


def test_no_time_at_all():
    solution = comove.solve(closed(), budget=1e-9)
    assert not solution.verified
    assert solution.reasons
    assert solution.effort.evaluations == 0


@pytest.mark.parametrize(("planner", "after"), [(True, 2), (False, 1), (False, 30)])
def test_an_interruption_keeps_the_best(planner, after):
    seen = []

    def stop(progress):
        seen.append(progress)
        if len(seen) == after:
            raise KeyboardInterrupt

    solution = comove.solve(example("narrow"), seed=0, planner=planner, objective=PaperCost(), progress=stop)
    assert solution.interrupted
    assert len(seen) == after
    assert solution.effort.generations == len({p.generation for p in seen} - {0})
    if planner:  # a planned motion is verified before the first generation
        assert_verified(solution)
        assert solution.cost.total <= seen[-1].best
    else:
        assert not solution.verified
        assert solution.reasons


@pytest.mark.skipif(os.name != "posix", reason="needs timers")
def test_ctrl_c_at_any_moment_ends_the_search():
    """Compiled kernels, where half of these signals arrive, cannot pass a `KeyboardInterrupt` on.

    Signals are timed by processor time from the first word of the search: before it, an interrupt is the caller's.
    """
    scene = closed()
    comove.solve(scene, budget=0.01)
    before = [
        signal.signal(signal.SIGINT, signal.default_int_handler),
        signal.signal(signal.SIGPROF, lambda *_: signal.raise_signal(signal.SIGINT)),
    ]
    try:
        for seed in range(30):
            delays = iter([0.001 + 0.007 * seed])

            def begun(_, delays=delays):
                for delay in delays:
                    signal.setitimer(signal.ITIMER_PROF, delay)

            found = comove.solve(scene, seed=seed, planner=False, budget=20.0, progress=begun)
            assert found.interrupted
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGPROF, before[1])


def test_progress_tells_what_is_done():
    seen = []
    solution = comove.solve(example("narrow"), seed=0, progress=seen.append)
    generations = [p.generation for p in seen]  # a better motion is told at once, once more
    assert generations == sorted(generations)
    assert set(generations) - {0} == set(range(1, solution.effort.generations + 1))
    assert seen[0].motion is not None and seen[0].best is not None, (
        "the planned motion, before all generations"
    )
    best = [p.best for p in seen if p.best is not None]
    assert (np.diff(best) <= 0).all()
    assert solution.cost.total <= best[-1]
    assert all(p.stage and p.cost > 0 and p.violation >= 0 for p in seen)
    assert np.array_equal(
        solution.attempt.weights, solved("narrow").attempt.weights
    )  # watching changes nothing


# --- Methods ---


@pytest.mark.parametrize("name", ["wide", "narrow", "complex", "window"])
@pytest.mark.few(1)
def test_projection(name):
    solution = solved(name, method=Projection())
    assert_verified(solution)
    assert solution.method == "projection"
    assert solution.attempt.coordinates.kind == "projected"


def test_projection_without_planner():
    assert_verified(comove.solve(example("narrow"), method=Projection(), planner=False))


def test_projection_says_what_it_cannot_do():
    with pytest.raises(OptionError, match="comove"):
        comove.solve(example("triangle"), method=Projection())


def test_obstacles_as_a_cost():
    """The motion of the least cost is handed out: dear obstacles are avoided, cheap ones are not."""
    dear = comove.solve(example("wide"), obstacles="cost", objective=PaperCost(obstacle=100.0))
    assert_verified(dear)
    assert dear.cost.obstacle == 0.0
    cheap = comove.solve(
        example("narrow"), obstacles="cost", objective=PaperCost(obstacle=1e-6), planner=False
    )
    assert not cheap.verified
    assert any("obstacles[" in reason for reason in cheap.reasons)
    assert cheap.cost.total < solved("narrow").cost.total


def test_what_is_free_to_touch_is_not_dearer_than_what_is_not():
    soft = comove.solve(example("narrow"), obstacles="cost")
    assert soft.cost.total <= 1.05 * solved("narrow").cost.total


# --- Limits ---


@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("narrow", {"speed": 0.25}),
        ("narrow", {"acceleration": 0.5}),
        ("narrow", {"acceleration": 0.25, "speed": 0.3}),
        ("narrow", {"clearance": 0.015}),
        ("window", {"acceleration": 0.5}),
        ("window", {"speed": 0.25}),
        ("triangle", {"speed": 0.3}),
        ("complex", {"speed": 0.4}),
    ],
)
@pytest.mark.few(3)
def test_limits_are_kept(name, limits):
    assert_verified(comove.solve(limited(name, **limits), seed=0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [
        {"speed": 0.25},
        {"acceleration": 0.5},
    ],
)
def test_slowly_through_two_gaps(limits):
    """Hands go 1.4 m at most in 10 s."""
    assert_verified(comove.solve(limited("complex", **limits), seed=0, budget=12.0))


def test_limits_that_nothing_can_keep():
    """0.7 m in 10 s at 0.05 m/s."""
    solution = comove.solve(limited("wide", speed=0.05), budget=1.0)
    assert not solution.verified
    assert any("m/s" in reason for reason in solution.reasons)


def test_further_checks_are_honoured():
    """A motion must pass what the caller asks for besides: here, to keep out of the upper half."""

    def low(motion):
        highest = motion.hands(np.linspace(0, 1, 401))[0][..., 1].max()
        return [] if highest < 0.55 else [f"a hand is at {highest:.2f} m"]

    scene = scene_of([[0.1, 0.5]], [[0.9, 0.5]], {**DISC, "radius": 0.1})
    assert_verified(comove.solve(scene, seed=0, checks=[low]))
    never = comove.solve(scene, seed=0, checks=[lambda _: ["never"]], budget=1.0)
    assert not never.verified
    assert "never" in never.reasons


# --- Scenes ---

PAIR = [[0.1, 0.4], [0.1, 0.6]], [[0.9, 0.4], [0.9, 0.6]]
TRIANGLE = [[0.1, 0.4], [0.1, 0.6], [0.25, 0.5]], [[0.9, 0.6], [0.9, 0.4], [0.75, 0.5]]
WALLS = [{"shape": "box", "center": [0.5, y], "size": [0.1, 0.4]} for y in (0.2, 0.8)]
SCENES = {
    "one hand": lambda: scene_of([[0.1, 0.5]], [[0.9, 0.5]], DISC),
    "one hand in space": lambda: scene_of([[0.1, 0.5, 0.5]], [[0.9, 0.5, 0.5]], BALL),
    "three free hands": lambda: scene_of(
        [[0.1, 0.4], [0.1, 0.6], [0.3, 0.2]], [[0.9, 0.6], [0.9, 0.4], [0.3, 0.8]], DISC
    ),
    "a distance without a load": lambda: scene_of(*PAIR, DISC, constraints=[tied("a", "b", 0.2)]),
    "a frame": lambda: scene_of(*TRIANGLE, DISC, load=FRAME),
    "a thick bar with overhang": lambda: scene_of(
        [[0.15, 0.4], [0.15, 0.6]],
        [[0.85, 0.4], [0.85, 0.6]],
        *WALLS,
        load={"shape": "bar", "length": 0.2, "radius": 0.02, "overhang": 0.05},
    ),
    "a polygon": lambda: scene_of(
        *PAIR,
        *WALLS,
        load={
            "shape": "polygon",
            "vertices": [[-0.1, -0.03], [0.1, -0.03], [0.1, 0.03], [-0.1, 0.03]],
            "grasps": {"a": [-0.1, 0.0], "b": [0.1, 0.0]},
        },
    ),
    "a bar and a free hand": lambda: scene_of(
        [*PAIR[0], [0.5, 0.1]],
        [*PAIR[1], [0.5, 0.9]],
        DISC,
        load={"shape": "bar", "length": 0.2, "held_by": ["a", "b"]},
    ),
    "two groups": lambda: scene_of(
        [[0.1, 0.3], [0.1, 0.5], [0.9, 0.5], [0.9, 0.7]],
        [[0.9, 0.2], [0.9, 0.4], [0.1, 0.6], [0.1, 0.8]],
        {**DISC, "radius": 0.08},
        constraints=[tied("a", "b", 0.2), tied("c", "d", 0.2)],
    ),
    "two groups in space": lambda: scene_of(
        [[0.1, 0.3, 0.5], [0.1, 0.5, 0.5], [0.9, 0.5, 0.5], [0.9, 0.7, 0.5]],
        [[0.9, 0.2, 0.5], [0.9, 0.4, 0.5], [0.1, 0.6, 0.5], [0.1, 0.8, 0.5]],
        {**BALL, "radius": 0.08},
        constraints=[tied("a", "b", 0.2), tied("c", "d", 0.2)],
    ),
    "every shape in space": lambda: scene_of(
        [[0.1, 0.4, 0.4], [0.1, 0.6, 0.4]],
        [[0.9, 0.5, 0.4], [0.9, 0.5, 0.6]],
        {"shape": "cylinder", "center": [0.4, 0.5, 0.4], "radius": 0.05, "height": 0.3},
        {"shape": "capsule", "center": [0.6, 0.4, 0.5], "radius": 0.04, "length": 0.2},
        {"shape": "ellipsoid", "center": [0.55, 0.6, 0.5], "radii": [0.05, 0.1, 0.07]},
        {
            "shape": "box",
            "center": [0.5, 0.5, 0.7],
            "size": [0.2, 0.2, 0.05],
            "quaternion_wxyz": [0.8, 0.6, 0, 0],
        },
        load={"shape": "bar", "length": 0.2, "radius": 0.01},
    ),
    "nothing in the way": lambda: scene_of(*PAIR, load={"shape": "bar", "length": 0.2}),
    "nothing to do": lambda: scene_of(PAIR[0], PAIR[0], load={"shape": "bar", "length": 0.2}),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_all_kinds(name):
    scene = SCENES[name]()
    solution = comove.solve(scene, seed=0)
    if name == "nothing to do":
        assert solution.verified
        assert solution.cost.total == pytest.approx(0.0, abs=1e-6)
        return
    assert_verified(solution)


@pytest.mark.parametrize("name", ["one hand in space", "a distance without a load", "a frame", "two groups"])
@pytest.mark.few(1)
def test_scenes_without_planner(name):
    assert_verified(comove.solve(SCENES[name](), seed=0, planner=False))


def test_nothing_in_the_way_is_nearly_straight():
    """The best motion without obstacles: no detour."""
    y = comove.solve(SCENES["nothing in the way"](), seed=0).attempt.hands(S)[0]
    assert np.linalg.norm(np.diff(y, axis=0), axis=-1).sum(axis=0).max() < 0.83
    assert np.abs(y[..., 1] - y[0, :, 1]).max() < 0.03


# --- What was taught ---


def taught(n_dims=2):
    """A hand that swings aside on its way, far more than anything in the way asks for."""
    time_ = np.linspace(0.0, 3.0, 301)
    s = time_ / 3.0
    along = s**3 * (10 - 15 * s + 6 * s**2)
    position = np.zeros((301, n_dims))
    position[:, 0], position[:, 1] = along, 0.25 * np.sin(np.pi * along) ** 2
    return DMP.fit(Demonstration(time_, position, "swing"))


def away_from(solution, dmp):
    """Root mean square distance [m] of the hands from the carried demonstration."""
    wanted = carried_demonstration(dmp, solution.scene)[..., : solution.scene.n_dims]
    y = solution.attempt.hands(np.linspace(0, 1, N_STEPS))[0]
    return float(np.sqrt(((y - wanted) ** 2).sum(axis=-1).mean()))


@pytest.mark.parametrize("name", ["wide", "narrow", "window"])
@pytest.mark.few(1)
def test_resemblance_keeps_the_taught_shape(name):
    dmp, scene = taught(example(name).n_dims), example(name)
    solutions = [
        comove.solve(scene, demonstration=dmp, objective=PaperCost(resemblance=weight))
        for weight in (0.0, 10.0)
    ]
    for solution in solutions:
        assert_verified(solution)
    plain, alike = (away_from(solution, dmp) for solution in solutions)
    assert alike < 0.5 * plain
    assert solutions[0].cost.resemblance == 0.0
    n_hands = len(scene.manipulators)
    assert solutions[1].cost.resemblance == pytest.approx(10.0 * n_hands * alike**2, rel=1e-6)


def test_resemblance_without_planner():
    dmp = taught()
    alike = comove.solve(
        example("wide"), demonstration=dmp, objective=PaperCost(resemblance=10.0), planner=False
    )
    assert_verified(alike)
    assert away_from(alike, dmp) < 0.5 * away_from(solved("wide", planner=False), dmp)


def test_a_demonstration_is_carried_to_every_hand():
    """By the similarity that maps its ends to the hand's: shapes are equal up to turn and scale."""
    dmp, scene = taught(), example("wide")
    carried = carried_demonstration(dmp, scene)
    assert np.abs(carried[0, :, :2] - scene.start).max() < 1e-12
    assert np.abs(carried[-1, :, :2] - scene.goal).max() < 1e-12
    own = dmp.at(np.linspace(0, dmp.duration, N_STEPS)).position
    for i in range(2):
        scale = np.linalg.norm(scene.goal[i] - scene.start[i]) / np.linalg.norm(dmp.goal - dmp.start)
        lengths = np.linalg.norm(carried[:, i, :2] - carried[0, i, :2], axis=1)
        assert np.abs(lengths - scale * np.linalg.norm(own - own[0], axis=1)).max() < 0.02


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"obstacles": "constraints"}, "did you mean 'constraint'"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 1.5}, "whole number"),
        ({"method": "projection"}, "Projection"),
        ({"budget": float("nan")}, "positive number of seconds"),
    ],
)
def test_arguments_out_of_range(arguments, words):
    with pytest.raises(OptionError, match=words):
        comove.solve(example("wide"), **arguments)


def test_cost_weights_out_of_range():
    with pytest.raises(OptionError, match="goal"):
        PaperCost(goal=float("nan"))


@pytest.mark.slow
def test_without_the_planner_nothing_is_planned(monkeypatch):
    """Not even as a last resort: on a scene without solution the restarts go on until time is up."""

    def plan(*_, **__):
        pytest.fail("the planner ran")

    monkeypatch.setattr("comove.planning.kinematics.plan", plan)
    method = Comove(settings=MethodSettings(restarts=1))
    assert not comove.solve(closed(), method=method, planner=False, budget=3.0).verified


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scene": "narrow.yaml"}, "Scene.load"),
        ({"scene": {}}, "Scene.load"),
        ({"demonstration": "Angle"}, "DMP.fit"),
        ({"budget": "3"}, "budget"),
        ({"budget": None}, "budget"),
        ({"checks": print}, "checks"),
        ({"checks": "abc"}, "checks"),
        ({"checks": None}, "checks"),
    ],
)
def test_slips_are_told(wrong, message):
    arguments = {"scene": example("narrow"), **wrong}
    with pytest.raises(OptionError, match=message):
        comove.solve(arguments.pop("scene"), **arguments)


@pytest.mark.parametrize("planner", [True, False])
def test_the_caller_ends_the_search_at_once_from_any_thread(planner):
    """Where there is no solution, a search goes on until its budget is spent, unless it is stopped."""
    import threading

    asked, wished = [], threading.Event()
    threading.Timer(0.3, wished.set).start()

    def stop():
        asked.append(wished.is_set())
        return wished.is_set()

    solution = comove.solve(closed(), planner=planner, budget=600.0, stop=stop)
    assert solution.interrupted
    assert not solution.verified
    assert asked[-1]
    assert not any(asked[:-1]), "once it is wished for, nobody is asked again"


def test_what_was_found_before_the_end_is_kept():
    found = []
    solution = comove.solve(
        example("narrow"), seed=0, progress=lambda p: found.append(p.motion), stop=lambda: any(found)
    )
    assert solution.interrupted
    assert_verified(solution)
