"""Features of a compiled MuJoCo model without counterparts in URDFs.

Each is named once, with all elements that have it: constraints that close loops or couple joints otherwise than in
proportion, tendons, actuators that drive no joint, rotor inertias, contacts that the model lists or filters, soft
bodies, plugins, and another gravity. Features for drawing or touch alone are not named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.sim.mjcf_actuators import driven, is_one_of

EARTH = (0.0, 0.0, -9.81)  # m/s^2, as everything else in comove has it


@dataclass(frozen=True)
class LeftOut:
    """Features of a model that its robot's URDF omits.

    Attributes
    ----------
    mj, model : MuJoCo, and the compiled model
    robot : trees of the robot, by root body
    """

    mj: Any
    model: Any
    robot: frozenset[int]

    def notes(self) -> Iterator[str]:
        """Yield the omitted features in words, each kind once."""
        told: dict[str, list[str]] = {}
        for text, name in self._found():
            names = told.setdefault(text, [])
            if f"'{name}'" not in names:
                names.append(f"'{name}'")
        yield from (text.format(", ".join(names)) for text, names in told.items())
        model = self.model
        is_off = int(model.opt.disableflags) & int(self.mj.mjtDisableBit.mjDSBL_GRAVITY)
        gravity = np.zeros(3) if is_off else model.opt.gravity
        if not np.allclose(gravity, EARTH, atol=0.02):
            pull = ", ".join(f"{value:g}" for value in gravity)
            yield f"gravity is {pull} m/s^2 in the model, and {EARTH[2]:g} m/s^2 along z everywhere else"
        if model.nflex:
            yield "the model has soft bodies (flex), which no URDF has: they are left out"
        if model.nplugin:
            yield "the model has plugins, whose forces are left out"

    def _found(self) -> Iterator[tuple[str, str]]:
        """Yield texts of features, and the names of their elements."""
        yield from self._constraints()
        yield from self._tendons()
        yield from self._motors()
        yield from self._contacts()
        model = self.model
        for joint in range(model.njnt):
            if self._is_own(model.jnt_bodyid[joint]):
                name, dof = self._name("joint", joint), int(model.jnt_dofadr[joint])
                if is_one_of(model.jnt_type[joint], self.mj.mjtJoint.mjJNT_FREE):
                    yield "the robot moves freely by {}: it stays where the model begins", name
                elif model.dof_armature[dof] > 0.0:
                    yield (
                        "the rotors of {} have an inertia (armature), which no URDF has: torques are those without",
                        name,
                    )

    def _is_own(self, body: int) -> bool:
        return int(self.model.body_rootid[int(body)]) in self.robot

    def _name(self, kind: str, number: int) -> str:
        return str(getattr(self.model, kind)(int(number)).name or f"{kind} {number}")

    def _constraints(self) -> Iterator[tuple[str, str]]:
        """Yield equality constraints, except proportional joint couplings."""
        model, kinds = self.model, self.mj.mjtEq
        for k in np.flatnonzero(model.eq_active0).tolist():
            kind, first, second = model.eq_type[k], int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            if is_one_of(kind, kinds.mjEQ_JOINT):
                if not self._is_own(model.jnt_bodyid[first]):
                    continue
                name = self._name("joint", first)
                if second < 0:
                    at = f"{float(model.eq_data[k, 0]):.6g}"
                    yield f"the model holds {{}} at {at}: say it by `posture` in the description", name
                elif model.eq_data[k, 2:5].any():
                    yield "{} follow others by polynomials, which no URDF has: they move by themselves", name
            elif is_one_of(kind, kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                at_sites = is_one_of(model.eq_objtype[k], self.mj.mjtObj.mjOBJ_SITE)
                bodies = [
                    int(model.site_bodyid[number]) if at_sites else number for number in (first, second)
                ]
                if any(map(self._is_own, bodies)):
                    pair = "' and '".join(self._name("body", body) for body in bodies)
                    yield "constraints hold {} together: a URDF is a tree, and they are left out", pair
            elif is_one_of(kind, kinds.mjEQ_TENDON):
                yield "the length of {} is constrained: that is left out", self._name("tendon", first)

    def _tendons(self) -> Iterator[tuple[str, str]]:
        """Yield tendons that pull or limit the robot."""
        model, kinds = self.model, self.mj.mjtWrap
        for tendon in range(model.ntendon):
            acts = model.tendon_limited[tendon] or any(
                np.any(values[tendon])
                for values in (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss)
            )
            first = int(model.tendon_adr[tendon])
            for wrap in range(first, first + int(model.tendon_num[tendon])) if acts else ():
                kind, number = model.wrap_type[wrap], int(model.wrap_objid[wrap])
                body = None
                if is_one_of(kind, kinds.mjWRAP_JOINT):
                    body = model.jnt_bodyid[number]
                elif is_one_of(kind, kinds.mjWRAP_SITE):
                    body = model.site_bodyid[number]
                if body is not None and self._is_own(body):
                    yield (
                        "the tendons {} pull at the robot or limit it: they are left out",
                        self._name("tendon", tendon),
                    )
                    break

    def _motors(self) -> Iterator[tuple[str, str]]:
        model = self.model
        for actuator in range(model.nu):
            if not any(True for _ in driven(self.mj, model, actuator)):
                yield "the actuators {} drive no joint: they are left out", self._name("actuator", actuator)

    def _contacts(self) -> Iterator[tuple[str, str]]:
        """Yield explicit contacts, and links that filters exclude from contact."""
        model = self.model
        for pair in range(model.npair):
            for geom in (int(model.pair_geom1[pair]), int(model.pair_geom2[pair])):
                collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
                if self._is_own(model.geom_bodyid[geom]) and not collides:
                    yield (
                        "shapes of {} touch only what the model lists (<pair>): they have no collision body",
                        self._name("body", model.geom_bodyid[geom]),
                    )
        own = [k for k in range(model.ngeom) if self._is_own(model.geom_bodyid[k])]
        types, affinities = model.geom_contype[own], model.geom_conaffinity[own]
        passes = (types[:, None] & affinities) | (affinities[:, None] & types) == 0
        collides = (types | affinities) != 0
        # Bodies that are welded together, or joined, touch each other anyway.
        rigid = model.body_weldid[model.geom_bodyid[own]]
        above = model.body_weldid[model.body_parentid[rigid]]
        joined = (rigid[:, None] == rigid) | (rigid[:, None] == above) | (above[:, None] == rigid)
        passes &= ~joined
        if (passes & collides[:, None] & collides).any():
            names = {
                self._name("body", model.geom_bodyid[own[k]])
                for k in np.flatnonzero((passes & collides[:, None] & collides).any(axis=1))
            }
            for name in sorted(names):
                yield (
                    "contype and conaffinity let {} pass through others of the robot: here they keep apart, unless "
                    "an SRDF names the pairs",
                    name,
                )
