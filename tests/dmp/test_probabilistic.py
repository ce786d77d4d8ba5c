"""Distributions of movements: conditioning by the textbook, exact ends, likelihoods, hands that vary together."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from comove.dmp import (
    DMP,
    Library,
    LinearPhase,
    ProMP,
    ViaPoint,
    coactivated,
    learn_distribution,
    read_primitive,
    write_primitive,
)
from comove.dmp.alignment import Alignment, aligned
from comove.dmp.demonstrations import Demonstration
from comove.dmp.estimation import EstimationSettings, regression, widening
from comove.errors import ComoveWarning, DemonstrationError, LibraryError, OptionError
from tests.cases import examples

DEMOS = [Demonstration.from_lasa("Sine", k) for k in range(7)]
PROMP = ProMP.fit(DEMOS)


def hands(n: int = 12, seed: int = 0, together: float = 0.9) -> list[dict[str, Demonstration]]:
    """Return recordings of two hands, whose bumps in the middle are correlated."""
    rng, s = np.random.default_rng(seed), np.linspace(0, 1, 121)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    bump = np.sin(np.pi * s) ** 2
    recordings = []
    for _ in range(n):
        left = rng.standard_normal()
        right = together * left + np.sqrt(1 - together**2) * rng.standard_normal()
        recordings.append(
            {
                name: Demonstration(2 * s, np.stack([way, y + 0.1 * height * bump], axis=1))
                for name, y, height in (("left", 0.0, left), ("right", 0.5, right))
            }
        )
    return recordings


TWO = ProMP.fit(hands(), n_basis=10)


def textbook(promp: ProMP, rows: np.ndarray, target: np.ndarray, noise: np.ndarray):
    """Return mean and covariance of the parameters, given rows, in the information form."""
    prior = promp.covariance + 1e-9 * np.trace(promp.covariance) / len(promp.covariance) * np.eye(
        len(promp.covariance)
    )
    information = np.linalg.inv(prior) + rows.T @ np.linalg.solve(noise, rows)
    covariance = np.linalg.inv(information)
    mean = promp.mean_parameters.ravel()
    return covariance @ (np.linalg.solve(prior, mean) + rows.T @ np.linalg.solve(noise, target)), covariance


def rows_at(promp: ProMP, time: float, order: int) -> np.ndarray:
    """Return the derivative of a position or a velocity by the parameters, through DMP itself."""
    n_columns, n = promp.mean_parameters.shape
    rows = np.zeros((n_columns, n_columns * n))
    for i in range(n_columns * n):
        unit = np.eye(n_columns * n)[i].reshape(n_columns, n)
        ends = unit[:, :4].T * np.array([[1], [1 / promp.duration], [1], [1 / promp.duration]])
        played = DMP(unit[:, 4:], ends[0], ends[2], ends[1], ends[3], promp.duration, promp.phase).at([time])
        rows[:, i] = (played.position, played.velocity)[order][0]
    return rows


@pytest.mark.parametrize("with_velocity", [False, True])
def test_conditioning_is_that_of_the_textbook(with_velocity):
    time, off = 0.4 * TWO.duration, np.array([0.02, 0.05, -0.03, 0.04])
    position = TWO.mean_at([time])[0] + off
    velocity = np.array([0.5, 0.1, 0.4, -0.1]) if with_velocity else None
    rows, target, noise = rows_at(TWO, time, 0), position, 1e-3 * np.eye(4)
    if velocity is not None:
        rows = np.concatenate([rows, rows_at(TWO, time, 1)])
        target, noise = np.concatenate([position, velocity]), np.diag([1e-3] * 4 + [1e-2] * 4)
    mean, covariance = textbook(TWO, rows, target, noise)
    found = TWO.condition(
        ViaPoint(time, position, velocity), position_covariance=1e-3, velocity_covariance=1e-2
    )
    s = np.linspace(0, TWO.duration, 21)
    by_the_book = np.stack([rows_at(TWO, t, 0) for t in s])
    assert np.abs(found.mean_at(s) - by_the_book @ mean).max() < 1e-5
    expected = by_the_book @ covariance @ np.swapaxes(by_the_book, 1, 2)
    assert np.abs(found.covariance_at(s) - expected).max() < 1e-6


@examples(25)
@given(st.floats(0.05, 0.95), st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=2), st.integers(0, 99))
def test_all_that_is_drawn_passes_an_exact_via_point(share, off, seed):
    time = share * PROMP.duration
    there = PROMP.mean_at([time])[0] + PROMP.std_at([time])[0] * np.array(off)
    passing = PROMP.condition(ViaPoint(time, there))
    drawn = passing.sample(np.random.default_rng(seed))
    assert np.abs(drawn.at([time]).position[0] - there).max() < 1e-5
    assert np.abs(passing.mean_at([time])[0] - there).max() < 1e-9
    values = np.linalg.eigvalsh(passing.covariance)
    assert values.min() > -1e-9 * values.max()
    assert (passing.std_at([0.3, 0.5]) <= PROMP.std_at([0.3, 0.5]) * (1 + 1e-9)).all()


@examples(25)
@given(st.integers(0, 999), st.floats(-3, 3), st.floats(-3, 3))
def test_samples_between_given_ends_meet_them_to_the_last_bit(seed, x, y):
    start, goal = TWO.mean.start + 1e-3 * x, TWO.mean.goal + 1e-3 * y
    wide = ProMP(
        TWO.mean_parameters, TWO.covariance + 1e-6 * np.eye(len(TWO.covariance)), TWO.noise, TWO.duration
    )
    drawn = wide.towards(start=start, goal=goal, goal_velocity=np.zeros(4)).sample(
        np.random.default_rng(seed)
    )
    assert np.array_equal(drawn.start, start) and np.array_equal(drawn.goal, goal)
    assert not drawn.goal_velocity.any()
    played = drawn.rollout()
    assert np.abs(played.position[[0, -1]] - np.stack([start, goal])).max() < 1e-9


def test_ends_that_never_vary_stay_and_others_are_refused():
    drawn = PROMP.sample(np.random.default_rng(3))
    assert np.abs(drawn.goal).max() < 1e-9  # all LASA recordings end at the origin
    with pytest.raises(OptionError, match="do not vary"):
        PROMP.towards(goal=[10.0, 0.0])


def test_mean_and_spread_are_those_of_the_recordings():
    s = np.linspace(0, 1, 51)
    curves = np.stack([demo.resampled(51).position for demo in DEMOS])
    extent = np.ptp(curves)
    assert np.abs(PROMP.mean_at(s * PROMP.duration) - curves.mean(axis=0)).max() < 0.01 * extent
    spread = curves.std(axis=0, ddof=1) * np.sqrt(widening(7))
    assert np.abs(PROMP.std_at(s * PROMP.duration) - spread)[5:-5].max() < 0.02 * extent
    assert pytest.approx(np.mean([demo.duration for demo in DEMOS])) == PROMP.duration


def test_samples_have_the_mean_and_the_covariance():
    drawn = TWO.sample_trajectories(np.random.default_rng(0), 20_000, 5)
    time = np.linspace(0, TWO.duration, 5)
    spread = TWO.std_at(time).max()
    assert np.abs(drawn.mean(axis=0) - TWO.mean_at(time)).max() < 5 * spread / np.sqrt(20_000)
    covariance = np.cov(drawn[:, 2].T)
    assert np.abs(covariance - TWO.covariance_at(time)[2]).max() < 0.05 * spread**2


def test_the_likelihood_is_that_of_the_samples_together():
    few = DEMOS[3].resampled(15)
    s = few.time / few.duration
    psi = np.stack([rows_at(PROMP, t * PROMP.duration, 0) for t in s]).reshape(-1, PROMP.covariance.shape[0])
    total = psi @ PROMP.covariance @ psi.T + np.diag(np.tile(PROMP.noise**2, 15))
    expected = multivariate_normal.logpdf(few.position.ravel(), psi @ PROMP.mean_parameters.ravel(), total)
    assert PROMP.log_likelihood(few) == pytest.approx(expected, rel=1e-6)
    assert PROMP.log_likelihood(DEMOS[0]) > PROMP.log_likelihood(Demonstration.from_lasa("Angle", 0))


def test_one_hand_follows_the_other_by_their_correlation():
    middle = 0.5 * TWO.duration
    means = TWO.mean_at([middle])[0]
    covariance = TWO.covariance_at([middle])[0]
    told = TWO.condition(
        ViaPoint(middle, means[:2] + [0.0, 0.1]), position_covariance=1e-4, manipulator="left"
    )
    gain = covariance[2:, :2] @ np.linalg.inv(covariance[:2, :2] + 1e-4 * np.eye(2))
    assert told.mean_at([middle])[0, 2:] == pytest.approx(means[2:] + gain @ [0.0, 0.1], abs=1e-6)
    assert told.mean_at([middle])[0, 3] - means[3] > 0.05
    apart = ProMP.fit(hands(40, together=0.0), n_basis=10)
    correlation = apart.covariance_at([middle])[0]
    assert abs(correlation[1, 3]) < 0.4 * np.sqrt(correlation[1, 1] * correlation[3, 3])


def test_far_via_points_are_told_with_their_distance():
    middle = 0.5 * PROMP.duration
    far = PROMP.mean_at([middle])[0] + 100.0
    with pytest.warns(ComoveWarning, match=r"is \d+.* standard deviations from what was taught"):
        bent = PROMP.condition(ViaPoint(middle, far))
    assert np.abs(bent.mean_at([middle])[0] - far).max() < 1e-6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        PROMP.condition(ViaPoint(middle, PROMP.mean_at([middle])[0] + PROMP.std_at([middle])[0]))


def test_the_mean_is_linear_in_the_context():
    s, rng = np.linspace(0, 1, 101), np.random.default_rng(1)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    heights = rng.uniform(0.1, 0.5, 12)
    demos = [
        Demonstration(
            s,
            np.stack([way, h * np.sin(np.pi * s) ** 2], axis=1)
            + 1e-3 * rng.standard_normal(2) * way[:, None],
        )
        for h in heights
    ]
    promp = ProMP.fit(demos, contexts=heights)
    for h in (0.15, 0.4):
        assert promp.at_context([h]).mean_at([0.5])[0, 1] == pytest.approx(h, abs=5e-3)
    with pytest.warns(ComoveWarning, match="standard deviations"):
        promp.at_context([5.0])
    with pytest.raises(OptionError, match="the same in all"):
        ProMP.fit(demos, contexts=np.ones(12))
    mean, slopes, _ = regression(np.outer(heights, [1.0, 2.0]) + 3.0, heights[:, None] - heights.mean())
    assert slopes == pytest.approx(np.array([[1.0, 2.0]]))
    assert mean == pytest.approx(3.0 + heights.mean() * np.array([1.0, 2.0]))


def test_two_recordings_suffice_and_that_is_said():
    with pytest.warns(ComoveWarning, match="2 recordings"):
        promp = ProMP.fit(DEMOS[:2])
    assert any("too few" in note for note in promp.notes)
    middle = 0.5 * promp.duration
    there = promp.mean_at([middle])[0] + promp.std_at([middle])[0] * [1.0, -1.0]
    assert np.abs(promp.condition(ViaPoint(middle, there)).mean_at([middle])[0] - there).max() < 1e-6


def test_more_weights_than_samples_are_told():
    few = [demo.resampled(10) for demo in DEMOS]
    with pytest.warns(ComoveWarning, match="10 samples for 24 weights"):
        promp = ProMP.fit(few)
    played = promp.mean_at(np.linspace(0.0, promp.duration, 10))
    samples = np.mean([demo.position for demo in few], axis=0)
    assert np.abs(played - samples).max() < 0.01 * np.ptp(samples)


def test_warping_brings_equal_places_to_equal_shares():
    s = np.linspace(0, 1, 201)
    paces = [s, s**1.4, s**0.75]
    curves = [np.stack([pace, np.sin(2 * np.pi * pace)], axis=1) for pace in paces]
    shares = aligned([s] * 3, curves, Alignment.WARPING)
    places = np.stack([np.interp(s, share, curve[:, 0]) for share, curve in zip(shares, curves, strict=True)])
    assert places.std(axis=0).max() < 0.25 * np.stack(paces).std(axis=0).max()
    for share in shares:
        assert share[0] == 0.0 and share[-1] == 1.0 and (np.diff(share) >= 0).all()


def test_files_hold_every_bit(tmp_path):
    contexts = np.arange(7.0)
    for promp in (PROMP, TWO, ProMP.fit(DEMOS, contexts=contexts, phase=LinearPhase())):
        primitive = learn_distribution(DEMOS, name="x")
        primitive = type(primitive)("x", promp, "m", notes=("by hand",))
        write_primitive(tmp_path / "x.json", primitive)
        read = read_primitive(tmp_path / "x.json").dmp
        for name in ("mean_parameters", "covariance", "noise", "slopes", "context_mean"):
            assert np.array_equal(getattr(read, name), getattr(promp, name))
        assert (read.manipulators, read.phase, read.duration) == (
            promp.manipulators,
            promp.phase,
            promp.duration,
        )
    library = Library(tmp_path / "library")
    library.add(learn_distribution(DEMOS, name="sine", sources=["a.csv"]))
    assert library["sine"].kind == "distribution" and library.find(shape=DEMOS[0])[0].shape < 0.3
    text = (tmp_path / "x.json").read_text().replace('"duration_std": ', '"duration_std": 1')
    (tmp_path / "y.json").write_text(text)
    with pytest.raises(LibraryError, match="changed"):
        read_primitive(tmp_path / "y.json")


def test_distributions_that_act_at_once_are_the_product_of_their_gaussians():
    other = ProMP.fit([Demonstration.from_lasa("Sine", k) for k in (0, 2, 4, 5)])
    time = np.linspace(0.2, 0.8, 7)
    both = coactivated([PROMP, other], [1.0, 0.5])
    one, two = (p.covariance_at(time * p.duration) for p in (PROMP, other))
    means = [p.mean_at(time * p.duration)[..., None] for p in (PROMP, other)]
    expected = np.linalg.inv(np.linalg.inv(one) + 0.5 * np.linalg.inv(two))
    found = both.covariance_at(time * both.duration)
    assert np.abs(found - expected).max() < 0.05 * np.abs(expected).max()
    mean = expected @ (np.linalg.solve(one, means[0]) + 0.5 * np.linalg.solve(two, means[1]))
    assert np.abs(both.mean_at(time * both.duration) - mean[..., 0]).max() < 0.02 * np.ptp(means[0])
    passing = coactivated([PROMP, other], [np.linspace(1, 0, 51), np.linspace(0, 1, 51)])
    assert np.abs(passing.mean_at([0.0])[0] - PROMP.mean_at([0.0])[0]).max() < 1e-6
    for wrong in ([0.0, 0.0], [2.0, 0.0], [1.0]):
        with pytest.raises(OptionError, match="activ"):
            coactivated([PROMP, other], wrong)


class Broken:
    """A recording with a number missing."""

    time = np.linspace(0, 1, 5)
    position = np.array([[0, 0], [1, 1], [np.nan, 2], [3, 3], [4, 4.0]])
    start_velocity = np.zeros(2)


def test_what_does_not_belong_together_is_told():
    spatial = Demonstration(DEMOS[0].time, np.c_[DEMOS[0].position, DEMOS[0].time], unit="LASA unit")
    metres = Demonstration(DEMOS[0].time, 0.01 * DEMOS[0].position)
    cases = [
        (DEMOS[:1], "two or more"),
        ([DEMOS[0], spatial], "recording 1 has 3 coordinates, recording 0 has 2"),
        ([DEMOS[0], metres], "recording 1 is in m, recording 0 is in LASA unit"),
        ([DEMOS[0], DEMOS[1], DEMOS[0]], "recordings 0 and 2 are one and the same"),
        (DEMOS[:1] * 2, "one and the same"),
        ([metres, Broken()], "recording 1 holds what is no number in row 2"),
        ([hands(1)[0], metres], "one hand"),
    ]
    for demos, message in cases:
        with pytest.raises(DemonstrationError, match=message):
            ProMP.fit(demos)
    slow = Demonstration(2 * metres.time, metres.position)
    with pytest.raises(DemonstrationError, match="same movement and have no spread"):
        ProMP.fit([metres, slow])
    for wrong in (None, iter(DEMOS), [DMP.fit(DEMOS[0])] * 2):
        with pytest.raises(OptionError, match="demonstrations"):
            ProMP.fit(wrong)
    with pytest.raises(OptionError, match="alignment"):
        ProMP.fit(DEMOS, alignment="warp")
    with pytest.raises(OptionError, match="no manipulator 'lefd'"):
        TWO.condition(ViaPoint(0.5, [0, 0]), manipulator="lefd")
    with pytest.raises(OptionError, match="a time from 0"):
        PROMP.condition(ViaPoint(99.0, [0, 0]))


def test_the_length_of_the_taper_is_chosen_among_those_that_are_given():
    takes = [Demonstration.from_lasa("Sine", k) for k in range(5)]
    given = EstimationSettings(lengths=(0.9,), n_choosing=5)
    assert "tapered over 0.9 of" in ProMP.fit(takes, n_basis=5, settings=given).notes[1]
    with pytest.warns(ComoveWarning, match=r"tapered over 0\.3 of"):
        ProMP.fit(takes, n_basis=5, settings=EstimationSettings(n_choosing=6))
