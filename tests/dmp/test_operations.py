"""Operations on movements are what they say: exact, and they commute with rollouts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp import DMP, ExponentialPhase, LinearPhase, Variant
from comove.dmp import operations as op
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.dmp.poses import PoseDMP
from comove.errors import OptionError
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)
variants = st.sampled_from(list(Variant))
ending = st.sampled_from([v for v in Variant if v is not Variant.RHYTHMIC])
phases = st.sampled_from([LinearPhase(), ExponentialPhase()])
dims = st.sampled_from([2, 3])


def random_dmp(seed, variant=Variant.CLOSED_FORM, n_dims=2, n_basis=9, phase=ExponentialPhase(), still=True):  # noqa: B008
    """A movement whose goal is not the one that was learned."""
    rng = np.random.default_rng(seed)
    start, goal, pace, learned = rng.uniform(-1, 1, (4, n_dims))
    end = np.zeros(n_dims) if still else rng.uniform(-1, 1, n_dims)
    return DMP(
        weights=rng.standard_normal((n_dims, n_basis)),
        start=start,
        goal=goal,
        start_velocity=pace,
        goal_velocity=end,
        duration=rng.uniform(0.5, 5),
        phase=phase,
        variant=variant,
        learned=goal - start if variant is Variant.RHYTHMIC else learned,
    )


def path(dmp, n_steps=41):
    return dmp.rollout(n_steps=n_steps)


def same(a, b, tolerance=1e-9):
    size = max(1.0, np.abs(b.position).max())
    assert np.abs(a.time - b.time).max() <= 1e-12
    assert np.abs(a.position - b.position).max() <= tolerance * size
    assert np.abs(a.velocity - b.velocity).max() <= 50 * tolerance * size


def turned(seed, n_dims):
    rng = np.random.default_rng(seed)
    return rng.uniform(-4, 4) if n_dims == 2 else Rotation.random(rng=rng)


def matrix(rotation):
    if isinstance(rotation, Rotation):
        return rotation.as_matrix()
    return np.array([[np.cos(rotation), -np.sin(rotation)], [np.sin(rotation), np.cos(rotation)]])


# --- Maps of the plane and of space ---


@examples(60)
@given(seeds, variants, dims, phases)
def test_a_map_of_the_movement_maps_its_rollout(seed, variant, n_dims, phase):
    dmp, rotation = random_dmp(seed, variant, n_dims, phase=phase), turned(seed, n_dims)
    about = np.random.default_rng(seed).uniform(-2, 2, n_dims)
    before = path(dmp)
    turn = matrix(rotation)
    for moved, m in (
        (op.rotate(dmp, rotation, about=about), turn),
        (op.scale(dmp, 2.5, about=about), 2.5 * np.eye(n_dims)),
        (op.mirror(dmp, turn[0], about=about), np.eye(n_dims) - 2 * np.outer(turn[0], turn[0])),
    ):
        after = path(moved)
        size = np.abs(before.position).max()
        assert np.abs(after.position - (about + (before.position - about) @ m.T)).max() <= 1e-9 * size
        assert np.abs(after.velocity - before.velocity @ m.T).max() <= 1e-7 * size
        assert moved.duration == dmp.duration


@examples(40)
@given(seeds, variants, dims)
def test_mapped_movements_go_to_mapped_goals_as_the_movement_does(seed, variant, n_dims):
    if variant is Variant.CLASSIC:
        return  # it scales along axes, which are turned
    dmp, rotation = random_dmp(seed, variant, n_dims), turned(seed, n_dims)
    goal = np.random.default_rng(seed + 1).uniform(-1, 1, n_dims)
    turn, fixed = matrix(rotation), dmp.goal if variant is Variant.RHYTHMIC else dmp.start
    there = dmp.rollout(goal=goal, n_steps=21).position
    moved = op.rotate(dmp, rotation).rollout(goal=fixed + turn @ (goal - fixed), n_steps=21).position
    assert np.abs(moved - (fixed + (there - fixed) @ turn.T)).max() <= 1e-8 * max(1.0, np.abs(there).max())


@examples(30)
@given(seeds, variants, dims)
def test_mirrored_twice_is_the_movement(seed, variant, n_dims):
    dmp = random_dmp(seed, variant, n_dims)
    for normal in ("x", n_dims - 1, np.arange(1.0, n_dims + 1)):
        same(path(op.mirror(op.mirror(dmp, normal), normal)), path(dmp))


@examples(30)
@given(seeds, variants, dims)
def test_rotations_and_scales_compose(seed, variant, n_dims):
    dmp, first, second = random_dmp(seed, variant, n_dims), turned(seed, n_dims), turned(seed + 1, n_dims)
    both = first + second if n_dims == 2 else second * first
    same(path(op.rotate(op.rotate(dmp, first), second)), path(op.rotate(dmp, both)))
    same(path(op.scale(op.scale(dmp, 2.0), 0.75)), path(op.scale(dmp, 1.5)))


def test_a_mirror_along_an_axis_changes_one_sign():
    dmp = random_dmp(1, Variant.CLASSIC)
    mirrored = op.mirror(dmp, "y", about=[0.0, 0.0])
    assert mirrored.variant is Variant.CLASSIC  # it generalises as it did
    assert np.array_equal(path(mirrored).position, path(dmp).position * [1, -1])
    assert op.rotate(dmp, 0.3).variant is Variant.CLOSED_FORM


def test_half_a_turn_of_what_was_learned_is_turned_as_it_stands():
    start, goal = np.zeros(3), np.array([1.0, 0, 0])
    dmp = DMP(
        np.random.default_rng(0).standard_normal((3, 9)), start, goal, start, start, 1.0, variant="dmp++"
    )
    back, turn = dmp.towards(goal=-goal), Rotation.from_rotvec([0.3, 0.5, -0.2])
    assert np.allclose(
        path(op.rotate(back, turn)).position, path(back).position @ turn.as_matrix().T, atol=1e-12
    )


@examples(20)
@given(seeds, variants, st.floats(0.1, 10))
def test_retimed_movements_keep_their_path(seed, variant, duration):
    dmp = random_dmp(seed, variant, still=False)
    before, after = path(dmp), path(op.retime(dmp, duration))
    assert np.abs(after.position - before.position).max() <= 1e-12 * np.abs(before.position).max()
    assert np.allclose(after.velocity * duration, before.velocity * dmp.duration, rtol=1e-9, atol=1e-9)


def test_a_planar_movement_is_laid_into_space():
    for variant in Variant:
        dmp = random_dmp(4, variant)
        for plane, columns in op.PLANES.items():
            laid = path(op.in_space(dmp, plane)).position
            assert np.allclose(laid[:, list(columns)], path(dmp).position, atol=1e-12)
            assert not np.delete(laid, columns, axis=1).any()


# --- Between movements ---


@examples(40)
@given(seeds, variants, dims, st.floats(0, 1))
def test_a_blend_is_between_at_equal_shares_of_the_durations(seed, variant, n_dims, share):
    a = random_dmp(seed, variant, n_dims, still=False)
    b = random_dmp(seed + 1, variant, n_dims, still=False)
    mixed = op.blend(a, b, share)
    between = (1 - share) * path(a).position + share * path(b).position
    assert np.abs(path(mixed).position - between).max() <= 1e-9 * max(1.0, np.abs(between).max())
    assert mixed.duration == pytest.approx((1 - share) * a.duration + share * b.duration)


@given(seeds, variants)
def test_blends_by_nothing_and_all_are_the_movements(seed, variant):
    a, b = random_dmp(seed, variant), random_dmp(seed + 1, variant)
    same(path(op.blend(a, b, 0)), path(a))
    same(path(op.blend(a, b, 1)), path(b))
    if variant is Variant.CLOSED_FORM:
        assert np.array_equal(path(op.blend(a, b, 0)).position, path(a).position)
        assert np.array_equal(path(op.blend(a, b, 1)).position, path(b).position)


def test_movements_in_different_bases_are_refitted_to_blend():
    recording = Demonstration.from_lasa("Sine")
    a = DMP.fit(recording, n_basis=15)
    b = DMP.fit(recording, n_basis=30, variant="pastor", phase=LinearPhase())
    mixed = op.blend(a, b, 0.5)
    assert mixed.weights.shape == (2, 30)
    assert (mixed.variant, mixed.phase) == (a.variant, a.phase)
    between = 0.5 * (path(a, 401).position + path(b, 401).position)
    assert np.abs(path(mixed, 401).position - between).max() < 0.2  # of 60 units


# --- Backwards ---


@examples(30)
@given(seeds, ending, phases)
def test_reversed_ends_are_exact(seed, variant, phase):
    dmp = random_dmp(seed, variant, phase=phase, still=False)
    there, back = path(dmp), path(op.reverse(dmp))
    size = 1e-10 * max(1.0, np.abs(there.position).max())
    assert np.abs(back.position[[0, -1]] - there.position[[-1, 0]]).max() <= size
    assert np.abs(back.velocity[[0, -1]] + there.velocity[[-1, 0]]).max() <= 1e3 * size


@pytest.mark.parametrize("shape", lasa_names()[::6])
@pytest.mark.parametrize("variant", ["closed-form", "classic", "pastor", "dmp++"])
def test_reversed_handwriting_runs_backwards_and_twice_forwards(shape, variant):
    dmp = DMP.fit(Demonstration.from_lasa(shape), variant=variant)
    near = 2e-3 if variant == "dmp++" else 2e-4
    there, once = path(dmp, 801).position, op.reverse(dmp)
    extent = np.ptp(there, axis=0).max()
    assert np.abs(path(once, 801).position - there[::-1]).max() < near * extent
    assert np.abs(path(op.reverse(once), 801).position - there).max() < 2 * near * extent


# --- One after the other ---


@examples(40)
@given(seeds, ending, dims, st.booleans())
def test_a_sequence_is_continuous_in_position_and_velocity(seed, variant, n_dims, overlapping):
    parts = [random_dmp(seed + i, variant, n_dims, still=overlapping) for i in range(3)]
    overlap = 0.3 * min(part.duration for part in parts) if overlapping else 0.0
    whole = op.sequence(*parts, overlap=overlap)
    ends = [b + p.duration for b, p in zip(whole.begins, whole.parts, strict=True)]
    instants = np.array([*whole.begins[1:], *ends[:-1]])
    for tick in (1e-12, 1e-13):
        before, at, after = (whole.at(instants + by) for by in (-tick, 0.0, tick))
        for one, other in ((before, at), (at, after)):
            size = max(1.0, *(np.abs(part.shape_weights).max() for part in whole.parts))
            assert np.abs(one.position - other.position).max() <= 1e-9 * size
            assert np.abs(one.velocity - other.velocity).max() <= 1e-8 * (size + np.abs(one.velocity).max())
    assert np.array_equal(whole.at([0.0]).position[0], parts[0].start)
    assert np.allclose(whole.rollout().position[-1], whole.parts[-1].goal, atol=1e-9)
    assert whole.duration == pytest.approx(sum(p.duration for p in parts) - 2 * overlap)


@given(seeds)
def test_without_overlap_each_part_is_played_as_it_is(seed):
    a, b = random_dmp(seed), random_dmp(seed + 1)
    whole = op.sequence(a, b)
    time = np.linspace(0, b.duration, 21)
    assert np.allclose(whole.at(a.duration + time).position, whole.parts[1].at(time).position, atol=1e-9)
    assert np.allclose(whole.parts[1].goal - whole.parts[1].start, b.goal - b.start, atol=1e-12)
    assert np.array_equal(
        whole.at(time * a.duration / b.duration).position[:5],
        a.at(time * a.duration / b.duration).position[:5],
    )
    assert np.array_equal(whole.parts[0].goal, a.goal)


def test_a_sequence_passes_its_joint_at_the_speed_that_the_first_movement_ends_with():
    a = random_dmp(0).towards(goal_velocity=[0.5, -0.25])
    whole = op.sequence(a, random_dmp(1))
    assert np.allclose(whole.at([a.duration]).velocity[0], [0.5, -0.25], atol=1e-12)


def test_an_overlapping_sequence_does_not_stop():
    a, b = (DMP.fit(Demonstration.from_lasa(name)) for name in ("Sine", "Line"))
    stop, flow = op.sequence(a, b), op.sequence(a, b, overlap=0.5)
    assert np.linalg.norm(stop.at([stop.begins[1]]).velocity) < 1e-9
    time = np.linspace(flow.begins[1], a.duration, 101)
    assert np.linalg.norm(flow.at(time).velocity, axis=1).min() > 1.0


def test_a_sequence_becomes_one_primitive():
    a, b = (DMP.fit(Demonstration.from_lasa(name)) for name in ("Sine", "Angle"))
    whole = op.sequence(a, b, overlap=0.5)
    dmp = whole.fitted()
    s = np.linspace(0, whole.duration, 401)
    assert np.abs(dmp.at(s).position - whole.at(s).position).max() < 0.5  # of 100 units
    assert (
        np.abs(op.sequence(a, b, overlap=0.5).fitted(n_basis=100).at(s).position - whole.at(s).position).max()
        < 0.1
    )
    assert np.array_equal(dmp.start, whole.parts[0].start)
    assert np.array_equal(dmp.goal, whole.parts[-1].goal)


# --- What makes no sense is refused ---

POSE = PoseDMP(random_dmp(0, n_dims=3), random_dmp(0, n_dims=3), np.array([1.0, 0, 0, 0]))
A, SPATIAL, CYCLE = random_dmp(0), random_dmp(0, n_dims=3), random_dmp(0, Variant.RHYTHMIC)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: op.mirror(POSE, "x"), "PoseDMP is no DMP of positions"),
        (lambda: op.reverse(POSE), "PoseDMP is no DMP of positions"),
        (lambda: op.blend(A, POSE, 0.5), "PoseDMP is no DMP of positions"),
        (lambda: op.mirror(A, "z"), "normal = 'z'"),
        (lambda: op.mirror(A, "xy"), "normal = 'xy'"),
        (lambda: op.mirror(A, 2), "normal = 2"),
        (lambda: op.mirror(A, [0, 0]), "normal is zero"),
        (lambda: op.mirror(A, "x", about=[1.0]), "about"),
        (lambda: op.rotate(A, Rotation.identity()), "in 2 dimensions"),
        (lambda: op.rotate(SPATIAL, 0.3), "in 3 dimensions"),
        (lambda: op.rotate(A, np.nan), "rotation = nan"),
        (lambda: op.rotate(A, [[1, 0], [0, -1]]), "is no rotation"),
        (lambda: op.rotate(A, [[2, 0], [0, 2]]), "is no rotation"),
        (lambda: op.rotate(A, "left"), "rotation = 'left'"),
        (lambda: op.scale(A, 0), "factor = 0"),
        (lambda: op.scale(A, -1), "factor = -1"),
        (lambda: op.scale(A, True), "factor = True"),
        (lambda: op.retime(A, 0), "duration = 0"),
        (lambda: op.reverse(CYCLE), "never ends"),
        (lambda: op.sequence(A, CYCLE), "never ends"),
        (lambda: op.sequence(), "no movement"),
        (lambda: op.sequence(A, SPATIAL), "dimensions"),
        (lambda: op.sequence(A, A, overlap=99), "overlap = 99"),
        (lambda: op.sequence(A, A, overlap=np.nan), "overlap = nan"),
        (lambda: op.sequence(A.towards(goal_velocity=[1, 0]), A, overlap=0.1), "ends in motion"),
        (lambda: op.sequence(A, A).rollout(n_steps=1), "n_steps = 1"),
        (lambda: op.blend(A, SPATIAL, 0.5), "2 and 3 dimensions"),
        (lambda: op.blend(A, CYCLE, 0.5), "rhythmic"),
        (lambda: op.blend(A, A, np.nan), "share = nan"),
        (lambda: op.blend(A, op.retime(A, 9 * A.duration), -5), "makes a duration"),
        (lambda: op.refitted(A, variant="rhythmic"), "rhythmic"),
        (lambda: op.refitted(A, variant="clasic"), "did you mean 'classic'"),
        (lambda: op.in_space(A, "yx"), "plane = 'yx'"),
        (lambda: op.in_space(SPATIAL, "xy"), "3 dimensions"),
    ],
)
def test_refused(wrong, message):
    with pytest.raises(OptionError, match=message):
        wrong()


def test_nothing_is_changed_in_place():
    dmp, before = random_dmp(3), path(random_dmp(3)).position
    op.mirror(dmp, "x"), op.rotate(dmp, 1.0), op.scale(dmp, 2.0), op.blend(dmp, A, 0.5), op.reverse(dmp)
    op.sequence(dmp, A)
    assert np.array_equal(path(dmp).position, before)
