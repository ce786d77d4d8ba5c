"""Method of reference [7]: iterative learning of a coupling.

It couples leader and follower, or equals. The primitives are demonstrated jointly. In every epoch they are executed
with coupling, and the coupling that was needed is learned for the next epoch (iterative learning control; Gams et
al., T-RO 2014). The last epoch is returned. The source treats pairs of end effectors and the distances between them,
but no obstacles.

In unit duration, with r = y_2 - y_1 and u = r/|r|, the end effectors i of a pair move as

    y_i' = z_i + w_i C_i                              F   = (D - |r|) u
    z_i' = alpha (beta (g_i - y_i) - z_i) + f_i(s)    C_2 = c F + F_c,   C_1 = -C_2
           + w_i c_2 C_i'

where w is 0 for a leader and 1 for a follower; both are 1 in mutual coupling. F is the virtual force that draws the
end effectors to their distance D, and F_c the coupling learned in former epochs, at every step k of an epoch i,

    F_c,i+1(k) = Q (F_c,i(k) + L c F_i(k + 1)).

The transformed system is linear, so the position of an end effector is that of the uncoupled primitive plus a
deviation that obeys the same equation without goal and forcing. C is held over a control period and the deviation is
advanced exactly, as a controller in discrete time would see it; C' is an impulse at each change of C.

The control period bounds the gains from above. Along u the three numbers (deviation, its z, last C) obey a linear
recursion; `spectral_radius` gives the factor by which it grows in a step.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import exp, sqrt
from typing import ClassVar

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.dmp.arguments import is_number, require_count, require_positive
from comove.dmp.system import OMEGA
from comove.errors import OptionError, near_name
from comove.lab.compared.common import (
    FITTING,
    FitSettings,
    control_times,
    count_execution,
    judge_execution,
    taught_primitives,
)
from comove.model.coordinates import arms_coordinates
from comove.model.scene import Scene
from comove.planning.method import Method, require_distances
from comove.planning.search import Search

TINY = 1e-9  # m, distance below which the direction is undefined


@dataclass(frozen=True)
class Gains:
    """Gains of the coupling and of learning.

    Attributes
    ----------
    coupling : c, gain from the force to the velocity [1]
    derivative : c_2, gain from the derivative of the coupling by normalised time to the acceleration [1]; 0 for a
        coupling of the velocity alone
    forgetting : Q, factor of the learned coupling and the update together
    learning : L, factor of the update

    Raises
    ------
    OptionError
        If a gain is out of range.
    """

    coupling: float = 20.0
    derivative: float = 0.0
    forgetting: float = 0.99
    learning: float = 1.0

    def __post_init__(self) -> None:
        for name, most in (
            ("coupling", np.inf),
            ("derivative", np.inf),
            ("forgetting", 1.0),
            ("learning", 2.0),
        ):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= value <= most:
                way_out = "give a number, 0 or more" + ("" if most == np.inf else f", at most {most:g}")
                raise OptionError(f"{name} = {value!r}", key=name, way_out=way_out)


GAINS = Gains()


@dataclass(frozen=True)
class LeaderFollower(Method):
    """Method that learns the coupling of leader and follower over epochs.

    Attributes
    ----------
    epochs : number of executions, the last of which is returned
    mutual : whether both end effectors of a pair follow, instead of one
    leader : name of the end effector that leads its pair; by default, the first one of every pair leads
    gains : gains of coupling and learning
    period : control period [s]; shorter if the movement would have fewer than 200 steps, longer if it would have more
        than 100 000
    fitting : settings of the curve that is fitted to the last execution
    """

    name: ClassVar[str] = "leader-follower"
    coordinates = staticmethod(arms_coordinates)
    epochs: int = 20
    mutual: bool = False
    leader: str | None = None
    gains: Gains = GAINS
    period: float = 0.002
    fitting: FitSettings = FITTING

    def __post_init__(self) -> None:
        require_count("epochs", self.epochs)
        require_positive("period", self.period)

    def check(self, scene: Scene) -> None:
        """Refuse a scene without end effectors tied in pairs."""
        super().check(scene)
        self._pairs(scene)

    def run(self, search: Search, *, planner: bool) -> None:
        """Run the epochs and verify the last one, without path planning."""
        scene, pairs = search.scene, self._pairs(search.scene)
        s = control_times(scene.duration, self.period, most=100_000)
        self._require_stable(s[1], scene.duration)
        uncoupled = taught_primitives(search).rollout().hands(s)[0]
        learned = np.zeros((len(pairs), len(s), scene.n_dims))
        following = np.ones(2) if self.mutual else np.array([0.0, 1.0])
        rms, worst, hands = [], [], uncoupled.copy()
        for epoch in range(self.epochs):
            search.journal.stage = f"epoch {epoch + 1} of {self.epochs}"
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
        search.journal.log |= {"epoch_error_rms_m": rms, "epoch_error_max_m": worst}
        judge_execution(search, s, hands, self.fitting)

    def _pairs(self, scene: Scene) -> list[tuple[int, int, float]]:
        """Return leader, follower and distance [m] of every pair."""
        names = scene.manipulators
        if self.leader is not None and self.leader not in names:
            raise OptionError(
                f"there is no hand '{self.leader}'", key="leader", way_out=near_name(self.leader, names)
            )
        require_distances(scene)
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


def transition(h: float) -> tuple[Array, Array]:
    """Return a deviation's exact transition under a constant coupling C.

    The deviation (e, zeta) obeys ``e' = zeta + C, zeta' = -omega^2 e - 2 omega zeta``.

    Parameters
    ----------
    h : length of the step [durations]

    Returns
    -------
    of_state : array, shape (2, 2), factor of the deviation
    of_coupling : array, shape (2,), factor of C
    """
    x, decay = OMEGA * h, exp(-OMEGA * h)
    of_state = decay * np.array([[1.0 + x, h], [-OMEGA * x, 1.0 - x]])
    of_coupling = np.array([(2.0 * (1.0 - decay) - x * decay) / OMEGA, decay - 1.0 + x * decay])
    return of_state, of_coupling


def spectral_radius(gains: Gains, n_following: int, h: float) -> float:
    """Return the growth of a distance error in a step. Below 1 the coupling is stable.

    Parameters
    ----------
    n_following : number of end effectors that follow: 1 if one leads, 2 in mutual coupling
    h : length of the step [durations]
    """
    of_state, of_coupling = transition(h)
    c, kick = gains.coupling, n_following * gains.derivative
    # C_k = -c e_k; zeta is kicked by c_2 (C_k - C_k-1) before the step.
    kicked = np.array([[1.0, 0.0, 0.0], [-kick * c, 1.0, -kick]])
    held = np.array([-c, 0.0, 0.0])
    step = np.vstack([of_state @ kicked + n_following * np.outer(of_coupling, held), held])
    return float(np.abs(np.linalg.eigvals(step)).max())


@dataclass(frozen=True, eq=False)
class Epoch:
    """Execution of a coupled pair of end effectors.

    Attributes
    ----------
    position : array, shape (n_steps, 2, n_dims), positions of both end effectors [m]
    force : array, shape (n_steps, n_dims), virtual force F [m]
    error : array, shape (n_steps,), error of the distance |r| - D [m]
    """

    position: Array
    force: Array
    error: Array

    @property
    def error_rms(self) -> float:
        """Return the root mean square of the error [m]."""
        return float(np.sqrt(np.mean(self.error**2)))


def run_epoch(uncoupled: Array, distance: float, following: Array, learned: Array, gains: Gains) -> Epoch:
    """Simulate one execution of a coupled pair.

    Parameters
    ----------
    uncoupled : array, shape (n_steps, 2, n_dims), positions of the primitives without coupling, at even times [m]
    distance : distance D of the end effectors [m]
    following : array, shape (2,), w: 1 for a follower, 0 for a leader
    learned : array, shape (n_steps, n_dims), learned coupling F_c [m]
    """
    of_state, of_coupling = transition(1.0 / (len(uncoupled) - 1))
    position, force, error = _execute(
        np.ascontiguousarray(uncoupled),
        float(distance),
        np.asarray(following, dtype=float),
        np.ascontiguousarray(learned),
        gains.coupling,
        gains.derivative,
        of_state,
        of_coupling,
    )
    return Epoch(position, force, error)


def learn(learned: Array, force: Array, gains: Gains) -> Array:
    """Return F_c of the next epoch.

    Parameters
    ----------
    learned, force : arrays, shape (n_steps, n_dims), F_c and F of this epoch [m]
    """
    ahead = np.concatenate([force[1:], force[-1:]])
    return gains.forgetting * (learned + gains.learning * gains.coupling * ahead)


@kernel
def _execute(
    uncoupled: Array,
    distance: float,
    following: Array,
    learned: Array,
    c: float,
    c2: float,
    of_state: Array,
    of_coupling: Array,
) -> tuple[Array, Array, Array]:
    n_steps, _, n_dims = uncoupled.shape
    position, force = np.empty(uncoupled.shape), np.empty((n_steps, n_dims))
    error, deviation = np.empty(n_steps), np.zeros((2, 2, n_dims))  # hand; e and zeta
    held = np.zeros(n_dims)
    for k in range(n_steps):
        square = 0.0
        for d in range(n_dims):
            for i in range(2):
                position[k, i, d] = uncoupled[k, i, d] + deviation[i, 0, d]
            square += (position[k, 1, d] - position[k, 0, d]) ** 2
        length = sqrt(square)
        error[k] = length - distance
        for d in range(n_dims):
            force[k, d] = -error[k] * (position[k, 1, d] - position[k, 0, d]) / max(length, TINY)
            coupling = c * force[k, d] + learned[k, d]
            change = coupling - held[d] if k > 0 else 0.0
            held[d] = coupling
            for i in range(2):
                sign = following[i] if i == 1 else -following[i]
                e, zeta = deviation[i, 0, d], deviation[i, 1, d] + sign * c2 * change
                for row in range(2):
                    deviation[i, row, d] = (
                        of_state[row, 0] * e + of_state[row, 1] * zeta + of_coupling[row] * sign * coupling
                    )
    return position, force, error
