"""Shapes of obstacles, and their columns for the kernels of `levels`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields

import numpy as np

from comove.dmp.arguments import numbers, require_positive
from comove.errors import OptionError
from comove.geometry import distances as sd
from comove.lab.modulation.levels import SUPERQUADRIC


@dataclass(frozen=True)
class TableShape:
    """Shape in the kernels' table: KIND, SIZE, LEVEL, EXPONENT and REACH. Lengths are in metres."""

    kind: int
    size: tuple[float, ...]
    level: tuple[float, ...]
    reach: float
    exponent: tuple[float, ...] = ()


@dataclass(frozen=True)
class Shape(ABC):
    """Geometric shape of an obstacle, about its centre and axes.

    All attributes are positive numbers, or tuples of 2 or 3 of them; lengths in metres.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "float":
                require_positive(field.name, value)
            else:
                object.__setattr__(self, field.name, _lengths(field.name, value))

    @abstractmethod
    def in_table(self, n_dims: int, margin: float) -> TableShape:
        """Return the shape with a safety margin [m]. Raise `OptionError` if it is not one of `n_dims` dimensions."""


@dataclass(frozen=True)
class Sphere(Shape):
    """Circle in the plane, sphere in space, of `radius` [m]."""

    radius: float

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        return _rounded(sd.SPHERE, (self.radius,), self.radius, self.radius, margin)


@dataclass(frozen=True)
class Ellipsoid(Shape):
    """Ellipse in the plane, ellipsoid in space.

    With a margin it becomes the ellipsoid of least trace in a family of ellipsoids that contain the sum of the
    ellipsoid and a ball (Kurzhanski & Valyi, 1997): the margin is kept everywhere, and exceeded at some places.

    Attributes
    ----------
    radii : semi-axes, n_dims numbers [m]
    """

    radii: tuple[float, ...]

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        radii = np.array(_counted("radii", self.radii, n_dims))
        share = margin * np.sqrt(n_dims / (radii @ radii))
        axes = np.sqrt((1 + share) * radii**2 + (margin**2 + margin**2 / share if share else 0.0))
        return TableShape(sd.ELLIPSOID, tuple(radii), tuple(axes), float(axes.max()))


@dataclass(frozen=True)
class Superquadric(Shape):
    """Body of the points with sum |u_i / radii_i|^(2 exponents_i) <= 1.

    It is an ellipsoid for exponents of 1, and closer to a box for greater ones. With a margin all semi-axes grow by
    one factor, 1 + margin / least semi-axis, so that the margin is kept everywhere; at the ends of long semi-axes it
    is exceeded.

    Attributes
    ----------
    radii : semi-axes, n_dims numbers [m]
    exponents : n_dims numbers, at least 1
    """

    radii: tuple[float, ...]
    exponents: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.exponents) < 1.0:
            raise OptionError(
                f"exponents {self.exponents} below 1",
                key="exponents",
                way_out="give numbers from 1 on: below it the surface has a kink",
            )

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        radii = np.array(_counted("radii", self.radii, n_dims))
        exponents = _counted("exponents", self.exponents, n_dims)
        axes = radii * (1 + margin / radii.min())
        return TableShape(SUPERQUADRIC, tuple(radii), tuple(axes), float(np.linalg.norm(axes)), exponents)


@dataclass(frozen=True)
class Box(Shape):
    """Rectangle in the plane, box in space; a margin rounds its edges.

    Attributes
    ----------
    size : full edge lengths, n_dims numbers [m]
    """

    size: tuple[float, ...]

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        half = tuple(edge / 2 for edge in _counted("size", self.size, n_dims))
        return _rounded(sd.BOX, half, min(half), float(np.linalg.norm(half)), margin)


@dataclass(frozen=True)
class Capsule(Shape):
    """Segment of `length` thickened by `radius` [m]. It lies along its own x in the plane, its own z in space."""

    radius: float
    length: float

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        half = self.length / 2
        return _rounded(sd.CAPSULE, (self.radius, half), self.radius, half + self.radius, margin)


@dataclass(frozen=True)
class Cylinder(Shape):
    """Cylinder of `radius` and `height` [m] along its own z. It is for space only; a margin rounds its edges."""

    radius: float
    height: float

    def in_table(self, n_dims: int, margin: float) -> TableShape:
        if n_dims != 3:
            raise OptionError(
                "a cylinder in the plane", key="shape", way_out="give a Sphere (its slice) or a Box"
            )
        half = self.height / 2
        size, reach = (self.radius, half), float(np.hypot(self.radius, half))
        return _rounded(sd.CYLINDER, size, min(size), reach, margin)


def _rounded(kind: int, size: tuple[float, ...], least: float, reach: float, margin: float) -> TableShape:
    return TableShape(kind, size, (least, least + margin), reach + margin)


def _lengths(name: str, values: object) -> tuple[float, ...]:
    array = numbers(values)
    if array.shape not in ((2,), (3,)) or not (np.isfinite(array) & (array > 0)).all():
        raise OptionError(f"{name} = {values!r}", key=name, way_out="give 2 or 3 positive numbers")
    return tuple(array.tolist())


def _counted(name: str, values: tuple[float, ...], n_dims: int) -> tuple[float, ...]:
    if len(values) != n_dims:
        raise OptionError(
            f"{len(values)} {name} in {n_dims} dimensions", key=name, way_out=f"give {n_dims} numbers"
        )
    return values
