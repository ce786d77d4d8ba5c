"""The classes of `movement_primitives` made of comove's primitives, as a plugin that runs the peer's own tests.

COMOVE_PEER_TESTS=FOLDER pytest tests/peers       # FOLDER/movement_primitives holds a checkout of the peer
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

import comove
from comove.demonstrations import Demonstration
from comove.errors import ComoveWarning, OptionError
from comove.primitives import LinearPhase, Pose, PoseDMP, ViaPoint
from comove.primitives.flow import OMEGA

STEPS = ("euler", "rk4", "rk4-cython", "euler-cython")


class DMP:
    """The peer's DMP of positions."""

    at_rest = True

    def __init__(self, n_dims, execution_time=1.0, dt=0.01, n_weights_per_dim=10, int_dt=0.001, **_):
        self.n_dims, self.dt_, self.execution_time_, self.int_dt = n_dims, dt, execution_time, int_dt
        self.n_weights_per_dim, self.n_weights = n_weights_per_dim, n_dims * n_weights_per_dim
        zeros = np.zeros(n_dims)
        weights = np.zeros((n_dims, n_weights_per_dim))
        self._dmp = comove.DMP(weights, zeros, zeros, zeros, zeros, execution_time)
        self.forcing_term = SimpleNamespace(weights_=weights)
        self._given = self.forcing_term.weights_
        self.reset()

    execution_time = property(lambda self: self.execution_time_)
    start_y = property(lambda self: self._now.start)
    start_yd = property(lambda self: self._now.start_velocity)
    goal_y = property(lambda self: self._now.goal)
    goal_yd = property(lambda self: self._goal_yd)
    _goal_yd = None

    @property
    def _now(self):
        dmp = self._dmp
        if self.forcing_term.weights_ is not self._given:
            dmp = replace(dmp, weights=self.forcing_term.weights_ / OMEGA**2)  # given as accelerations
        return dmp.towards(duration=self.execution_time_, goal_velocity=self._goal_yd)

    def imitate(self, T, Y, regularization_coefficient=0.0, allow_final_velocity=False):
        """Learn one recording."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            self._dmp = comove.DMP.fit(
                Demonstration(np.asarray(T), np.asarray(Y), unit="any"),
                n_basis=self._given.shape[1],
                at_rest=self.at_rest and not allow_final_velocity,
            )
        self.forcing_term.weights_ = self._given = self._dmp.weights
        self.execution_time_ = self._dmp.duration
        self.reset()

    def configure(self, t=None, start_y=None, start_yd=None, goal_y=None, goal_yd=None, **_):
        """Set ends and present time."""
        if goal_yd is not None:
            self._goal_yd = np.asarray(goal_yd, dtype=float)
        try:
            self._dmp = self._dmp.towards(start=start_y, goal=goal_y, start_velocity=start_yd)
            self.reset()
        except OptionError as error:
            raise ValueError(str(error)) from error
        if t is not None:
            self.t = t
            self._state = self._now.step(self._state, t)

    def reset(self):
        """Go to the start."""
        self.t, self._state = 0.0, self._now.initial_state()

    def get_weights(self):
        """Return all weights."""
        return self._now.weights.ravel()

    def set_weights(self, weights):
        """Set all weights."""
        self.forcing_term.weights_ = self._given = weights.reshape(self._given.shape)
        self._dmp = replace(self._dmp, weights=self._given)

    def step(self, last_y, last_yd, coupling_term=None, step_function="rk4"):
        """Go one step ahead from a measured position."""
        if step_function not in STEPS:
            raise ValueError(f"Step function must be in {STEPS}")
        if self.t == 0.0:
            self._state = self._now.initial_state()
        state = replace(self._state, position=last_y)
        self._state = self._coupled(state, self.dt_, coupling_term)
        self.t += self.dt_
        return self._state.position.copy(), self._state.velocity.copy()

    def _coupled(self, state, dt, coupling_term):
        if coupling_term is None:
            return self._now.step(state, dt)
        now, tau, n = self._now, self.execution_time_, max(1, round(dt / self.int_dt))
        for _ in range(n):
            velocity, push = coupling_term.coupling(state.position, state.velocity)
            options = {"coupling": push / tau**2, "velocity_coupling": velocity / tau}
            state = now.step(state, dt / n, **options)
        return state

    def open_loop(self, run_t=None, coupling_term=None, step_function="rk4", **_):
        """Play the movement."""
        if step_function not in STEPS:
            raise ValueError(f"Step function must be in {STEPS}")
        time = np.arange(0.0, (run_t or self.execution_time_) + 0.5 * self.dt_, self.dt_)
        if coupling_term is None:
            return time, self._now.at(time).position
        self.reset()
        y, yd = self._now.start, self._now.start_velocity
        path = [y]
        for _ in time[1:]:
            y, yd = self.step(y, yd, coupling_term)
            path.append(y)
        return time, np.array(path)


class DMPWithFinalVelocity(DMP):
    """The peer's DMP that may end in motion."""

    at_rest = False


class CartesianDMP(DMP):
    """The peer's DMP of poses: positions, then quaternions w x y z."""

    def __init__(self, execution_time=1.0, dt=0.01, n_weights_per_dim=10, int_dt=0.001, **_):
        self.dt_, self._n, self.n_weights_per_dim = dt, n_weights_per_dim, n_weights_per_dim
        still = np.zeros(3)
        weights = np.zeros((3, n_weights_per_dim))
        part = comove.DMP(weights, still, still, still, still, execution_time)
        self._dmp = PoseDMP(part, part, np.array([1.0, 0, 0, 0]))
        self.reset()

    _now = property(lambda self: self._dmp)

    @property
    def execution_time_(self):
        """Return the duration."""
        return self._dmp.duration

    @execution_time_.setter
    def execution_time_(self, duration):
        self._dmp = self._dmp.towards(duration=duration)
        self.reset()

    start_y = property(lambda self: np.concatenate([self._dmp.start.position, self._dmp.start.orientation]))
    start_yd = property(lambda self: np.zeros(6))

    def imitate(self, T, Y, regularization_coefficient=0.0, allow_final_velocity=False):
        """Learn one recording."""
        demo = Demonstration(T, Y[:, :3], orientation=Y[:, 3:], unit="any")
        self._dmp = PoseDMP.fit(demo, n_basis=self._n, at_rest=not allow_final_velocity)
        self.reset()

    def configure(self, start_y=None, goal_y=None, **_):
        """Set the poses of both ends."""
        poses = {"start": start_y, "goal": goal_y}
        given = {name: Pose(y[:3], y[3:]) for name, y in poses.items() if y is not None}
        self._dmp = self._dmp.towards(**given)
        self.reset()

    def get_weights(self):
        """Return all weights."""
        return self._dmp.weights.ravel()

    def set_weights(self, weights):
        """Set all weights."""
        moved, turned = np.split(weights.reshape(6, -1), 2)
        self._dmp = replace(
            self._dmp,
            translation=replace(self._dmp.translation, weights=moved),
            turning=replace(self._dmp.turning, weights=turned),
        )

    def step(self, last_y, last_yd):
        """Go one step ahead."""
        self._state = self._dmp.step(self._state, self.dt_)
        self.t += self.dt_
        pose = self._dmp.pose(self._state)
        return np.concatenate([pose.position, pose.orientation]), np.concatenate(self._dmp.twist(self._state))

    def open_loop(self, run_t=None, step_function="rk4", quaternion_step_function="cython-code", **_):
        """Play the movement."""
        if step_function not in STEPS or quaternion_step_function not in ("cython-code", "python-code"):
            raise ValueError("Step function must be known")
        time = np.arange(0.0, (run_t or self.execution_time_) + 0.5 * self.dt_, self.dt_)
        path = self._dmp.at(time)
        return time, np.concatenate([path.position, path.orientation], axis=1)


class ProMP:
    """The peer's distribution of movements."""

    def __init__(self, n_dims, n_weights_per_dim=10):
        self.n_dims, self._n = n_dims, n_weights_per_dim

    def imitate(self, Ts, Ys, **_):
        """Learn several recordings."""
        demos = [Demonstration(np.asarray(T), np.asarray(Y), unit="any") for T, Y in zip(Ts, Ys, strict=True)]
        self._promp = comove.ProMP.fit(demos, n_basis=self._n, phase=LinearPhase())

    def _at(self, T):
        return np.asarray(T) * self._promp.duration / np.max(T)

    def mean_trajectory(self, T):
        """Return the mean."""
        return self._promp.mean_at(self._at(T))

    def mean_velocities(self, T):
        """Return the velocities of the mean."""
        return self._promp.mean.at(self._at(T)).velocity * self._promp.duration / np.max(T)

    def var_velocities(self, T):
        """Return the variances of the velocities."""
        ratio = self._promp.duration / np.max(T)
        covariance = self._promp.covariance_at(self._at(T), of_velocity=True)
        return np.diagonal(covariance, axis1=1, axis2=2) * ratio**2

    def var_trajectory(self, T):
        """Return the variances."""
        return self._promp.std_at(self._at(T)) ** 2

    def sample_trajectories(self, T, n_samples, random_state):
        """Return drawn trajectories."""
        rng = np.random.default_rng(random_state.randint(2**31))
        return self._promp.sample_trajectories(rng, n_samples, len(T))

    def condition_position(self, y_mean, y_cov=None, t=0.0, t_max=1.0):
        """Return the distribution through a point."""
        via = ViaPoint(t / t_max * self._promp.duration, np.atleast_1d(y_mean))
        other = ProMP(self.n_dims, self._n)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            other._promp = self._promp.condition(via, position_covariance=0.0 if y_cov is None else y_cov)
        return other


def pytest_configure(config):
    """Put comove's classes in the peer's place."""
    import movement_primitives.dmp
    import movement_primitives.promp

    for own in (DMP, DMPWithFinalVelocity, CartesianDMP):
        setattr(movement_primitives.dmp, own.__name__, own)
    movement_primitives.promp.ProMP = ProMP
