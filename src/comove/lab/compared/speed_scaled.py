"""Method of reference [8]: speed-scaled primitives with learned stiffness.

The stiffness is learned in cycles with a human. The mean of the end effectors of a rigid group (the absolute motion)
moves by the agreement of robot and human; the positions of the end effectors relative to it (the relative motion)
remain as demonstrated, as in the source's bimanual task. The human is simulated: she intends another path and pace
than demonstrated, and varies both from cycle to cycle, less in a part of the path. After the last cycle the robot
executes the learned motion alone, in the scene's duration. For the laws see `cooperation`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import is_number, require_count, require_positive
from comove.dmp.basis import motion_basis
from comove.errors import OptionError
from comove.lab.compared.common import (
    FITTING,
    FitSettings,
    control_times,
    count_execution,
    group_means,
    judge_execution,
    taught_primitives,
)
from comove.lab.compared.cooperation import Cycle, Intention, Laws, Skill, learned, run_cycle
from comove.model.coordinates import arms_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.method import Method
from comove.planning.search import Search

N_SAMPLES = 401  # samples of the phase


@dataclass(frozen=True)
class Human:
    """Simulated human, whose intentions fade towards both ends.

    Attributes
    ----------
    offset : size of the constant change of the path [m]
    spread : size of the variation of the path from cycle to cycle [m]
    pace_offset, pace_spread : sizes of the constant change and of the variation of the pace, relative to the
        demonstrated pace
    precise : first and last phase of the part in which she varies only a tenth as much
    stiffness : k_h [N/m, with a unit mass]
    waves : number of sine waves of an intention
    """

    offset: float = 0.03
    spread: float = 0.02
    pace_offset: float = 0.3
    pace_spread: float = 0.1
    precise: tuple[float, float] = (0.4, 0.6)
    stiffness: float = 300.0
    waves: int = 3

    def __post_init__(self) -> None:
        for name in ("offset", "spread", "pace_offset", "pace_spread", "stiffness"):
            value = getattr(self, name)
            if not is_number(value) or not 0.0 <= value < np.inf:
                raise OptionError(f"{name} = {value!r}", key=name, way_out="give a number, 0 or more")
        require_count("waves", self.waves)
        if not (len(self.precise) == 2 and 0.0 <= self.precise[0] <= self.precise[1] <= 1.0):
            raise OptionError(
                f"precise = {self.precise!r}", key="precise", way_out="give two phases in order, from 0 to 1"
            )

    def care(self, s: Array) -> Array:
        """Return the factor of the variation at phases s; arrays, shape (n_samples,)."""
        low, high = self.precise
        inside = (
            0.5 * (np.tanh((s - low) / 0.02) - np.tanh((s - high) / 0.02)) if high > low else np.zeros_like(s)
        )
        return 1.0 - 0.9 * inside


HUMAN, LAWS = Human(), Laws()


@dataclass(frozen=True)
class SpeedScaled(Method):
    """Method that learns path, pace and stiffness of speed-scaled primitives.

    Attributes
    ----------
    cycles : number of executions together with the human
    human : the simulated human
    laws : parameters of cooperation and learning
    n_basis : shape weights a dimension of the learned path
    period : time step [s]; shorter if the movement would have fewer than 200 steps, longer if it would have more than
        20 000
    n_times : samples of the last motion
    fitting : settings of the curve that is fitted to it
    """

    name: ClassVar[str] = "speed-scaled"
    coordinates = staticmethod(arms_coordinates)
    cycles: int = 20
    human: Human = HUMAN
    laws: Laws = LAWS
    n_basis: int = 30
    period: float = 0.002
    n_times: int = 2001
    fitting: FitSettings = FITTING

    def __post_init__(self) -> None:
        require_count("cycles", self.cycles)
        require_positive("period", self.period)

    def run(self, search: Search, *, planner: bool) -> None:
        """Run the cycles and verify the learned motion, without path planning."""
        scene, s = search.scene, np.linspace(0.0, 1.0, N_SAMPLES)
        taught = taught_primitives(search).rollout()
        cycles: list[Cycle] = []
        stiffness = [self._first(scene, taught).stiffness(self.laws).mean(axis=(0, 1))]
        for skill, cycle in self.cooperate(search):
            cycles.append(cycle)
            stiffness.append(skill.stiffness(self.laws).mean(axis=(0, 1)))
            times, hands = alone(scene, taught, skill, s, self.n_times)
            count_execution(search, hands)
            if search.over():
                break
        search.journal.log |= {
            "cycle_deviation_rms_m": [
                float(np.sqrt(np.square(cycle.deviation).sum(axis=2).mean())) for cycle in cycles
            ],
            "cycle_human_force_rms_N": [cycle.effort for cycle in cycles],
            "cycle_duration_s": [cycle.duration * scene.duration for cycle in cycles],
            **{
                f"stiffness_{name}_N_per_m": [float(k[i]) for k in stiffness]
                for i, name in enumerate(("tangent", "normal", "binormal")[: scene.n_dims])
            },
        }
        judge_execution(search, times, hands, self.fitting)

    def cooperate(self, search: Search) -> Iterator[tuple[Skill, Cycle]]:
        """Yield the skill after every cycle, and the measurements of that cycle."""
        scene, s = search.scene, np.linspace(0.0, 1.0, N_SAMPLES)
        period = scene.duration * control_times(scene.duration, self.period, most=20_000)[1]
        skill = self._first(scene, taught_primitives(search).rollout())
        shape = motion_basis(self.n_basis, "velocity").at(s)[1]
        follow = shape @ np.linalg.pinv(shape[0])  # a wish as the primitive can follow it, and 2 derivatives
        intend = self._intentions(search, skill.path[0])
        for number in range(self.cycles):
            search.journal.stage = f"cycle {number + 1} of {self.cycles}"
            cycle = run_cycle(skill, intend(), self.laws, scene.duration, period)
            skill = learned(skill, cycle, np.einsum("kst,tpd->kspd", follow, cycle.wish), self.laws)
            yield skill, cycle

    def _first(self, scene: Scene, taught: CoordinatedMotion) -> Skill:
        return Skill.taught(middles(scene, taught.hands(np.linspace(0.0, 1.0, N_SAMPLES))), self.laws)

    def _intentions(self, search: Search, path: Array) -> Callable[[], Intention]:
        """Return a function that samples the human's next intention."""
        rng, human, s = search.rng, self.human, np.linspace(0.0, 1.0, N_SAMPLES)
        fade = 16.0 * s**2 * (1.0 - s) ** 2
        care = human.care(s)

        def wish(shape: tuple[int, ...]) -> Array:
            """Sample smooth functions of unit size; array, shape (N_SAMPLES, *shape)."""
            waves = np.sin(np.pi * s[:, None] * np.arange(1, human.waves + 1))
            drawn = rng.standard_normal((human.waves, *shape)) / np.sqrt(human.waves / 2)
            return np.tensordot(waves, drawn, axes=1)

        always = path + human.offset * fade[:, None, None] * wish(path.shape[1:])
        pace = human.pace_offset * fade * np.tanh(wish(()))

        def intend() -> Intention:
            varied = human.spread * (fade * care)[:, None, None] * wish(path.shape[1:])
            mu = np.exp(pace + human.pace_spread * fade * care * np.tanh(wish(())))
            return Intention(always + varied, mu, human.stiffness)

        return intend


def middles(scene: Scene, hands: Array) -> Array:
    """Return the mean position of every rigid group's end effectors.

    Parameters
    ----------
    hands : array, shape (..., n_manipulators, n_dims), positions of the end effectors [m]

    Returns
    -------
    array, shape (..., n_groups, n_dims), [m]
    """
    return np.einsum("gm,...md->...gd", group_means(scene), hands)


def alone(
    scene: Scene, taught: CoordinatedMotion, skill: Skill, s: Array, n_times: int
) -> tuple[Array, Array]:
    """Return the learned motion of the robot alone. It has the scene's duration.

    Parameters
    ----------
    s : array, shape (n_samples,), phases at which the skill is sampled

    Returns
    -------
    times : array, shape (n_times,), even normalised times
    hands : array, shape (n_times, n_manipulators, n_dims), positions of the end effectors [m]
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    steps = 0.5 * (skill.slowness[1:] + skill.slowness[:-1]) * np.diff(s)
    clock = np.concatenate([[0.0], np.cumsum(steps)])
    times = np.linspace(0.0, 1.0, n_times)
    phase = np.clip(PchipInterpolator(clock / clock[-1], s)(times), 0.0, 1.0)
    moved = CubicSpline(s, skill.path[0] - middles(scene, taught.hands(s)[0]))(phase)
    hands = taught.hands(phase)[0]
    for g, group in enumerate(scene.groups):
        hands[:, list(group.members)] += moved[:, g, None]
    return times, hands
