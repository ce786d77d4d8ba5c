"""Distributions of poses: exact ends, conditioning on poses, correlation of moving and turning and of hands."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp import Pose, PoseProMP, ProMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.files import dumps, learn_distribution, loads
from comove.errors import DemonstrationError, OptionError
from tests.cases import examples

REFERENCE = Rotation.from_rotvec([2.0, -1.0, 0.5])
SPREAD = 0.2  # rad and 0.1 m, standard deviation in the middle of the way


def recording(rng, turn=0.0, shift=0.0, n_steps=80):
    """A hand that moves and turns about its own way; `turn` and `shift` bend it in the middle."""
    s = np.linspace(0, 1, n_steps)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    bump = np.sin(np.pi * way) ** 2
    vectors = np.stack([0.4 * way, turn * bump, -0.8 * way], axis=1)
    position = np.stack([0.6 * way, shift * bump, 0.1 * bump], axis=1)
    position = position + 0.01 * rng.standard_normal(3)  # nobody begins twice at the same place
    turned = Rotation.from_rotvec(0.01 * rng.standard_normal(3)) * Rotation.from_rotvec(vectors)
    orientation = (turned * REFERENCE).as_quat(scalar_first=True)
    return Demonstration(rng.uniform(1.8, 2.2) * s, position, orientation=orientation)


def one_hand(n=9, seed=0):
    rng = np.random.default_rng(seed)
    return [recording(rng, SPREAD * z, 0.5 * SPREAD * z) for z in rng.standard_normal(n)]


def two_hands(n=9, seed=1):
    """The right hand turns against the left one."""
    rng = np.random.default_rng(seed)
    return [
        {"left": left, "right": Demonstration(left.time, right.position, orientation=right.orientation)}
        for z in rng.standard_normal(n)
        for left, right in [(recording(rng, SPREAD * z), recording(rng, -SPREAD * z))]
    ]


@lru_cache(maxsize=8)
def fitted(hands, n, n_basis):
    """A distribution of n recordings, fitted once."""
    return PoseProMP.fit({1: one_hand, 2: two_hands}[hands](n), n_basis=n_basis)


def angle(a, b):
    return (a * b.inv()).magnitude()


def test_the_mean_is_the_mean_of_the_recordings():
    """Of rotations by the least sum of squared angles, which scipy finds in another way."""
    demos = one_hand()
    promp = PoseProMP.fit(demos, n_basis=15)
    (path,) = promp.mean_at(promp.duration * np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
    for k, share in enumerate((0.0, 0.25, 0.5, 0.75, 1.0)):
        nearest = [demo.resampled(401) for demo in demos]
        turns = Rotation.concatenate([demo.rotation[int(400 * share)] for demo in nearest])
        places = np.mean([demo.position[int(400 * share)] for demo in nearest], axis=0)
        assert angle(path.rotation[k], turns.mean()) < 5e-3
        assert np.abs(path.position[k] - places).max() < 5e-3


def test_moving_and_turning_hang_together():
    """Who bends to the left turns to the left: the correlation in the middle of the way is that of the recordings."""
    promp = PoseProMP.fit(one_hand(20), n_basis=12)
    covariance = promp.covariance_at([0.5 * promp.duration])[0]
    correlation = covariance[1, 4] / np.sqrt(covariance[1, 1] * covariance[4, 4])
    assert correlation > 0.95
    assert np.sqrt(covariance[4, 4]) == pytest.approx(SPREAD, rel=0.5)
    pose = promp.movements[0].at([0.5 * promp.duration])
    turned = Pose(pose.position[0] + [0, 0.1, 0], pose.orientation[0])
    given_place = promp.condition(
        0.5 * promp.duration, turned, position_covariance=1e-6, rotation_covariance=100.0
    )
    (path,) = given_place.mean_at([0.5 * promp.duration])
    turn = (path.rotation[0] * pose.rotation[0].inv()).as_rotvec()
    assert turn[1] == pytest.approx(0.2, rel=0.3)  # 0.1 m aside, and twice as many radians


@examples(5)
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 0.8))
def test_a_pose_is_passed_exactly_and_its_uncertainty_is_that_of_the_world(seed, share):
    rng = np.random.default_rng(seed)
    promp = fitted(1, 9, 10)
    time = share * promp.duration
    (mean,) = promp.mean_at([time])
    wanted = Pose.of(
        mean.position[0] + 0.01, Rotation.from_rotvec(rng.uniform(-0.02, 0.02, 3)) * mean.rotation[0]
    )
    (path,) = promp.condition(time, wanted, position_covariance=1e-10, rotation_covariance=1e-10).mean_at(
        [time]
    )
    assert np.abs(path.position[0] - wanted.position).max() < 1e-3
    assert angle(path.rotation[0], wanted.rotation) < 1e-3
    # A loose prior and a tight observation: what is left is the observation's, as an angle about the world's axes.
    known = np.diag([4e-8, 1e-8, 2.5e-7])
    told = promp.condition(time, wanted, position_covariance=1e-10, rotation_covariance=known)
    left = told.covariance_at([time])[0][3:, 3:]
    (path,) = told.mean_at([time])
    vector = (path.rotation[0] * Rotation.from_quat(told.references[0], scalar_first=True).inv()).as_rotvec()
    nudged = [
        (Rotation.from_rotvec(vector + 1e-6 * unit) * Rotation.from_rotvec(vector).inv()).as_rotvec() / 1e-6
        for unit in np.eye(3)
    ]
    jacobian = np.array(nudged).T  # of the world's angle by the rotation vector
    assert (np.linalg.eigvalsh(known - jacobian @ left @ jacobian.T) > -1e-9).all()


@examples(5)
@given(st.integers(0, 2**32 - 1))
def test_samples_meet_given_poses(seed):
    promp = fitted(2, 16, 8)
    rng = np.random.default_rng(seed)
    start = {name: Pose.of(rng.uniform(-0.02, 0.02, 3), Rotation.from_rotvec(rng.uniform(-0.02, 0.02, 3)) * REFERENCE)
             for name in ("left", "right")}  # fmt: skip
    bound = promp.towards(start=start, duration=3.0)
    for movement, name in zip(bound.sample(rng), ("left", "right"), strict=True):
        path = movement.at([0.0])
        assert movement.duration == 3.0
        assert np.abs(path.position[0] - start[name].position).max() < 1e-9
        assert angle(path.rotation[0], start[name].rotation) < 1e-9


def test_hands_follow_each_other():
    """A pose of the left hand moves the right one as the recordings did: against it."""
    promp = fitted(2, 16, 8)
    time = 0.5 * promp.duration
    left, right = promp.mean_at([time])
    turned = Pose.of(left.position[0], Rotation.from_rotvec([0, 0.2, 0]) * left.rotation[0])
    told = promp.condition(
        time, turned, position_covariance=1.0, rotation_covariance=1e-6, manipulator="left"
    )
    _, after = told.mean_at([time])
    assert (after.rotation[0] * right.rotation[0].inv()).as_rotvec()[1] == pytest.approx(-0.2, rel=0.25)
    assert promp.manipulators == ("left", "right") and promp.positions.manipulators == ("left", "right")


def test_signs_of_quaternions_and_the_frame_of_the_world_do_not_matter():
    demos, rng = one_hand(5), np.random.default_rng(3)
    turn = Rotation.random(random_state=4)
    other = [
        SimpleNamespace(
            time=demo.time,
            position=turn.apply(demo.position.copy()),
            orientation=(turn * demo.rotation).as_quat(scalar_first=True)
            * rng.choice([-1, 1], (demo.n_steps, 1)),
        )
        for demo in demos
    ]
    one, two = PoseProMP.fit(demos, n_basis=8), PoseProMP.fit(other, n_basis=8)
    time = np.linspace(0, one.duration, 7)
    (a,), (b,) = one.mean_at(time), two.mean_at(time)
    assert np.abs(turn.apply(a.position.copy()) - b.position).max() < 1e-6
    assert angle(turn * a.rotation, b.rotation).max() < 1e-6
    assert one.log_likelihood(demos[0]) == pytest.approx(two.log_likelihood(other[0]), rel=0.05)


def test_the_positions_are_those_of_a_distribution_of_positions():
    demos = one_hand(12)
    whole, alone = PoseProMP.fit(demos, n_basis=9).positions, ProMP.fit(demos, n_basis=9)
    time = np.linspace(0, alone.duration, 9)
    assert np.abs(whole.mean_at(time) - alone.mean_at(time)).max() < 1e-9
    assert np.allclose(
        np.diagonal(whole.covariance, 0), np.diagonal(alone.covariance, 0), rtol=0.5, atol=1e-6
    )


def test_likelier_are_recordings_of_the_same_movement():
    demos = one_hand(10)
    promp = PoseProMP.fit(demos[:9], n_basis=10)
    turned = Demonstration(
        demos[9].time, demos[9].position,
        orientation=(Rotation.from_rotvec([0.6, 0, 0]) * demos[9].rotation).as_quat(scalar_first=True),
    )  # fmt: skip
    assert promp.log_likelihood(demos[9]) > promp.log_likelihood(turned) + 100


def test_it_is_stored_bit_for_bit():
    for demos in (one_hand(4), two_hands(4)):
        primitive = learn_distribution(demos, name="turns", sources=["a", "b"], n_basis=6, poses=True)
        read = loads(dumps(primitive))
        assert read.kind == "poses" and read.notes == primitive.notes
        assert np.array_equal(read.dmp.promp.covariance, primitive.dmp.promp.covariance)
        assert all(map(np.array_equal, read.dmp.references, primitive.dmp.references))
        assert dumps(read) == dumps(primitive)
        assert isinstance(read.followed, ProMP) and read.positions.n_dims == 3 * len(read.dmp.references)


def test_what_cannot_be_is_said():
    demos, flat = one_hand(3), [Demonstration.from_lasa("Sine", k) for k in range(3)]
    with pytest.raises(DemonstrationError, match="recording 0 holds no orientations"):
        PoseProMP.fit(flat)
    planar = [Demonstration(d.time, d.position[:, :2], orientation=d.orientation) for d in demos]
    with pytest.raises(DemonstrationError, match="none in space"):
        PoseProMP.fit(planar)
    s = np.linspace(0, 1, 60)
    far = Rotation.from_rotvec(np.outer(7.0 * s, [0, 0, 1.0])).as_quat(scalar_first=True)
    whole = [Demonstration(s, demo.position[:60] + 0.1 * k, orientation=far) for k, demo in enumerate(demos)]
    with pytest.raises(DemonstrationError, match="away from the mean orientation"):
        PoseProMP.fit(whole)
    with pytest.raises(DemonstrationError, match="recording 1 is of left"):
        PoseProMP.fit([{"left": demos[0], "right": demos[0]}, {"left": demos[1]}])
    with pytest.raises(OptionError, match="recording 0 is str"):
        PoseProMP.fit(["take.csv", "again.csv"])
    promp = PoseProMP.fit(two_hands(3), n_basis=5)
    pose = promp.movements[0].start
    with pytest.raises(OptionError, match="whose pose"):
        promp.condition(0.5, pose)
    with pytest.raises(OptionError, match="did you mean 'left'"):
        promp.condition(0.5, pose, manipulator="lefft")
    with pytest.raises(OptionError, match="each of left, right"):
        promp.towards(start=pose)
    with pytest.raises(OptionError, match="pose ="):
        promp.condition(0.5, [0, 0, 0], manipulator="left")
    with pytest.raises(OptionError, match="rotation_covariance"):
        promp.condition(0.5, pose, rotation_covariance=-1.0, manipulator="left")
