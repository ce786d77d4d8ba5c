"""The variants of the dynamic movement primitive in one notation.

In unit duration, with goal g, start y0, displacement d = g - y0 and that of the demonstration d*:

============= ============================================================== =============== ====================
variant       y'' = alpha_y (beta_y (g - y) - y') + ...                      forcing functions  A(d)
============= ============================================================== =============== ====================
closed-form   f                                                              Gaussians       1
classic       A f                                                            Gaussians       diag(d / d*)
pastor        f - alpha_y beta_y d x                                         Gaussians       1
dmp++         A f - alpha_y beta_y d x                                       mollifiers      adaptation(d*, d)
rhythmic      f, periodic                                                    von Mises       1
============= ============================================================== =============== ====================

with ``f(s) = psi(s) w`` and the phase x. All of them meet both ends exactly: there are two more forcing functions
than free weights for this purpose (one more, for the mean, in a rhythmic cycle).

A similarity that maps d* to d, ``S = |d|/|d*| R`` with the smallest rotation R, has no bound where the learned
movement is nearly closed: it divides by d*, whose length and direction are then those of noise. With the extent E of
the learned movement, the greatest distance between two of its points, and ``r = |d*| / E``, `adaptation` is

    A = (1 - b) 1 + b S,   b = r / APART (r - CLOSED) / (APART - CLOSED) from r = CLOSED to APART,

the identity below and S itself above. The contribution of S has the size ``b |d|/|d*|``, which so rises linearly in
d*: no other b from 0 to 1 between the same ends has a smaller Lipschitz constant. A convex combination of both
matrices, unlike a product of partial scales and turns, is continuous in the plane also where d and d* are opposite;
in space it jumps there by b times the jump of R. A commutes with rotations, and its norm is at most 6/5 of the larger
of 1 and ``|d| / (APART E)``: no shape grows beyond 6/5 of the larger of its own size and 1 / APART displacements.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import NamedOption
from comove.dmp.basis import MotionBasis, motion_basis
from comove.dmp.rhythm import RhythmicBasis, rhythmic_basis
from comove.dmp.system import ExponentialPhase, Phase, mollifiers
from comove.geometry.rotations import similarity

NO_WAY = 1e-9  # displacements below this share of the movement's extent count as none

CLOSED, APART = 0.05, 0.2
"""Displacements, as shares of a movement's extent: up to the first one it is not scaled and turned, from the second
on in full.

People close a movement to a few hundredths of its extent. A similar movement spans ``|d| / r``, so that the second
number bounds it by 5 times the wanted displacement; all 210 recordings of the LASA handwriting set lie above it, at
0.23 or more.
"""

LARGE = 3.0
"""Scale of an adapted movement beyond which the user is warned."""


class Variant(NamedOption):
    """A variant of the dynamic movement primitive.

    CLOSED_FORM
        The shape is added to the motion to the goal and does not depend on it: moving the goal bends the movement
        smoothly (Li et al., 2023, have the same boundary conditions in closed form). The default.
    CLASSIC
        The shape scales with the displacement, dimension by dimension (Ijspeert et al., 2013): it is mirrored where
        the displacement changes sign, vanishes where the goal is the start, and grows without bound where the
        demonstration's ends nearly coincide, of which `DMP.towards` warns. A dimension whose recorded ends coincide
        is not learned.
    PASTOR
        As the closed form, but the attraction of the goal fades in (Hoffmann et al., 2009; Pastor et al., 2009), so
        the start is gentle for far goals.
    DMP_PLUS_PLUS
        The whole movement turns and scales with the displacement (Ginesi et al., 2021): the path is similar to the
        demonstrated one, and shrinks to a point where the goal is the start. Where the recorded ends nearly coincide
        (`APART`), the shape is scaled and turned less, and up to `CLOSED` it stays as it is.
    RHYTHMIC
        A limit cycle about the goal (Ijspeert et al., 2013); `duration` is the period.
    """

    CLOSED_FORM = "closed-form"
    CLASSIC = "classic"
    PASTOR = "pastor"
    DMP_PLUS_PLUS = "dmp++"
    RHYTHMIC = "rhythmic"

    @property
    def usual_phase(self) -> Phase:
        """Return the default phase of `DMP.fit`. In the forms of the literature it falls to a hundredth."""
        return ExponentialPhase() if self is Variant.CLOSED_FORM else ExponentialPhase(alpha=4.6)

    def basis(self, n_basis: int, phase: Phase) -> MotionBasis | RhythmicBasis:
        """Return the matrices from which rollouts of this variant are computed."""
        return _BASES[self](n_basis, phase=phase)

    def scaling(self, learned: Array, displacement: Array, extent: float) -> Array:
        """Return A(d), the factor of the learned forcing term; (n_dims, n_dims).

        Parameters
        ----------
        learned, displacement : arrays, shape (n_dims,), d* and d
        extent : greatest distance between two points of the learned movement
        """
        none = NO_WAY * extent
        if self is Variant.CLASSIC:
            taught = np.abs(learned) > none
            return np.diag(np.where(taught, displacement / np.where(taught, learned, 1.0), 0.0))
        if self is Variant.DMP_PLUS_PLUS:
            return adaptation(learned, displacement, extent)
        return np.eye(len(learned))


def adaptation(learned: Array, displacement: Array, extent: float) -> Array:
    """Return the matrix that adapts a movement to other ends. See the notes of this module.

    Parameters
    ----------
    learned, displacement : arrays, shape (n_dims,), from start to goal, of the learned movement and wanted [m]
    extent : greatest distance between two points of the learned movement [m]

    Returns
    -------
    array, shape (n_dims, n_dims)
    """
    share = scaled_share(learned, extent)
    if share == 0.0:
        return np.eye(len(learned))
    similar = similarity(learned, displacement)
    return similar if share == 1.0 else (1.0 - share) * np.eye(len(learned)) + share * similar


def scaled_share(displacement: Array, extent: float) -> float:
    """Return the share b of the similarity: 0 up to `CLOSED`, 1 from `APART` extents on."""
    length = float(np.linalg.norm(displacement))
    if length >= APART * extent:
        return 1.0 if length > 0.0 else 0.0
    share = length / extent
    return share / APART * max(share - CLOSED, 0.0) / (APART - CLOSED)


def extent_of(points: Array) -> float:
    """Return the greatest distance between two points, shape (n, n_dims)."""
    apart = points[:, None] - points[None]
    return float(np.sqrt((apart**2).sum(axis=2).max(initial=0.0)))


_BASES: dict[Variant, Callable[..., MotionBasis | RhythmicBasis]] = {
    Variant.CLOSED_FORM: motion_basis,
    Variant.CLASSIC: motion_basis,
    Variant.PASTOR: partial(motion_basis, fading_goal=True),
    Variant.DMP_PLUS_PLUS: partial(motion_basis, kernels=mollifiers, fading_goal=True),
    Variant.RHYTHMIC: lambda n_basis, phase: rhythmic_basis(n_basis),
}
