"""Masses of links that joints move, guessed from collision bodies if unknown.

They are guessed only where nothing that a joint moves has a mass: models often give a link's mass to its neighbour.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from comove.arrays import ROUNDING, Array
from comove.errors import RobotError
from comove.robots.soundness import MOMENTS, ends_of
from comove.robots.urdf import Source

DENSITY = 1000.0  # kg/m^3
MAX_TOLD = 6


def moved_masses(model: Any, without: float | Array = 0.0) -> Array:
    """Return the masses that a model's joints move; array, shape (n_joints + 1,), the universe first [kg].

    Parameters
    ----------
    without : masses that do not count, as `masses_of` returns them
    """
    masses = np.array([inertia.mass for inertia in model.inertias])
    masses = np.where(masses - without > ROUNDING * masses, masses - without, 0.0)
    for joint in range(model.njoints - 1, 0, -1):
        masses[model.parents[joint]] += masses[joint]
    return masses


def mass_beyond(joint: str, sources: Iterable[Source]) -> float:
    """Return the mass beyond the link that a joint moves [kg]. It is the gripper's for an arm's last joint."""
    for source in sources:
        ends = {each.get("name", ""): ends_of(each) for each in ET.fromstring(source.urdf).findall("joint")}
        if joint in ends:
            break
    below = dict[str, list[str]]()
    for parent, child in ends.values():
        below.setdefault(parent, []).append(child)
    beyond = list(below.get(ends[joint][1], []))
    for name in beyond:
        beyond += below.get(name, [])
    masses = _link_masses(source.urdf)
    return sum(masses.get(name, 0.0) for name in beyond)


def masses_of(urdf: str, links: Collection[str], model: Any) -> Array:
    """Return the masses of a URDF's links by moving joint; array, shape (n_joints + 1,) [kg]."""
    masses = np.zeros(model.njoints)
    for link, mass in _link_masses(urdf).items() if links else ():
        if link in links:
            masses[model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint] += mass
    return masses


def _link_masses(urdf: str) -> dict[str, float]:
    links = (
        (link.get("name", ""), link.find("inertial/mass")) for link in ET.fromstring(urdf).findall("link")
    )
    return {name: float(mass.get("value", "0")) for name, mass in links if mass is not None}


def with_guessed_masses(source: Source, model: Any, geometry: Any) -> tuple[Source, str | None]:
    """Add missing masses and inertias of links to model and URDF.

    Parameters
    ----------
    model : pinocchio.Model of the source, which is changed
    geometry : pinocchio.GeometryModel of its collision bodies

    Returns
    -------
    the source with these masses, and a note about them; None where there was nothing to guess
    """
    bodies = dict[int, list[Any]]()
    massless = moved_masses(model, masses_of(source.urdf, source.gripper_links, model)) == 0.0
    for item in geometry.geometryObjects:
        name = model.frames[item.parentFrame].name
        guess = item.parentJoint > 0 and massless[item.parentJoint] and name not in source.gripper_links
        if guess or name in source.masses:
            bodies.setdefault(item.parentFrame, []).append(item)
    found = {frame: _inertia(items, model.frames[frame].placement) for frame, items in bodies.items()}
    guessed = {}
    for frame, inertia in found.items():
        mass = source.masses.get(model.frames[frame].name)
        if mass is None and inertia.mass > 0.0:
            guessed[frame] = inertia
        elif mass is not None:
            found[frame] = _of_mass(inertia, mass, model.frames[frame].name)
    if not guessed and not source.masses:
        return source, None
    tree = ET.fromstring(source.urdf)
    links = {link.get("name"): link for link in tree.findall("link")}
    for frame, inertia in found.items():
        if inertia.mass > 0.0:
            place = model.frames[frame]
            model.appendBodyToJoint(place.parentJoint, inertia, place.placement)
            _write(links[place.name], inertia)
    source = replace(source, urdf=ET.tostring(tree, encoding="unicode"))
    if not guessed:
        return source, None
    told = [f"{model.frames[frame].name} {inertia.mass:.3g} kg" for frame, inertia in guessed.items()]
    more = f" and {len(told) - MAX_TOLD} more" if len(told) > MAX_TOLD else ""
    note = (
        f"links that joints move have no masses; they were guessed from collision bodies, at {DENSITY:g} kg/m^3: "
        f"{', '.join(told[:MAX_TOLD])}{more}: what they ask of the motors is a guess; write <inertial> into the links"
    )
    return source, note


def _of_mass(inertia: Any, mass: float, link: str) -> Any:
    """Scale an inertia to a mass [kg]."""
    if not inertia.mass > 0.0:
        raise RobotError(
            f"the bodies of '{link}' have no volume, over which its mass could be spread",
            way_out="give it a body that is not flat",
        )
    share = mass / inertia.mass
    return pin.Inertia(mass, np.array(inertia.lever), share * np.array(inertia.inertia))


def _inertia(items: Iterable[Any], link: Any) -> Any:
    """Return the inertia of collision bodies in their link's frame. The placement of the link is given."""
    total = pin.Inertia.Zero()
    for item in items:
        shape = item.geometry
        if isinstance(shape, coal.BVHModelBase):
            try:
                shape.buildConvexHull(True, "Qt")
            except RuntimeError:  # flat
                continue
            shape = shape.convex
        volume = shape.computeVolume()
        own = pin.Inertia(
            DENSITY * volume,
            np.array(shape.computeCOM()),
            DENSITY * np.array(shape.computeMomentofInertiaRelatedToCOM()),
        )
        total += link.actInv(item.placement).act(own)
    return total


def _write(link: ET.Element, inertia: Any) -> None:
    """Write an inertia into a link of a URDF."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in inertia.lever))
    ET.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    ET.SubElement(
        inertial, "inertia", {key: repr(float(inertia.inertia[row, column])) for key, row, column in MOMENTS}
    )
