"""What moves the hands limits a search: it plans, says what is possible, and becomes careful when it was wrong."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from comove import Demonstration
from comove.lab.evolution import Paper
from comove.model import Scene
from comove.model.blocks import place
from comove.planning import Comove, PaperCost, solve
from comove.planning.convex.costs import differences
from comove.planning.kinematics import LimitedKinematics
from comove.planning.methods import UNPOLISHED
from comove.planning.planner import plan
from comove.planning.seeds import RIDGES, minimum_jerk, profiles

SCENE = Scene.from_dict(
    {
        "name": "around",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": [{"shape": "box", "center": [0.5, 0.3], "size": [0.1, 0.6]}],
        "load": {"shape": "bar", "length": 0.1},
        "manipulators": [
            {"name": "left", "start": [0.1, 0.55], "goal": [0.9, 0.55]},
            {"name": "right", "start": [0.1, 0.45], "goal": [0.9, 0.45]},
        ],
    }
)


@dataclass(frozen=True)
class Ceiling(LimitedKinematics):
    """Hands that cannot go above a height, less a margin that grows with caution."""

    height: float
    caution: int = 0
    asked: list = field(default_factory=list)

    def plan(self, space, start, goal, margin, rng, *, required, max_nodes):
        path = plan(space, start, goal, margin, rng, required=required, max_nodes=max_nodes)
        return None if path is None or path[:, 1].max() > self.height - 0.02 else path

    def ask(self, nodes):
        top = nodes[:, :, :2, 1].max(axis=(1, 2))
        self.asked.append(self.caution)
        wished = self.height - 0.005 * self.caution
        return 50.0 * np.maximum(0.0, top - wished), top <= wished

    def along(self, nodes):
        return Below(np.inf)  # it has no account of its own

    def stricter(self):
        return replace(self, caution=self.caution + 1)

    def reasons(self, motion):
        return [] if highest(motion) <= self.height else ["too high"]


@dataclass(frozen=True)
class Below:
    """The distance of both hands below a height."""

    height: float
    more: float = 1e-3

    def required(self, margin):
        return np.array([self.more + margin])

    def follow(self, nodes):
        return np.zeros((len(nodes), 0)), self.height - nodes[:, :2, 1].max(axis=1)[:, None]

    def slopes(self, blocks, q, postures, distances):
        slopes = np.zeros((*distances.shape, q.shape[1]))
        for c in range(q.shape[1]) if np.isfinite(self.height) else ():
            moved = q + 1e-6 * (np.arange(q.shape[1]) == c)
            nodes = place(blocks, np.ascontiguousarray(moved.T[None]), 1.0)[0]
            slopes[:, :, c] = (self.follow(nodes)[1] - distances) / 1e-6
        return slopes

    def stricter(self):
        return replace(self, more=self.more + 1e-3)


def jerk(found):
    hands = found.attempt.hands(np.linspace(0, 1, 101))[0].reshape(101, -1)
    return (differences(hands, 3) ** 2).sum()


def highest(motion):
    return motion.hands(np.linspace(0, 1, 2001))[0][:, :, 1].max()


def test_a_search_stays_where_its_carrier_can_go():
    free = solve(SCENE, seed=3, budget=3)
    assert free.verified
    for seed in range(4):
        carrier = Ceiling(0.72)
        found = solve(SCENE, seed=seed, budget=10, kinematics=carrier)
        assert found.verified and highest(found.attempt) <= 0.72


def test_smooth_motions_stay_where_their_carrier_can_go():
    """Nearer to the planned way than a free motion would be, and far smoother than the paper's objective asks."""
    free = solve(SCENE, seed=3, budget=3)
    low = highest(free.attempt) - 0.01
    carrier = Ceiling(low)
    found = solve(SCENE, budget=10, kinematics=carrier)
    paper = solve(SCENE, budget=10, kinematics=carrier, objective=PaperCost())
    assert found.verified and highest(found.attempt) <= low
    assert found.report.acceleration_max < 0.2 * paper.report.acceleration_max


def test_a_carrier_that_says_what_it_has_to_spare_is_followed_at_once_and_more_smoothly():
    """Not by drawing hands to their planned positions until they happen to be low enough."""

    @dataclass(frozen=True)
    class Told(Ceiling):
        judged: list = field(default_factory=list)

        def along(self, nodes):
            return Below(self.height)

        def reasons(self, motion):
            self.judged.append(highest(motion) <= self.height)
            return super().reasons(motion)

    low = highest(solve(SCENE, seed=3, budget=3).attempt) - 0.01
    told, drawn = Told(low), solve(SCENE, budget=10, kinematics=Ceiling(low))
    found = solve(SCENE, budget=10, kinematics=told)
    assert found.verified and all(told.judged)
    assert found.followed is None and jerk(found) < jerk(drawn)


def test_what_a_carrier_cannot_spare_does_not_end_a_search():
    """It may be too careful: then only its check decides."""

    class Timid(Ceiling):
        def along(self, nodes):
            return Below(self.height - 0.2)

    assert solve(SCENE, budget=10, kinematics=Timid(0.72)).verified


def test_motions_are_drawn_to_the_demonstration_as_far_as_hands_can_follow():
    """High above the obstacle, where hands cannot go."""
    way = np.linspace(0.0, 1.0, 101)
    taught = Demonstration(
        5.0 * way, np.stack([0.1 + 0.8 * minimum_jerk(way), 0.55 + 0.3 * np.sin(np.pi * way)], 1)
    )
    free = solve(SCENE, demonstration=taught, budget=10)
    low = highest(free.attempt) - 0.04

    class Told(Ceiling):
        def along(self, nodes):
            return Below(self.height)

    near = solve(SCENE, demonstration=taught, budget=10, kinematics=Told(low))
    smooth = solve(SCENE, budget=10, kinematics=Told(low))
    assert near.verified and highest(near.attempt) <= low
    hands = [found.attempt.hands(way)[0] for found in (free, near, smooth)]
    away, before = (np.linalg.norm(q - hands[0], axis=2).mean() for q in hands[1:])
    assert away < 0.5 * before


@pytest.mark.slow
def test_the_papers_method_asks_it_about_the_load_as_it_is():
    """However small a load that grows is drawn, hands hold the real one."""

    @dataclass(frozen=True)
    class Watched(Ceiling):
        apart: list = field(default_factory=list)

        def ask(self, nodes):
            self.apart.append(np.linalg.norm(nodes[:, :, 0] - nodes[:, :, 1], axis=2).mean())
            return super().ask(nodes)

    free = solve(SCENE, method=Paper(), budget=120)
    assert free.verified
    low = highest(free.attempt) - 0.02
    carrier = Watched(low)
    found = solve(SCENE, method=Paper(), budget=120, kinematics=carrier)
    assert found.verified and highest(found.attempt) <= low
    assert min(carrier.apart) > 0.05


def test_what_a_check_rejects_makes_the_carrier_careful():
    judged = []

    class Reluctant(Ceiling):
        def reasons(self, motion):
            judged.append(motion)
            return (
                ["not like this"] if len(judged) == 2 else []
            )  # the first motion stands, polishing it does not

    carrier = Reluctant(0.72)
    found = solve(SCENE, method=Comove(n_plans=1), budget=20, objective=PaperCost(), kinematics=carrier)
    assert found.verified and len(judged) >= 3
    assert max(carrier.asked) == 1


def test_what_nothing_can_carry_is_handed_out_as_an_attempt():
    class Helpless(Ceiling):
        def plan(self, space, start, goal, margin, rng, *, required, max_nodes):
            return plan(space, start, goal, margin, rng, required=required, max_nodes=max_nodes)

        def ask(self, nodes):
            return np.ones(len(nodes)), np.zeros(len(nodes), dtype=bool)

        def reasons(self, motion):
            return ["never"]

    found = solve(SCENE, seed=0, budget=1.5, kinematics=Helpless(0.5))
    assert not found.verified and "never" in found.reasons


def test_where_a_carrier_only_doubts_its_check_is_asked():
    """Its own picture is rougher than what the check knows; but it is not asked about everything."""

    judged = []

    class Doubtful(Ceiling):
        def ask(self, nodes):
            return np.zeros(len(nodes)), np.zeros(len(nodes), dtype=bool)

        def reasons(self, motion):
            judged.append(motion)
            return [] if len(judged) == 3 else ["not like this"]

    method = Comove(n_plans=1, n_unfit=np.inf, n_polishings=1, polishing=UNPOLISHED)
    found = solve(SCENE, budget=600, method=method, objective=PaperCost(), kinematics=Doubtful(0.72))
    assert found.verified
    assert len(judged) == 4  # two of the first plan, one of the second, and what comes of polishing
    assert found.effort.evaluations <= 5 * len(profiles(2)) * len(RIDGES)
