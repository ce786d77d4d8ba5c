"""Method of reference [5] (Stavridis et al.): task-priority quadratic programmes.

Errors have a prescribed performance. In every control step the end effectors' velocities v solve, in this order (see
`hierarchy`),

    L0   limits of speed and acceleration; clearances, the border and separations (see `nearness`)
    L1   relative motion: every distance d_ij, and every difference of heights,   d_ij' = prescribed(d_ij - D_ij)
    L2   absolute motion: the mean m_g of every rigid group,   m_g' = m_g,ref' + prescribed(m_g - m_g,ref)
    L3   posture: the rest, such as the rotation of payloads,   v_i = y_i,ref' + k (y_i,ref - y_i)

where the reference is the jointly demonstrated movement and `prescribed` is the velocity of `Performance`. In the
source, a dynamical system is the reference; here the primitive is, and its phase waits for means that lag behind
(Ijspeert et al., 2013) and catches up later. In the source, variables and postures are those of joints: so they are
with a robot (`task_priority_joints`).

**Prescribed performance** keeps an error within a shrinking bound (Bechlioulis and Rovithakis, 2008). With the bound
rho(t) = (rho_0 - rho_end) exp(-a t) + rho_end and xi = e/rho, the error is mapped to eps = artanh(xi),
which is finite only inside the bound. With the control law

    e' = rho'/rho e - k rho eps / (1 - xi^2)        eps' = -k eps / (1 - xi^2)^2

eps decays at least as fast as exp(-k t), so that an error that begins inside the bound stays inside; a small error
decays like exp(-k t). In discrete time the pull removes at most half of the error in a step, which also draws an
error back that was forced outside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import is_number, require_positive
from comove.dmp.online import rate_for_lag
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
from comove.lab.compared.hierarchy import PriorityTask, lexicographic
from comove.lab.compared.nearness import Approach, clearance_rows
from comove.lab.systems import distance_errors
from comove.model.coordinates import arms_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.method import Method
from comove.planning.search import Search

OUTSIDE = 1.0 - 1e-6  # xi from which on an error counts as outside its bound


@dataclass(frozen=True)
class Performance:
    """Bound of an error, and the gain that reduces it.

    Attributes
    ----------
    first, last : rho_0 and rho_end, the bound at first and in the limit [m]
    decay : a, decay rate of the bound [1/s]
    gain : k, decay rate of the error [1/s]
    most : largest share of an error that is removed in a step
    """

    first: float
    last: float
    decay: float
    gain: float
    most: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_positive(name, value)
        if not self.last <= self.first:
            raise OptionError(f"last = {self.last!r}", key="last", way_out=f"give at most {self.first:g}")

    def bound(self, time: ArrayLike) -> Array:
        """Return the bound rho [m] at times [s]; arrays of any one shape."""
        return (self.first - self.last) * np.exp(-self.decay * np.asarray(time, dtype=float)) + self.last

    def wanted(self, error: Array, time: float, period: float) -> Array:
        """Return the rate e' [m/s] that keeps errors [m] within bounds.

        Parameters
        ----------
        period : control period [s]
        """
        rho = float(self.bound(time))
        shrinking = -self.decay * (rho - self.last) / rho
        xi = np.clip(np.abs(error) / rho, 1e-9, OUTSIDE)
        pull = self.gain * np.arctanh(xi) / (xi * (1.0 - xi**2))
        return (shrinking - np.minimum(pull, self.most / period)) * error


RELATIVE = Performance(first=0.02, last=1e-3, decay=2.0, gain=100.0)
ABSOLUTE = Performance(first=0.05, last=0.02, decay=2.0, gain=5.0)


@dataclass(frozen=True)
class TaskPriority(Method):
    """Method that solves a task-priority quadratic programme every control step.

    Attributes
    ----------
    relative, absolute : prescribed performance of L1 and of L2
    posture : gain k of L3 [1/s]
    approach : ratio of the largest approach speed to the remaining clearance [1/s]
    margin : margin kept on top of the scene's clearance [m]
    acceleration : limit of the end effectors' acceleration if the scene has no lower one [m/s^2]; without any limit,
        velocities would jump, which no curve can represent
    inside : share of the limits that is used
    catching_up : largest pace of the reference, in terms of the demonstrated pace
    reach : distance beyond the braking distance from which on obstacles are left out [m]
    rounds : largest number of rounds in a step, of solving and of adding tangents of the limits
    period : control period [s]; shorter if the movement would have fewer than 200 steps, longer if it would have more
        than 20 000
    fitting : settings of the curve that is fitted to the motion
    """

    name: ClassVar[str] = "task-priority"
    coordinates = staticmethod(arms_coordinates)
    relative: Performance = RELATIVE
    absolute: Performance = ABSOLUTE
    posture: float = 2.0
    approach: float = 10.0
    margin: float = 0.002
    acceleration: float = 5.0
    inside: float = 0.99
    catching_up: float = 2.0
    reach: float = 0.1
    rounds: int = 12
    period: float = 0.004
    fitting: FitSettings = FITTING

    def __post_init__(self) -> None:
        for name in ("posture", "approach", "margin", "acceleration", "period"):
            value = getattr(self, name)
            if not is_number(value) or not (value > 0.0 or (name in ("posture", "margin") and value == 0.0)):
                raise OptionError(f"{name} = {value!r}", key=name, way_out="give a positive number")

    def run(self, search: Search, *, planner: bool) -> None:
        """Run the controller and verify its motion, without path planning."""
        scene = search.scene
        s = control_times(scene.duration, self.period, most=20_000)
        taught = taught_primitives(search).rollout()
        reference = taught.hands(s)[0]
        hands = np.broadcast_to(scene.start, reference.shape).copy()
        controller = self._controller(search, scene.duration * s[1], taught)
        slacks, followed = [0.0], reference.copy()
        search.journal.stage = "following by quadratic programmes"
        for k, (velocity, slack, here) in enumerate(controller.velocities(hands, reference)):
            hands[k + 1] = hands[k] + controller.period * velocity
            followed[k] = here
            slacks.append(slack)
            if search.over():
                break
        hands[len(slacks) :] = hands[len(slacks) - 1]  # where time was up
        count_execution(search, hands)
        search.journal.log |= self._measures(scene, s * scene.duration, hands, followed)
        search.journal.log |= {
            "slack_max_m_per_s": max(slacks),
            "carried_out_share": (len(slacks) - 1) / (len(s) - 1),
        }
        judge_execution(search, s, hands, self.fitting, controller.carried_out)

    def _controller(self, search: Search, period: float, taught: CoordinatedMotion) -> Controller:
        if not search.kinematics.has_limits:
            return Controller(self, search.scene, period)
        from comove.lab.compared.task_priority_joints import JointController  # which needs robots

        return JointController(self, search, period, taught)

    def _measures(self, scene: Scene, time: Array, hands: Array, reference: Array) -> dict[str, float]:
        """Return the largest errors of L1 and L2, with out-of-bound time shares."""
        middles = group_means(scene)
        absolute = np.abs(np.einsum("gm,tmd->tgd", middles, hands - reference)).max(axis=(1, 2))[:-1]
        relative = distance_errors(scene, hands)
        return {
            "relative_error_max_m": float(relative.max()),
            "relative_beyond_bound": float((relative > self.relative.bound(time)).mean()),
            "absolute_error_max_m": float(absolute.max()),
            "absolute_beyond_bound": float((absolute > self.absolute.bound(time[:-1])).mean()),
        }


class Controller:
    """Controller of a scene's end effectors, step by step.

    Parameters
    ----------
    method : method that holds the controller's parameters
    scene : scene with the end effectors, their constraints and limits
    period : control period [s]
    """

    def __init__(self, method: TaskPriority, scene: Scene, period: float):
        self.method, self.scene, self.period = method, scene, period
        n_dims = scene.n_dims
        self.middles = np.kron(group_means(scene), np.eye(n_dims)).astype(float)
        self.levels = [pair for c in scene.constraints for pair in c.level(scene.ends)]
        self.acceleration = min(scene.acceleration_limit, method.acceleration)
        self.approach = Approach(
            min(method.approach, 0.5 / period), 0.5 * self.acceleration, scene.clearance + method.margin
        )

    def velocities(self, hands: Array, reference: Array) -> Iterator[tuple[Array, float, Array]]:
        """Yield velocities, slack and reference for every step.

        Parameters
        ----------
        hands : array, shape (n_steps, n_manipulators, n_dims), positions [m], into which the caller writes the result
            of each step before it requests the next
        reference : array, shape (n_steps, n_manipulators, n_dims), reference positions [m]

        Yields
        ------
        velocity : array, shape (n_manipulators, n_dims) [m/s]
        slack : largest amount by which an inequality had to be relaxed [m/s]
        here : array, shape (n_manipulators, n_dims), reference at the current phase [m]
        """
        scene, before, phase = self.scene, np.zeros(reference.shape[1:]), 0.0
        reach = self.method.reach + self._fastest(reference) ** 2 / (2.0 * self.approach.braking)
        for k in range(len(reference) - 1):
            time = k * self.period
            speeds = scene.by_row(scene.obstacle_velocities(np.array([time])))[0]
            around = scene.obstacles_at(time), speeds
            rows, low = clearance_rows(scene, hands[k], *around, self.approach, reach)
            here, next_phase = self._at(reference, phase), self._next_phase(hands[k], reference, phase, k)
            slope = (self._at(reference, next_phase) - here) / self.period
            before, slack = self._limited(self._tasks(hands[k], here, slope, before, time), rows, low, before)
            yield before, slack, here
            phase = next_phase

    def carried_out(self, motion: CoordinatedMotion) -> dict[str, float]:
        """Return measures of the fitted curve; free end effectors have none."""
        return {}

    def _fastest(self, reference: Array) -> float:
        """Return an upper bound of end effectors' and obstacles' approach speed [m/s]."""
        scene, step = self.scene, np.linalg.norm(np.diff(reference, axis=0), axis=2).max()
        time = np.linspace(0.0, scene.duration, len(reference))
        tips = np.linalg.norm(scene.spins, axis=1) * scene.reaches
        coming = (np.linalg.norm(scene.obstacle_velocities(time), axis=2) + tips).max(initial=0.0)
        return min(self.method.catching_up * step / self.period, scene.speed_limit) + coming

    @staticmethod
    def _at(reference: Array, phase: float) -> Array:
        """Return the reference at a phase, counted in steps [m]. Array, shape (n_manipulators, n_dims)."""
        k = min(int(phase), len(reference) - 2)
        return reference[k] + (phase - k) * (reference[k + 1] - reference[k])

    def _next_phase(self, hands: Array, reference: Array, phase: float, k: int) -> float:
        """Return the phase after step k, slower while means lag behind. It catches up later."""
        last = len(reference) - 1.0
        off = self.middles @ (hands - self._at(reference, phase)).ravel()
        lag = float(np.abs(off).max())
        pace = min(self.method.catching_up, (last - phase) / (last - k))
        return min(last, phase + pace * rate_for_lag(lag, self.method.absolute.last))

    def _tasks(
        self, hands: Array, wanted: Array, slope: Array, before: Array, time: float
    ) -> list[PriorityTask]:
        """Return the tasks L1 to L3 at one instant."""
        method, size = self.method, hands.size
        matrix: list[Array] = [np.zeros((0, size))]
        target: list[Array] = [np.zeros(0)]
        for c in self.scene.distances:
            away = hands[c.first] - hands[c.second]
            length = float(np.linalg.norm(away))
            direction = away / max(length, 1e-12)
            matrix.append(self._difference(c.first, c.second, direction))
            error = np.array([length - c.distance])
            target.append(method.relative.wanted(error, time, self.period))
        for first, second in self.levels:
            up = np.eye(self.scene.n_dims)[-1]
            matrix.append(self._difference(first, second, up))
            error = np.array([(hands[first] - hands[second]) @ up])
            target.append(method.relative.wanted(error, time, self.period))
        off = self.middles @ (hands - wanted).ravel()
        absolute = self.middles @ slope.ravel() + method.absolute.wanted(off, time, self.period)
        posture: Array = slope + min(method.posture, 0.5 / self.period) * (wanted - hands)
        return [
            PriorityTask(np.concatenate(matrix), np.concatenate(target)),
            PriorityTask(self.middles, self._reachable(absolute, self.middles @ before.ravel())),
            PriorityTask(np.eye(size), posture.ravel()),
        ]

    def _reachable(self, wanted: Array, before: Array) -> Array:
        """Shorten the wanted velocities of the means to the limits [m/s]. Speeds are shortened without a change of
        direction, then the changes from the velocities `before` likewise; arrays, shape (n,). Otherwise the limits
        would determine the direction of velocities far beyond them."""
        wanted, before = (v.reshape(-1, self.scene.n_dims) for v in (wanted, before))
        inside = self.method.inside
        wanted = _shortened(wanted, inside * self.scene.speed_limit)
        return (before + _shortened(wanted - before, inside * self.acceleration * self.period)).ravel()

    def _difference(self, first: int, second: int, direction: Array) -> Array:
        """Return the row of a relative velocity along a direction. Its shape is (1, n)."""
        row = np.zeros((len(self.scene.manipulators), self.scene.n_dims))
        row[first], row[second] = direction, -direction
        return row.reshape(1, -1)

    def _limited(
        self, tasks: list[PriorityTask], rows: Array, low: Array, before: Array
    ) -> tuple[Array, float]:
        """Solve the tasks within limits; return velocities and slack [m/s]. Limits of speed and acceleration are
        balls. Where a solution leaves a ball, a tangent plane is added, and the tasks are solved again."""
        x, slack = self._inside_balls(tasks, rows, low, before, np.eye(before.size))
        return x.reshape(before.shape), slack

    def _inside_balls(
        self, tasks: list[PriorityTask], rows: Array, low: Array, before: Array, hands: Array
    ) -> tuple[Array, float]:
        """Solve the tasks within the end effectors' limits. `hands`, shape (n_manipulators * n_dims, n), are their
        velocities per unit of the variables. Return the variables, and the slack [m/s]."""
        inside = self.method.inside
        speed, change = inside * self.scene.speed_limit, inside * self.acceleration * self.period
        for _ in range(self.method.rounds):
            x, slack = lexicographic(tasks, rows, low)
            velocity = (hands @ x).reshape(before.shape)
            tangents, bounds = [], []
            for middle, radius in ((np.zeros_like(before), speed), (before, change)):
                away = velocity - middle
                length = np.linalg.norm(away, axis=1)
                for hand in np.flatnonzero(length > radius * (1.0 + 1e-9)):
                    row = np.zeros_like(before)
                    row[hand] = -away[hand] / length[hand]
                    tangents.append(row.ravel() @ hands)
                    bounds.append(row[hand] @ middle[hand] - radius * (1.0 - 1e-3))
            if not tangents:
                break
            rows, low = np.vstack([rows, *tangents]), np.append(low, bounds)
        return x, slack


def _shortened(vectors: Array, most: float) -> Array:
    """Return vectors, (n, n_dims), of length `most` or less."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(lengths, 1e-12))
