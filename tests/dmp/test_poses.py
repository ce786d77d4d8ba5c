"""Movements on SE(2) and SE(3): exact ends, no trace of the signs of quaternions, the right velocities."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration
from comove.dmp.poses import VERTICAL, Pose, PoseDMP
from comove.dmp.variants import Variant
from comove.errors import ComoveWarning, DemonstrationError, OptionError
from tests.cases import examples

from .movements import recording

seeds = st.integers(0, 2**32 - 1)
ENDING = [variant for variant in Variant if variant is not Variant.RHYTHMIC]


def angle_between(a, b):
    return (a * b.inv()).magnitude()


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("variant", ENDING)
def test_it_fits_what_it_is_shown(n_dims, variant):
    shown = recording(1, n_dims)
    dmp = PoseDMP.fit(shown, n_basis=40, variant=variant)
    path = dmp.at(shown.time)
    assert np.abs(path.position - shown.position).max() < 2e-3
    assert angle_between(path.rotation, shown.rotation).max() < 5e-3
    assert dmp.weights.shape == (3 if n_dims == 2 else 6, 40)


@examples(20)
@given(seeds)
def test_signs_of_quaternions_do_not_matter(seed):
    shown = recording(seed)
    signs = np.random.default_rng(seed).choice([-1, 1], (shown.n_steps, 1))
    raw = SimpleNamespace(
        time=shown.time, position=shown.position, orientation=shown.orientation * signs,
        start_velocity=shown.start_velocity,
    )  # fmt: skip
    one, other = PoseDMP.fit(shown), PoseDMP.fit(raw)
    assert angle_between(one.at(shown.time).rotation, other.at(shown.time).rotation).max() < 1e-9


@examples(30)
@given(seeds, st.sampled_from(ENDING))
def test_both_ends_are_exact_and_held(seed, variant):
    dmp = PoseDMP.fit(recording(2), variant=variant)
    rng = np.random.default_rng(seed)
    start, goal = (
        Pose.of(rng.uniform(-1, 1, 3), Rotation.random(random_state=rng.integers(2**31))) for _ in "ab"
    )
    path = dmp.towards(start=start, goal=goal, duration=2.0).at(np.array([0.0, 2.0, 2.5, 9.0]))
    assert np.abs(path.position[0] - start.position).max() < 1e-12
    assert angle_between(path.rotation[0], start.rotation) < 1e-9
    assert np.abs(path.position[1:] - goal.position).max() < 1e-10
    assert angle_between(path.rotation[1:], goal.rotation).max() < 1e-9
    assert np.abs(path.angular_velocity[1:]).max() < 1e-9 and np.abs(path.velocity[1:]).max() < 1e-9


def test_goal_equal_to_the_start():
    dmp = PoseDMP.fit(recording(3))
    path = dmp.rollout(goal=dmp.start)
    assert np.isfinite(path.orientation).all() and np.isfinite(path.angular_velocity).all()
    assert angle_between(path.rotation[-1], dmp.start.rotation) < 1e-9


@pytest.mark.parametrize("n_dims", [2, 3])
def test_velocities_are_those_of_the_path(n_dims):
    dmp = PoseDMP.fit(recording(4, n_dims))
    time, h = np.linspace(0.2, 2.8, 50), 1e-5
    ahead, behind, path = dmp.at(time + h), dmp.at(time - h), dmp.at(time)
    spin = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * h)
    assert np.abs(spin - path.angular_velocity).max() < 1e-5
    assert np.abs((ahead.position - behind.position) / (2 * h) - path.velocity).max() < 1e-5


def test_several_turns_of_a_screw():
    s = np.linspace(0, 1, 800)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    turns = Rotation.from_rotvec(np.outer(2 * np.pi * 3.4 * way, [0, 0.6, 0.8]))
    shown = Demonstration(s, np.outer(way, [0, 0, 0.01]), orientation=turns.as_quat(scalar_first=True))
    dmp = PoseDMP.fit(shown, n_basis=30)
    assert angle_between(dmp.at(s).rotation, turns).max() < 0.02
    assert np.abs(dmp.turning.start - -2 * np.pi * 3.4 * np.array([0, 0.6, 0.8])).max() < 1e-9


def test_a_tray_stays_level():
    """Turning about the vertical only: the tilt is none at every instant, by construction."""
    shown = recording(5)
    yaw = np.linspace(0, 2.0, shown.n_steps) + 0.3 * np.sin(np.linspace(0, 7, shown.n_steps))
    level = Rotation.from_rotvec(np.outer(yaw, VERTICAL)).as_quat(scalar_first=True)
    dmp = PoseDMP.fit(Demonstration(shown.time, shown.position, orientation=level), axis=VERTICAL)
    assert dmp.weights.shape == (4, 20)
    path = dmp.rollout(goal=Pose.of([1.0, 2, 3], 0.7), n_steps=301)
    assert np.abs(path.rotation.apply(VERTICAL) - VERTICAL).max() < 1e-15
    assert angle_between(path.rotation[-1], Rotation.from_rotvec([0, 0, 0.7])) < 1e-12
    with pytest.raises(OptionError, match="tilted by"):
        dmp.rollout(goal=Pose.of([1.0, 2, 3], Rotation.from_rotvec([0.1, 0, 0])))


def test_a_recorded_tilt_that_is_left_out_is_said():
    with pytest.warns(ComoveWarning, match="tilts by up to"):
        PoseDMP.fit(recording(6), axis=VERTICAL)


@examples(20)
@given(seeds, st.integers(2, 30))
def test_online_equals_the_rollout(seed, n_steps):
    dmp = PoseDMP.fit(recording(7))
    state = dmp.initial_state()
    for time in np.sort(np.random.default_rng(seed).uniform(0, 4, n_steps)):
        if time > state.time:
            state = dmp.step(state, time - state.time)
        path, pose, (velocity, spin) = dmp.at([time]), dmp.pose(state), dmp.twist(state)
        assert np.abs(pose.position - path.position[0]).max() < 1e-12
        assert angle_between(pose.rotation, path.rotation[0]) < 1e-12
        assert np.abs(velocity - path.velocity[0]).max() < 1e-10
        assert np.abs(spin - path.angular_velocity[0]).max() < 1e-10


def test_a_goal_that_moves_and_a_push():
    dmp = PoseDMP.fit(recording(8))
    goal = Pose.of([1, 1, 1], dmp.goal.rotation * Rotation.from_rotvec([0.5, 0, -0.4]))
    state = dmp.initial_state()
    for k in range(300):
        before = dmp.pose(state)
        state = dmp.step(state, 0.01, rate=1.0)
        assert angle_between(dmp.pose(state).rotation, before.rotation) < 0.1
        if k == 100:
            pushed = Pose.of(before.position + 0.01, before.rotation * Rotation.from_rotvec([0.02, 0, 0]))
            state = dmp.displaced(state, pushed)
            assert angle_between(dmp.pose(state).rotation, pushed.rotation) < 1e-12
        if k == 150:
            state = dmp.redirected(state, goal)
    state = dmp.step(state, 3.0)
    assert np.abs(dmp.pose(state).position - goal.position).max() < 1e-9
    assert angle_between(dmp.pose(state).rotation, goal.rotation) < 1e-9


def test_the_plane():
    dmp = PoseDMP.fit(recording(9, n_dims=2))
    path = dmp.rollout(start=Pose.of([0.0, 0.0], 1.0), goal=Pose.of([1.0, -1.0], 3.0), n_steps=11)
    assert path.position.shape == (11, 2)
    assert angle_between(path.rotation[-1], Rotation.from_rotvec([0, 0, 3.0])) < 1e-12
    assert not path.orientation[:, 1:3].any()


def test_what_is_refused():
    shown = recording(0)
    with pytest.raises(DemonstrationError, match="no orientations"):
        PoseDMP.fit(Demonstration(shown.time, shown.position))
    with pytest.raises(DemonstrationError, match="coordinates of position"):
        PoseDMP.fit(Demonstration(shown.time, shown.position[:, :1], orientation=shown.orientation))
    with pytest.raises(OptionError, match="rhythmic"):
        PoseDMP.fit(shown, variant="rhythmic")
    with pytest.raises(OptionError, match="axis"):
        PoseDMP.fit(shown, axis=[0, 0, 0])
    for wrong in ([1.0], [np.nan, 0, 0], [1, 2, 3, 4]):
        with pytest.raises(OptionError, match="position"):
            Pose(wrong)
    for wrong in ([1, 1, 0, 0], [1, 0, 0], [0, 0, 0, 0]):
        with pytest.raises(OptionError, match="w, x, y, z"):
            Pose([0, 0, 0], wrong)
    with pytest.raises(OptionError, match="3 dimensions"):
        PoseDMP.fit(shown).rollout(goal=Pose([0.0, 1.0]))
    with pytest.raises(OptionError, match="n_steps"):
        PoseDMP.fit(shown).rollout(n_steps=1)


def test_a_wandering_whole_turn_is_refused_in_words():
    s = np.linspace(0, 1, 300)
    vectors = np.stack([6.28 * (1 - s) + 0.2, 0.05 * np.cos(40 * s), 0.05 * np.sin(40 * s)], axis=1)
    orientation = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    with pytest.raises(DemonstrationError, match="cut the recording in two"):
        PoseDMP.fit(Demonstration(s, np.zeros((300, 3)) + s[:, None], orientation=orientation))


def turning_by(angle, n_steps=401):
    """A hand that turns by `angle` about z on its way, from rest to rest in 4 s."""
    s = np.linspace(0, 1, n_steps)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    turns = Rotation.from_rotvec(np.outer(way, [0, 0, angle])).as_quat(scalar_first=True)
    return PoseDMP.fit(Demonstration(4 * s, np.outer(way, [1.0, 0, 0]), orientation=turns), n_basis=25)


@pytest.mark.parametrize("turns", [0.4, 0.9, 1.0, 1.1, 1.5, 1.9, 2.0, 2.5, 3.0, 3.7])
def test_a_measured_start_does_not_lose_turns(turns):
    """Whole turns are where rotation vectors say little about small changes: 2 mrad at the start change little."""
    dmp = turning_by(2 * np.pi * turns)
    off = Pose(
        dmp.start.position,
        (Rotation.from_rotvec([0.002, 0, 0]) * dmp.start.rotation).as_quat(scalar_first=True),
    )
    taught, measured = dmp.rollout(n_steps=301), dmp.towards(start=off).rollout(n_steps=301)
    assert angle_between(measured.rotation[0], off.rotation) < 1e-9
    assert angle_between(measured.rotation, taught.rotation).max() < 0.02
    assert angle_between(dmp.at(np.linspace(0, 4, 401)).rotation, Rotation.from_rotvec(
        np.outer((s := np.linspace(0, 1, 401)) ** 3 * (10 - 15 * s + 6 * s**2), [0, 0, 2 * np.pi * turns])
    )).max() < 0.02  # fmt: skip


@pytest.mark.parametrize("turns", [0.4, 1.0, 1.5, 2.0, 3.3])
@pytest.mark.few(2)
def test_noise_fed_back_all_the_time_stays_noise(turns):
    """Orientations measured with 2 mrad, in every cycle, wherever the movement is in its turns."""
    dmp, rng = turning_by(2 * np.pi * turns), np.random.default_rng(0)
    state = dmp.initial_state()
    for k in range(400):
        state = dmp.step(state, 0.01)
        pose = dmp.pose(state)
        taught = dmp.at([0.01 * (k + 1)])
        assert angle_between(pose.rotation, taught.rotation[0]) < 0.15
        noise = Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = dmp.displaced(state, Pose.of(pose.position, noise * pose.rotation))


def test_moved_goals_are_reached_by_the_shortest_turn():
    """After any number of moved goals, the way to the next one is no longer than what is missing."""
    dmp = turning_by(1.0)
    state = dmp.step(dmp.initial_state(), 4.0)
    for vector in (
        [0, 0, 2.0],
        [0, 0, 4.0],
        [0, 0, 6.2],
        [0.1, 0, 0],
        [3.0, 0, 0],
        [-3.1, 0.3, 0],
        [0, 0, 0],
    ):
        goal = Pose.of([1.0, 0, 0], Rotation.from_rotvec(vector))
        missing = angle_between(dmp.pose(state).rotation, goal.rotation)
        state, travelled = dmp.redirected(state, goal), 0.0
        for _ in range(150):
            before, state = state, dmp.step(state, 0.01)
            travelled += angle_between(dmp.pose(state).rotation, dmp.pose(before).rotation)
        assert angle_between(dmp.pose(state).rotation, goal.rotation) < 1e-9
        assert travelled < missing + 1e-6


@examples(20)
@given(seeds, st.floats(0.05, 0.75), st.sampled_from([1.0, -1.0, 0.5]))
def test_moved_goals_change_neither_pose_nor_twist(seed, when, rate):
    dmp, rng = PoseDMP.fit(recording(5)), np.random.default_rng(seed)
    state = dmp.step(dmp.step(dmp.initial_state(), when * 3.0), 0.01, rate=rate)
    pushed = Pose.of(dmp.pose(state).position, Rotation.from_rotvec([0.1, 0, 0]) * dmp.pose(state).rotation)
    for now in (state, dmp.step(dmp.displaced(state, pushed), 0.01, rate=rate)):
        moved = dmp.redirected(now, Pose.of(rng.uniform(-1, 1, 3), Rotation.random(random_state=seed)))
        assert angle_between(dmp.pose(moved).rotation, dmp.pose(now).rotation) < 1e-9
        assert np.abs(dmp.twist(moved)[1] - dmp.twist(now)[1]).max() < 1e-6
        a, b = (dmp.twist(dmp.step(one, 1e-5, rate=rate))[1] for one in (moved, now))
        assert np.abs(a - b).max() < 1e-4


def test_axes_of_the_plane_and_numbers_of_all_kinds():
    with pytest.raises(OptionError, match="vertical"):
        PoseDMP.fit(recording(0, n_dims=2), axis=[1.0, 0, 0])
    for angle in (np.float32(1.0), np.int64(1), 1, 1.0):
        assert angle_between(Pose.of([0, 0, 0], angle).rotation, Rotation.from_rotvec([0, 0, 1.0])) < 1e-7
    for wrong in ([1, 2], "x", np.eye(3)):
        with pytest.raises(OptionError, match="Rotation"):
            Pose.of([0, 0, 0], wrong)
    with pytest.raises(OptionError, match="position"):
        Pose("abc")


def test_a_level_body_that_was_tilted_takes_the_nearest_turn():
    s = np.linspace(0, 1, 200)
    level = Rotation.from_rotvec(np.outer(s, [0, 0, 1.0])).as_quat(scalar_first=True)
    dmp = PoseDMP.fit(Demonstration(s, np.outer(s, [1.0, 0, 0]), orientation=level), axis=VERTICAL)
    state = dmp.step(dmp.initial_state(), 0.5)
    tilted = Pose.of([0.5, 0, 0], Rotation.from_rotvec([0.1, 0, 0]) * Rotation.from_rotvec([0, 0, 0.6]))
    pushed = dmp.pose(dmp.displaced(state, tilted))
    assert np.abs(pushed.rotation.apply(VERTICAL) - VERTICAL).max() < 1e-12
    assert angle_between(pushed.rotation, Rotation.from_rotvec([0, 0, 0.6])) < 0.01


@examples(20)
@given(seeds, st.sampled_from(ENDING))
def test_end_velocities_are_met_as_twists(seed, variant):
    """Velocity and angular velocity in the world's axes at both ends; the poses there stay."""
    rng = np.random.default_rng(seed)
    dmp = PoseDMP.fit(recording(seed % 50), variant=variant)
    first, last = rng.uniform(-0.5, 0.5, (2, 6))
    path = dmp.rollout(start_velocity=first, goal_velocity=last, duration=1.5, n_steps=11)
    for k, twist, pose in ((0, first, dmp.start), (-1, last, dmp.goal)):
        assert np.abs(path.velocity[k] - twist[:3]).max() < 1e-9
        assert np.abs(path.angular_velocity[k] - twist[3:]).max() < 1e-8
        assert np.abs(path.position[k] - pose.position).max() < 1e-10
        assert angle_between(path.rotation[k], pose.rotation) < 1e-9


def test_about_a_fixed_axis_the_twist_has_one_number_of_it():
    dmp = PoseDMP.fit(recording(4, n_dims=2))
    path = dmp.rollout(goal_velocity=[0.1, -0.2, 0.7])
    assert np.abs(path.velocity[-1] - [0.1, -0.2]).max() < 1e-9
    assert np.abs(path.angular_velocity[-1] - [0, 0, 0.7]).max() < 1e-9
    for wrong in ([0.1, 0.2], [0.1, 0.2, 0, 0, 0.7], [0, 0, np.nan]):
        with pytest.raises(OptionError, match="goal_velocity"):
            dmp.towards(goal_velocity=wrong)
        with pytest.raises(OptionError, match="coupling"):
            dmp.step(dmp.initial_state(), 0.1, coupling=wrong)


def test_a_recording_cut_off_in_motion_ends_with_its_twist():
    shown = recording(5)
    cut = Demonstration(shown.time[:200], shown.position[:200], orientation=shown.orientation[:200])
    path = PoseDMP.fit(cut, n_basis=30, at_rest=False).at(cut.time)
    ahead, behind = shown.rotation[200], shown.rotation[198]
    dt = shown.time[1]
    assert np.abs(path.velocity[-1] - (shown.position[200] - shown.position[198]) / (2 * dt)).max() < 5e-3
    assert np.abs(path.angular_velocity[-1] - (ahead * behind.inv()).as_rotvec() / (2 * dt)).max() < 2e-2


def test_a_body_at_rest_is_pushed_as_a_free_body_at_first():
    """For a short while c t^2 / 2 and u t, in the world's axes, and later nothing is left of it."""
    pose = Pose.of([0.2, -0.1, 0.3], Rotation.from_rotvec([0.5, -1.0, 0.3]))
    still = Demonstration(np.linspace(0, 1, 50), np.tile(pose.position, (50, 1)),
                          orientation=np.tile(pose.orientation, (50, 1)))  # fmt: skip
    dmp, push = PoseDMP.fit(still), np.array([1.0, -2.0, 0.5, 0.3, 2.0, -1.0])
    dt = 1e-4
    pushed = dmp.pose(dmp.step(dmp.initial_state(), dt, coupling=push))
    turned = (pushed.rotation * pose.rotation.inv()).as_rotvec()
    assert np.abs(pushed.position - pose.position - push[:3] * dt**2 / 2).max() < 5e-3 * dt**2
    assert np.abs(turned - push[3:] * dt**2 / 2).max() < 5e-3 * dt**2
    led = dmp.pose(dmp.step(dmp.initial_state(), dt, velocity_coupling=push))
    turned = (led.rotation * pose.rotation.inv()).as_rotvec()
    assert np.abs(led.position - pose.position - push[:3] * dt).max() < 1e-5 * dt
    assert np.abs(turned - push[3:] * dt).max() < 1e-5 * dt
    state = dmp.step(dmp.initial_state(), 0.3, coupling=push, velocity_coupling=push)
    assert angle_between(dmp.pose(state).rotation, pose.rotation) > 0.01
    state = dmp.step(state, 5.0)
    assert angle_between(dmp.pose(state).rotation, pose.rotation) < 1e-9
    level = PoseDMP.fit(recording(6, n_dims=2))
    state = level.step(level.initial_state(), 0.4, coupling=[0.0, 0.0, 3.0])
    assert np.abs(state.aside.position[:2]).max() == 0.0 < state.aside.position[2]
