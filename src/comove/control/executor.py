"""Online execution among moving obstacles: follow, evade, stop in time, replan.

Every control step observes the obstacles. A plan that is certified for exactly known motions is followed exactly.
Otherwise the safety filter modifies the plan's velocities to keep clear of the observed obstacles; where the path is
blocked the payload slows down and evades until it is free. A plan that is predicted to fail is replaced by one from
the present state on.
"""

from __future__ import annotations

import warnings

import numpy as np

from comove.control.loop import ControlLoop
from comove.control.observers import Known, Observer
from comove.control.replanning import SETTINGS, Pace, Plan, PlanReplanner
from comove.control.safety.cbf_qp import FilterSettings, SafetyFilter
from comove.control.safety.twists import nodes_of
from comove.dmp.dmp import DMP
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import ComoveWarning, OptionError
from comove.model.resting import require_no_rest
from comove.model.scene import Scene
from comove.planning.arguments import movements_of, warn_of_adaptation
from comove.verification.verify import VerifiedMotion


class Executor(ControlLoop):
    """An executor that moves a scene's payload step by step among obstacles.

    Parameters
    ----------
    scene : the scene to be executed
    observer : observer of its obstacles; by default one that knows their motions
    seed : seed of the plans
    pace : periods and time budgets
    demonstration : a movement of one end effector, or one for each, that plans should resemble from the present state
        on
    plan : a verified motion of the scene that is followed first; one is searched unless given

    Raises
    ------
    OptionError
        If the plan is one for another scene.

    Warns
    -----
    ComoveWarning
        If the demonstration is magnified by more than 3 or leaves the workspace, as for `solve`.

    Attributes
    ----------
    time : present time [s]
    poses : present poses of the rigid groups
    twists : array, shape (n_groups, 6), twists of the last step [m/s, rad/s]
    log : log of the execution
    """

    def __init__(
        self,
        scene: Scene,
        observer: Observer | None = None,
        *,
        seed: int = 0,
        pace: Pace | None = None,
        demonstration: DMP | PoseDMP | ProMP | tuple[DMP, ...] | None = None,
        plan: VerifiedMotion | None = None,
    ):
        scene = scene.in_one_way() if plan is None else scene.held_as_in(plan.motion.scene)
        require_no_rest(scene)
        if np.isfinite(scene.jerk_limit):
            message = (
                f"limits.jerk ({scene.jerk_limit:g} m/s^3) does not bind an execution, whose accelerations change "
                "from step to step; speed, acceleration and clearance do"
            )
            warnings.warn(message, ComoveWarning, stacklevel=2)
        movements, pace = movements_of(demonstration, scene), pace or Pace()
        if movements is not None:  # once, and not for the rest of it that every plan follows
            warn_of_adaptation(movements, scene)
        super().__init__(scene, Known(scene) if observer is None else observer, SETTINGS)
        self.filter = SafetyFilter(scene, pace.period, FilterSettings(spare=SETTINGS.spare))
        self.replanner: PlanReplanner = PlanReplanner(movements, seed, pace)
        self.observer.carried(self.time, nodes_of(scene, self.poses))
        if plan is not None:
            if plan.motion.scene.sha256 != scene.sha256:
                raise OptionError(
                    "the plan is one for another scene",
                    key="plan",
                    way_out="solve this scene, or leave it out",
                )
            self.replanner.follow(self, Plan(plan.motion, 0.0, self.observer.certain))

    @property
    def plan(self) -> Plan | None:
        """Return the current plan; None if there is none."""
        return self.replanner.plan

    @property
    def ended(self) -> bool:
        """Return whether the payload has arrived and the plan has ended."""
        return self.arrived and (self.plan is None or self.time >= self.plan.ends - 1e-9)

    def step(self) -> None:
        """Perform one control step: observe, replan, filter, move."""
        self._step()
        self.observer.carried(self.time, nodes_of(self.scene, self.poses))

    def _follow(self) -> None:
        self.step()
