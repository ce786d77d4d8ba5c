"""What moves the hands limits a search: it plans, says what is possible, and becomes careful when it was wrong."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from comove.planning import Comove, Paper, PaperCost, methods, smooth, solve
from comove.planning.methods import UNPOLISHED
from comove.planning.planner import plan
from comove.planning.seeds import RIDGES, profiles
from comove.scenes import Scene

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
class Ceiling:
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

    def stricter(self):
        return replace(self, caution=self.caution + 1)

    def reasons(self, motion):
        return [] if highest(motion) <= self.height else ["too high"]


def highest(motion):
    return motion.hands(np.linspace(0, 1, 2001))[0][:, :, 1].max()


def test_a_search_stays_where_its_carrier_can_go():
    free = solve(SCENE, seed=3, budget=3)
    assert free.verified
    for seed in range(4):
        carrier = Ceiling(0.72)
        found = solve(SCENE, seed=seed, budget=10, carrier=carrier)
        assert found.verified and highest(found.attempt) <= 0.72


def test_smooth_motions_stay_where_their_carrier_can_go():
    """Nearer to the planned way than a free motion would be, and far smoother than the paper's objective asks."""
    free = solve(SCENE, seed=3, budget=3)
    low = highest(free.attempt) - 0.01
    carrier = Ceiling(low)
    found = solve(SCENE, budget=10, carrier=carrier)
    paper = solve(SCENE, budget=10, carrier=carrier, objective=PaperCost())
    assert found.verified and highest(found.attempt) <= low
    assert found.report.acceleration_max < 0.2 * paper.report.acceleration_max


def test_later_ways_begin_a_little_more_smoothly_than_the_last_one_ended(monkeypatch):
    pulls, ways = [], []

    def noted(programme, cost, *rest):
        pulls.append(smooth.PULLS.index(cost.pull))
        return optimise(programme, cost, *rest)

    def way(*arguments):
        pulls.clear()
        done = smooth_way(*arguments)
        ways.append((done, list(pulls)))
        return done

    low = highest(solve(SCENE, seed=3, budget=3).attempt) - 0.01
    optimise, smooth_way = smooth.optimise, smooth.smooth_way
    monkeypatch.setattr(smooth, "PULLS", (0.0, 1.0, 10.0, 100.0, 1e3, 1e4))
    monkeypatch.setattr(smooth, "optimise", noted)
    monkeypatch.setattr(methods, "smooth_way", way)
    assert solve(SCENE, budget=10, carrier=Ceiling(low)).verified
    assert len(ways) > 1 and ways[0][0] and ways[0][1][-1] > 1  # drawn to the plan at last
    for (done, before), (_, after) in pairwise(ways):
        assert not done or after[0] == before[-1] - 1


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
    found = solve(SCENE, method=Paper(), budget=120, carrier=carrier)
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
    found = solve(SCENE, method=Comove(n_plans=1), budget=20, objective=PaperCost(), carrier=carrier)
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

    found = solve(SCENE, seed=0, budget=1.5, carrier=Helpless(0.5))
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
    found = solve(SCENE, budget=600, method=method, objective=PaperCost(), carrier=Doubtful(0.72))
    assert found.verified
    assert len(judged) == 4  # two of the first plan, one of the second, and what comes of polishing
    assert found.evaluations <= 5 * len(profiles(2)) * len(RIDGES)
