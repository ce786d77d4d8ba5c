"""Hands with orientations on one phase: relative poses hold whatever happens, prescribed ones are followed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.poses import VERTICAL, Pose, PoseDMP
from comove.dmp.projection import (
    HandDistance,
    Poses,
    ProjectionSettings,
    RelativePose,
    SameHeight,
    Separation,
    Upright,
    project,
)
from comove.errors import ConstraintError, DemonstrationError, OptionError
from tests.cases import examples

from .movements import recording

seeds = st.integers(0, 2**32 - 1)


def random_pose(rng, reach=0.4):
    return Pose.of(rng.uniform(-reach, reach, 3), Rotation.random(random_state=rng.integers(2**31)))


def carried(n_hands, seed=0):
    rng = np.random.default_rng(seed)
    grasps = {f"hand{i}": random_pose(rng) for i in range(n_hands)}
    return CooperativeDMP(PoseDMP.fit(recording(seed)), grasps)


def relative_error(poses, grasps):
    """Largest error of a relative pose, [m] or [rad]: hands against the first one, by scipy."""
    first, worst = next(iter(grasps)), 0.0
    for name, grasp in grasps.items():
        seen = poses[first].rotation.inv()
        held = grasps[first].rotation.inv()
        away = seen.apply(poses[name].position - poses[first].position)
        wanted = held.apply(grasp.position - grasps[first].position)
        turn = (seen * poses[name].rotation) * (held * grasp.rotation).inv()
        worst = max(worst, np.linalg.norm(away - wanted), turn.magnitude())
    return worst


@pytest.mark.parametrize("n_hands", [2, 3, 4, 5, 6])
@pytest.mark.few(1)
def test_a_rigid_load_whatever_happens(n_hands):
    """Double and half speed, a stop, backwards, a goal that jumps, a push of the load."""
    dmp = carried(n_hands)
    goal = random_pose(np.random.default_rng(99), reach=1.0)
    state, rates = dmp.initial_state(), [1.0, 2.0, 0.5, 0.0, -1.0, 1.0, 1.0]
    for k in range(700):
        state = dmp.step(state, 0.01, rate=rates[k // 100])
        if k == 150:
            state = dmp.redirected(state, goal)
        if k == 520:
            load = dmp.load.pose(state.parts[""])
            pushed = Pose.of(load.position + 0.05, load.rotation * Rotation.from_rotvec([0.1, 0, 0]))
            state = dmp.displaced(state, pushed)
        assert relative_error(dmp.poses(state), dmp.hands) < 1e-12
    state = dmp.step(state, 10.0)
    load = dmp.load.pose(state.parts[""])
    assert np.abs(load.position - goal.position).max() < 1e-9
    assert (load.rotation * goal.rotation.inv()).magnitude() < 1e-9


@examples(15)
@given(seeds, st.integers(1, 6))
def test_rollouts_hold_the_load_too(seed, n_hands):
    dmp = carried(n_hands, seed)
    path = dmp.rollout(goal=random_pose(np.random.default_rng(seed + 1)), duration=1.5, n_steps=23)
    assert path.position.shape == (23, n_hands, 3) and path.manipulators == dmp.manipulators
    for k in range(23):
        poses = {
            name: Pose(path.position[k, i], path.orientation[k, i])
            for i, name in enumerate(path.manipulators)
        }
        assert relative_error(poses, dmp.hands) < 1e-12
    assert np.abs(path.velocity[-1]).max() < 1e-9 and np.abs(path.angular_velocity[-1]).max() < 1e-9


def test_steps_equal_the_rollout():
    dmp = carried(3)
    state = dmp.step(dmp.step(dmp.initial_state(), 0.7), 0.6)
    path = dmp.at([1.3])
    for i, pose in enumerate(dmp.poses(state).values()):
        assert np.abs(pose.position - path.position[0, i]).max() < 1e-12
        assert (
            pose.rotation * Rotation.from_quat(path.orientation[0, i], scalar_first=True).inv()
        ).magnitude() < 1e-9


def differences(dmp, time, h=1e-5):
    """Velocities and angular velocities of all hands by differences."""
    ahead, behind = dmp.at(time + h), dmp.at(time - h)
    turns = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * h)
    return (ahead.position - behind.position) / (2 * h), turns.reshape(ahead.position.shape)


def test_one_hand_turns_the_lid_while_both_move():
    """Seen from the holder, the turner does what its own movement says; velocities are those of the path."""
    s = np.linspace(0, 1, 301)
    turns = Rotation.from_rotvec(np.outer(7 * s**3 * (10 - 15 * s + 6 * s**2), VERTICAL))
    lid = Demonstration(3 * s, np.tile([0, 0, 0.1], (301, 1)), orientation=turns.as_quat(scalar_first=True))
    turner = PoseDMP.fit(lid, n_basis=25)
    dmp = CooperativeDMP(PoseDMP.fit(recording(1)), {"holder": Pose([0, 0, -0.1]), "turner": turner})
    time = np.linspace(0.1, 2.9, 29)
    path, own = dmp.at(time), turner.at(time)
    holder, hand = (Rotation.from_quat(path.orientation[:, i], scalar_first=True) for i in (0, 1))
    assert (holder.inv() * hand * own.rotation.inv()).magnitude().max() < 1e-12
    assert np.abs(holder.inv().apply(path.position[:, 1] - path.position[:, 0]) - [0, 0, 0.2]).max() < 1e-9
    velocity, spin = differences(dmp, time)
    assert np.abs(velocity - path.velocity).max() < 1e-6 and np.abs(spin - path.angular_velocity).max() < 1e-5


def test_from_the_demonstration_of_one_hand():
    """The hand that was shown does what was shown; the others hold on."""
    shown, rng = recording(2), np.random.default_rng(3)
    grasps = {"left": random_pose(rng), "right": random_pose(rng)}
    dmp = CooperativeDMP.from_hand(shown, "left", grasps, n_basis=50)
    path = dmp.at(shown.time)
    assert np.abs(path.position[:, 0] - shown.position).max() < 2e-3
    left = Rotation.from_quat(path.orientation[:, 0], scalar_first=True)
    assert (left * shown.rotation.inv()).magnitude().max() < 2e-3
    with pytest.raises(OptionError, match="did you mean 'left'"):
        CooperativeDMP.from_hand(shown, "lefft", grasps)


def alone(constraints, seed=4):
    """Two hands that move for themselves, half a metre apart."""
    one = PoseDMP.fit(recording(seed, reach=0.6))
    start, goal = one.start, one.goal
    other = one.towards(
        start=Pose.of(start.position + [0.1, 0.5, 0.05], start.rotation),
        goal=Pose.of(goal.position + [0.05, 0.45, -0.1], goal.rotation),
    )
    return CooperativeDMP(None, {"left": one, "right": other}, constraints)


def average_height(poses):
    """A user's own constraint: the mean height is a quarter of a metre."""
    return 0.5 * (poses.position("left")[:, 2] + poses.position("right")[:, 2]) - 0.25


CASES = {
    "distance": [HandDistance("left", "right", 0.5)],
    "height": [SameHeight("left", "right")],
    "both": [SameHeight("left", "right"), HandDistance("left", "right", 0.45)],
    "separation": [Separation("left", "right", 0.52)],
    "pose": [RelativePose("left", "right", Pose.of([0.1, 0.45, 0.0], Rotation.from_rotvec([0.2, 0, 0])))],
    "level": [Upright("left"), Upright("right")],
    "own": [average_height],
}


@pytest.mark.parametrize("constraints", CASES.values(), ids=CASES)
@pytest.mark.few(3)
def test_constraints_between_independent_hands(constraints):
    dmp = alone(constraints)
    path = dmp.rollout(n_steps=101)
    poses = Poses(path.manipulators, path.position, path.orientation)
    for constraint in constraints:
        assert np.abs(constraint(poses)).max() < 1e-10
    time = np.linspace(0.1, 2.9, 15)
    velocity, spin = differences(dmp, time)
    assert np.abs(velocity - dmp.at(time).velocity).max() < 1e-4 * (1 + np.abs(velocity).max())
    assert np.abs(spin - dmp.at(time).angular_velocity).max() < 1e-4 * (1 + np.abs(spin).max())


@pytest.mark.parametrize("constraints", CASES.values(), ids=CASES)
def test_and_online_at_any_pace(constraints):
    dmp = alone(constraints)
    state = dmp.initial_state()
    for k, rate in enumerate([1.0, 2.0, 0.0, -1.0, 0.5, 1.0, 1.0, 1.0]):
        state = dmp.step(state, 0.3, rate=rate)
        if k == 4:
            moved = dmp.hands["left"].goal
            state = dmp.redirected(state, Pose.of(moved.position + [0.1, 0, 0], moved.rotation), "left")
        poses = dmp.poses(state)
        single = Poses(
            dmp.manipulators, *(np.stack([getattr(p, what) for p in poses.values()])[None] for what in
                                ("position", "orientation"))
        )  # fmt: skip
        for constraint in constraints:
            assert np.abs(constraint(single)).max() < 1e-10


@examples(30)
@given(seeds)
def test_the_projection_is_the_nearest_point_for_a_distance(seed):
    """Both hands move by half of what is missing, along the line between them."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-1, 1, (4, 2, 3))
    positions[:, 1] += 2.0
    poses = Poses(("a", "b"), positions, np.tile([1.0, 0, 0, 0], (4, 2, 1)))
    moved = project(poses, [HandDistance("a", "b", 0.7)])
    middle, away = positions.mean(axis=1), positions[:, 1] - positions[:, 0]
    half = 0.35 * away / np.linalg.norm(away, axis=1, keepdims=True)
    assert np.abs(moved.positions - np.stack([middle - half, middle + half], axis=1)).max() < 1e-6
    assert np.abs(moved.orientations - poses.orientations).max() < 1e-9


@pytest.mark.parametrize("turn_length", [0.1, 0.3, 1.0])
def test_a_radian_counts_as_a_length(turn_length):
    """The tip of a pointer is to be lowered: it moves and turns as much as the metric says."""

    def tip(poses):
        return poses.position("a")[:, 2] + 0.6 * poses.rotation("a")[:, 2, 0] + 1e-4

    poses = Poses(("a",), np.zeros((1, 1, 3)), np.array([[[1.0, 0, 0, 0]]]))
    moved = project(poses, [tip], settings=ProjectionSettings(turn_length=turn_length))
    share = (0.6 / turn_length) ** 2
    assert moved.positions[0, 0, 2] == pytest.approx(-1e-4 / (1 + share), rel=1e-3)
    assert moved.rotation("a")[0, 2, 0] * 0.6 == pytest.approx(-1e-4 * share / (1 + share), rel=1e-3)


def test_what_is_met_is_left_alone():
    poses = Poses(("a", "b"), np.array([[[0, 0, 0], [0, 0.8, 0.0]]]), np.tile([1.0, 0, 0, 0], (1, 2, 1)))
    assert project(poses, [Separation("a", "b", 0.5), SameHeight("a", "b")]) is poses


def test_a_tray_is_not_turned_upside_down():
    turned = Rotation.from_rotvec([[2.0, 0.5, 0]]).as_quat(scalar_first=True)
    moved = project(Poses(("a",), np.zeros((1, 1, 3)), turned[None]), [Upright("a")])
    assert np.abs(moved.rotation("a")[0] @ VERTICAL - VERTICAL).max() < 1e-9


def test_constraints_that_contradict_each_other():
    with pytest.raises(ConstraintError, match="cannot be met together"):
        alone([HandDistance("left", "right", 0.4), HandDistance("left", "right", 0.5)]).rollout()


@pytest.mark.slow
def test_projections_that_jump_are_refused():
    one = PoseDMP.fit(recording(5, reach=3.0))
    other = one.towards(start=Pose([0, 0.4, 0.1]), goal=Pose([1, 0.5, 0.4]))
    wanted = Pose.of([0.1, 0.4, 0], Rotation.from_rotvec([0, 3.0, 0.0]))
    dmp = CooperativeDMP(None, {"a": one, "b": other}, [RelativePose("a", "b", wanted)])
    try:
        path = dmp.rollout(n_steps=601)
    except ConstraintError as error:
        assert "times as fast" in str(error)
    else:
        steps = np.linalg.norm(np.diff(path.position, axis=0), axis=2)
        assert steps.max() < 0.1


def straight(start, goal, vector=(0.0, 0, 0)):
    """A hand on a straight line from rest to rest in 4 s, turning by a rotation vector."""
    s = np.linspace(0, 1, 201)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    turns = Rotation.from_rotvec(np.outer(way, vector)).as_quat(scalar_first=True)
    return PoseDMP.fit(
        Demonstration(4 * s, start + np.outer(way, np.subtract(goal, start)), orientation=turns)
    )


@pytest.mark.parametrize("n_steps", [51, 101, 201, 401])
def test_jumps_are_refused_however_they_are_sampled(n_steps):
    """Two hands pass through each other: pushed apart, they change sides in no time."""
    hands = {"a": straight([0, 0, 0.0], [1, 0, 0]), "b": straight([1, 1e-3, 0.0], [0, 1e-3, 0])}
    with pytest.raises(ConstraintError, match="times as fast"):
        CooperativeDMP(None, hands, [Separation("a", "b", 0.2)]).rollout(n_steps=n_steps)
    apart = {"a": hands["a"], "b": straight([1, 0.1, 0.0], [0, 0.1, 0])}
    assert CooperativeDMP(None, apart, [Separation("a", "b", 0.2)]).rollout(n_steps=n_steps).position.shape[0]


@pytest.mark.parametrize("n_steps", [301, 901, 1001])
def test_upright_through_right_angles(n_steps):
    dmp = CooperativeDMP(None, {"a": straight([0, 0, 0.0], [1, 0, 0], [0, 2.5, 0])}, [Upright("a")])
    path = dmp.rollout(n_steps=n_steps)
    assert np.abs(path.rotation.apply(VERTICAL) - VERTICAL).max() < 1e-9


def test_slips_are_told():
    load, grasp = PoseDMP.fit(recording(0)), Pose([0, 0, 0.1])
    shown = recording(0)
    with pytest.raises(DemonstrationError, match="orientation"):
        CooperativeDMP.from_hand(Demonstration(shown.time, shown.position), "a", {"a": grasp})
    for grasps in ([grasp], None, {"a": Pose([0.0, 1.0])}, {"a": [0, 0, 0]}):
        with pytest.raises(OptionError, match="grasps"):
            CooperativeDMP.from_hand(shown, "a", grasps)
    for constraints in (["distance"], HandDistance("a", "b", 1.0), "x"):
        with pytest.raises(OptionError, match="constraints"):
            CooperativeDMP(load, {"a": grasp}, constraints)
    for wrong in (lambda: HandDistance("a", "b", "1"), lambda: Separation("a", "b", -1.0),
                  lambda: RelativePose("a", "b", [0, 1, 0]), lambda: Upright("a", "z"),
                  lambda: CooperativeDMP(load, [grasp])):  # fmt: skip
        with pytest.raises(OptionError):
            wrong()
    assert len(alone([SameHeight("left", "right")]).at([]).time) == 0
    assert np.isfinite(alone([SameHeight("left", "right")]).at([-1e-6, 0.0]).velocity).all()
    with pytest.raises(OptionError, match="gives"):
        CooperativeDMP(None, {"a": load, "b": load}, [lambda poses: "text"]).rollout()


def test_what_is_refused():
    load, grasp = PoseDMP.fit(recording(0)), Pose([0, 0, 0.1])
    for hands, constraints, message in [
        ({}, (), "names"),
        ({"": grasp}, (), "names"),
        ({"a": Pose([0.0, 1.0])}, (), "planar"),
        ({"a": load.towards(duration=9.0)}, (), "3, 9 s"),
        ({"a": np.zeros(3)}, (), "'a' is ndarray"),
    ]:
        with pytest.raises(OptionError, match=message):
            CooperativeDMP(load, hands, constraints)
    with pytest.raises(OptionError, match="nothing moves"):
        CooperativeDMP(None, {"a": grasp})
    with pytest.raises(OptionError, match="'b' does not move"):
        CooperativeDMP(None, {"a": load, "b": grasp})
    dmp = CooperativeDMP(None, {"a": load, "b": load}, [lambda poses: poses.position("c")[:, 0]])
    with pytest.raises(OptionError, match="no manipulator 'c'"):
        dmp.rollout()
    dmp = CooperativeDMP(None, {"a": load, "b": load}, [lambda poses: 3.0])
    with pytest.raises(OptionError, match=r"shape \(n_steps,\)"):
        dmp.rollout()
    with pytest.raises(OptionError, match="no common start or goal"):
        dmp.rollout(goal=grasp)
    with pytest.raises(OptionError, match="the load has no movement"):
        dmp.redirected(dmp.initial_state(), grasp)
    with pytest.raises(OptionError, match="n_steps"):
        dmp.rollout(n_steps=0)


@pytest.mark.parametrize("time", [1.0, "x", ["x"], [[0.0], [1.0]], [0.0, np.nan], None])
@pytest.mark.parametrize("constraints", [(), (HandDistance("a", "b", 0.5),)])
def test_times_that_are_none(time, constraints):
    load = PoseDMP.fit(recording(0))
    aside = load.towards(start=Pose(load.start.position + 0.3, load.start.orientation))
    for movement in (load, CooperativeDMP(None, {"a": load, "b": aside}, constraints)):
        with pytest.raises(OptionError, match="give an array of finite numbers"):
            movement.at(time)


@examples(30)
@given(seeds, st.floats(0.0, 5.0), st.floats(0.1, 5.0))
def test_who_is_twice_as_mobile_makes_way_twice_as_far(seed, one, other):
    """For a distance both move along the line between them, in the proportion of their mobilities; a leader stays."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-1, 1, (3, 2, 3))
    positions[:, 1] += 2.0
    turned = Rotation.random(6, random_state=seed).as_quat(scalar_first=True).reshape(3, 2, 4)
    poses = Poses(("a", "b"), positions, turned)
    moved = project(poses, [HandDistance("a", "b", 0.7)], (one, other))
    ways = np.linalg.norm(moved.positions - positions, axis=2)
    assert np.abs(ways[:, 0] * other - ways[:, 1] * one).max() < 1e-6
    assert np.abs(np.linalg.norm(moved.positions[:, 1] - moved.positions[:, 0], axis=1) - 0.7).max() < 1e-11
    if one == 0.0:
        assert np.array_equal(moved.positions[:, 0], positions[:, 0])


@pytest.mark.parametrize("name", ["distance", "height", "pose"])
def test_a_leader_keeps_its_movement_and_the_follower_comes_along(name):
    dmp = replace(alone(CASES[name]), mobility={"left": 0.0})
    path, own = dmp.rollout(n_steps=41), dmp.hands["left"].rollout(n_steps=41)
    assert np.array_equal(path.position[:, 0], own.position)
    assert np.array_equal(path.orientation[:, 0], own.orientation)
    poses = Poses(path.manipulators, path.position, path.orientation)
    assert max(np.abs(constraint(poses)).max() for constraint in CASES[name]) < 1e-10
    alike = alone(CASES[name]).rollout(n_steps=41)
    assert np.abs(alike.position[:, 0] - own.position).max() > 1e-3  # where both make way
    state = dmp.step(dmp.initial_state(), 0.5)
    leader = dmp.hands["left"].at([0.5])
    assert np.abs(dmp.poses(state)["left"].position - leader.position[0]).max() < 1e-12


def test_mobilities_that_are_none():
    distance = [HandDistance("left", "right", 0.5)]
    for mobility in ({"left": -1.0}, {"left": np.nan}, {"lefft": 0.0}, [0.0, 1.0], {"left": "0"}):
        with pytest.raises(OptionError, match="mobility"):
            replace(alone(distance), mobility=mobility)
    with pytest.raises(OptionError, match="no hand may make way"):
        replace(alone(distance), mobility={"left": 0.0, "right": 0.0})
    with pytest.raises(ConstraintError, match="cannot be met"):
        replace(alone([*distance, Upright("left")]), mobility={"left": 0.0}).rollout()
    poses = Poses(("a",), np.zeros((1, 1, 3)), np.array([[[1.0, 0, 0, 0]]]))
    with pytest.raises(OptionError, match="mobility"):
        project(poses, [Upright("a")], (1.0, 2.0))


def test_the_load_is_pushed_and_the_grasps_hold():
    """A coupling of the load acts on the load alone; that of a carried hand in the load's frame."""
    dmp = carried(3)
    pushed, free = dmp.initial_state(), dmp.initial_state()
    push, drift = np.array([0.5, 0, 0, 0, 0, 1.0]), np.array([0, 0.1, 0, 0.2, 0, 0])
    for _ in range(20):
        pushed = dmp.step(pushed, 0.02, coupling={"": push}, velocity_coupling={"": drift})
        free = dmp.step(free, 0.02)
    load = [dmp.load.pose(state.parts[""]) for state in (pushed, free)]
    assert np.linalg.norm(load[0].position - load[1].position) > 0.01
    assert (load[0].rotation * load[1].rotation.inv()).magnitude() > 0.01
    assert relative_error(dmp.poses(pushed), dmp.hands) < 1e-12
    with pytest.raises(OptionError, match="has no movement of its own"):
        dmp.step(free, 0.1, coupling={"hand0": push})
    with pytest.raises(OptionError, match="coupling"):
        dmp.step(free, 0.1, coupling=push)


def test_a_load_may_be_caught_and_handed_on_in_motion():
    twist = np.array([0.2, -0.1, 0.05, 0.3, 0.1, -0.4])
    dmp = carried(2).towards(start_velocity=twist, goal_velocity=-twist)
    path = dmp.load.rollout()
    for k, wanted in ((0, twist), (-1, -twist)):
        assert np.abs(path.velocity[k] - wanted[:3]).max() < 1e-9
        assert np.abs(path.angular_velocity[k] - wanted[3:]).max() < 1e-9
    assert np.abs(path.position[-1] - carried(2).load.goal.position).max() < 1e-10
    velocity, spin = differences(dmp, np.array([0.1, 2.9]))
    played = dmp.at([0.1, 2.9])
    assert np.abs(velocity - played.velocity).max() < 1e-6
    assert np.abs(spin - played.angular_velocity).max() < 1e-5
    with pytest.raises(OptionError, match="no common start or goal"):
        alone([]).towards(goal_velocity=twist)
