"""Masses of links: of hands, and those that a model does not state, guessed from collision bodies.

They are guessed only where nothing that a joint moves has a mass: models often give a link's mass to its neighbour.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.robots.urdf import Source

DENSITY = 1000.0  # kg/m^3
MAX_TOLD = 6
MOMENTS = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))


def moved_masses(model: Any) -> NDArray[np.float64]:
    """Return the masses that the joints of a model move; array, shape (n_joints + 1,), the universe first [kg]."""
    masses = np.array([inertia.mass for inertia in model.inertias])
    for joint in range(model.njoints - 1, 0, -1):
        masses[model.parents[joint]] += masses[joint]
    return masses


def mass_beyond(joint: str, sources: Iterable[Source]) -> float:
    """Return the mass of all links beyond the one that a joint moves [kg]: of the hand, if it is an arm's last."""
    tree = next(tree for tree in (ET.fromstring(source.urdf) for source in sources) if _has(tree, joint))
    below, link = dict[str, list[str]](), ""
    for each in tree.findall("joint"):
        parent, child = (end.get("link", "") for tag in ("parent", "child") for end in each.findall(tag))
        below.setdefault(parent, []).append(child)
        link = child if each.get("name") == joint else link
    beyond = list(below.get(link, []))
    for name in beyond:
        beyond += below.get(name, [])
    masses = {
        each.get("name", ""): float(mass.get("value", "0"))
        for each in tree.findall("link")
        for mass in each.findall("inertial/mass")
    }
    return sum(masses.get(name, 0.0) for name in beyond)


def _has(tree: ET.Element, joint: str) -> bool:
    return any(each.get("name") == joint for each in tree.findall("joint"))


def with_guessed_masses(source: Source, model: Any, geometry: Any) -> tuple[Source, str | None]:
    """Give masses to the links of joints that move none, in a model and in its URDF.

    Parameters
    ----------
    model : pinocchio.Model of the source, which is changed
    geometry : pinocchio.GeometryModel of its collision bodies

    Returns
    -------
    the source with these masses, and a note about them; None where there was nothing to guess
    """
    massless, bodies = moved_masses(model) == 0.0, dict[int, list[Any]]()
    for item in geometry.geometryObjects:
        if item.parentJoint > 0 and massless[item.parentJoint]:
            bodies.setdefault(item.parentFrame, []).append(item)
    guessed = {frame: _inertia(items, model.frames[frame].placement) for frame, items in bodies.items()}
    guessed = {frame: inertia for frame, inertia in guessed.items() if inertia.mass > 0.0}
    if not guessed:
        return source, None
    tree = ET.fromstring(source.urdf)
    links = {link.get("name"): link for link in tree.findall("link")}
    for frame, inertia in guessed.items():
        place = model.frames[frame]
        model.appendBodyToJoint(place.parentJoint, inertia, place.placement)
        _write(links[place.name], inertia)
    told = [f"{model.frames[frame].name} {inertia.mass:.3g} kg" for frame, inertia in guessed.items()]
    more = f" and {len(told) - MAX_TOLD} more" if len(told) > MAX_TOLD else ""
    note = (
        f"links that joints move have no masses; they were guessed from collision bodies, at {DENSITY:g} kg/m^3: "
        f"{', '.join(told[:MAX_TOLD])}{more}: what they ask of the motors is a guess; write <inertial> into the links"
    )
    return replace(source, urdf=ET.tostring(tree, encoding="unicode")), note


def _inertia(items: Iterable[Any], link: Any) -> Any:
    """Return the inertia of collision bodies in the frame of their link, whose placement is given."""
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
