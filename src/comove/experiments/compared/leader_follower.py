"""The method of reference [7]: iterative learning of a coupling between leader and follower, or between equals.

The primitives are taught jointly. In every epoch they are executed with coupling (see `coupling`), and the coupling
that was needed is learned for the next epoch. The last epoch is returned. The source treats pairs of hands and the
distances between them, but no obstacles.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import arms_coordinates
from comove.errors import OptionError, near_name
from comove.experiments.compared.coupling import Gains, learn, run_epoch, spectral_radius
from comove.experiments.compared.curve import count_execution, fit_curve
from comove.experiments.compared.taught import taught_primitives
from comove.planning.method import Method
from comove.planning.search import Search
from comove.primitives.arguments import require_count, require_positive
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_LEAST, N_MOST = 200, 100_000  # steps of an epoch
GAINS = Gains()


@dataclass(frozen=True)
class LeaderFollower(Method):
    """A method that learns the coupling of leader and follower over epochs.

    Attributes
    ----------
    epochs : number of executions, the last of which is returned
    mutual : whether both hands of a pair follow, instead of one
    leader : name of the hand that leads its pair; by default, the first hand of every pair leads
    gains : gains of coupling and learning
    period : control period [s]; shorter if the movement would have fewer than 200 steps, longer if it would have more
        than 100 000
    """

    name: ClassVar[str] = "leader-follower"
    coordinates = staticmethod(arms_coordinates)
    epochs: int = 20
    mutual: bool = False
    leader: str | None = None
    gains: Gains = GAINS
    period: float = 0.002

    def __post_init__(self) -> None:
        require_count("epochs", self.epochs)
        require_positive("period", self.period)

    def run(self, search: Search, *, planner: bool) -> None:
        """Run the epochs and have the last one verified; no path is planned."""
        scene, pairs = search.scene, self._pairs(search.scene)
        n_steps = int(np.clip(np.ceil(scene.duration / self.period), N_LEAST, N_MOST)) + 1
        self._require_stable(1.0 / (n_steps - 1), scene.duration)
        s = np.linspace(0.0, 1.0, n_steps)
        uncoupled = taught_primitives(search).rollout().hands(s)[0]
        learned = np.zeros((len(pairs), n_steps, scene.n_dims))
        following = np.ones(2) if self.mutual else np.array([0.0, 1.0])
        rms, worst, hands = [], [], uncoupled.copy()
        for epoch in range(self.epochs):
            search.stage = f"epoch {epoch + 1} of {self.epochs}"
            runs = []
            for p, (lead, follow, distance) in enumerate(pairs):
                run = run_epoch(uncoupled[:, [lead, follow]], distance, following, learned[p], self.gains)
                hands[:, [lead, follow]] = run.position
                learned[p] = learn(learned[p], run.force, self.gains)
                runs.append(run)
            rms.append(max(run.error_rms for run in runs))
            worst.append(max(float(np.abs(run.error).max()) for run in runs))
            count_execution(search, hands)
            if search.over():
                break
        fit = fit_curve(scene, search.objective.coordinates, s, hands)
        search.log |= {"epoch_error_rms_m": rms, "epoch_error_max_m": worst, **fit.log()}
        search.judge(fit.motion)

    def _pairs(self, scene: Scene) -> list[tuple[int, int, float]]:
        """Return leader, follower and distance [m] of every pair."""
        names = scene.manipulators
        if self.leader is not None and self.leader not in names:
            raise OptionError(
                f"there is no hand '{self.leader}'", key="leader", way_out=near_name(self.leader, names)
            )
        if not scene.distances:
            raise OptionError(
                "no distance ties the hands", key="method", way_out="use the method 'comove' for free hands"
            )
        tied = Counter(hand for c in scene.distances for hand in (c.first, c.second))
        for hand, count in tied.items():
            if count > 1:
                raise OptionError(
                    f"a coupling is learned between two hands, and '{names[hand]}' is tied to {count}",
                    key="method",
                    way_out="use the method 'comove' or 'task-priority'",
                )
        pairs = []
        for c in scene.distances:
            lead, follow = sorted((c.first, c.second))
            if self.leader == names[follow]:
                lead, follow = follow, lead
            pairs.append((lead, follow, c.distance))
        return pairs

    def _require_stable(self, h: float, duration: float) -> None:
        growth = spectral_radius(self.gains, 2 if self.mutual else 1, h)
        if not growth < 1.0:
            raise OptionError(
                f"with c = {self.gains.coupling:g} and c_2 = {self.gains.derivative:g} an error of the distance "
                f"grows by a factor of {growth:.3g} in every control period of {1e3 * h * duration:.3g} ms",
                key="gains",
                way_out="give a shorter period or smaller gains",
            )
