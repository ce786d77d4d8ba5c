"""The variants of the dynamic movement primitive in one notation.

In unit duration, with goal g, start y0, displacement d = g - y0 and that of the demonstration d*:

============= ============================================================== =============== ===================
variant       y'' = alpha_y (beta_y (g - y) - y') + ...                      forcing functions  A(d)
============= ============================================================== =============== ===================
closed-form   f                                                              Gaussians       1
classic       A f                                                            Gaussians       diag(d / d*)
pastor        f - alpha_y beta_y d x                                         Gaussians       1
dmp++         A f - alpha_y beta_y d x                                       mollifiers      \\|d\\|/\\|d*\\| R(d*, d)
rhythmic      f, periodic                                                    von Mises       1
============= ============================================================== =============== ===================

with ``f(s) = psi(s) w`` and the phase x. All of them meet both ends exactly: there are two more forcing functions
than free weights for this purpose (one more, for the mean, in a rhythmic cycle). R is the smallest rotation that
turns the direction of d* into that of d.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import similarity
from comove.primitives.arguments import NamedOption
from comove.primitives.basis import MotionBasis, motion_basis
from comove.primitives.forcing import mollifiers
from comove.primitives.phase import ExponentialPhase, Phase
from comove.primitives.rhythm import RhythmicBasis, rhythmic_basis

Array = NDArray[np.float64]

NO_WAY = 1e-9  # displacements below this share of the movement's extent count as none


class Variant(NamedOption):
    """A variant of the dynamic movement primitive.

    CLOSED_FORM
        The shape is added to the motion to the goal and does not depend on it: moving the goal bends the movement
        smoothly (Li et al., 2023, have the same boundary conditions in closed form). The default.
    CLASSIC
        The shape scales with the displacement, dimension by dimension (Ijspeert et al., 2013): it is mirrored where
        the displacement changes sign, vanishes where the goal is the start, and grows without bound where the
        demonstration's ends nearly coincide. A dimension whose recorded ends coincide is not learned.
    PASTOR
        As the closed form, but the attraction of the goal fades in (Hoffmann et al., 2009; Pastor et al., 2009), so
        the start is gentle for far goals.
    DMP_PLUS_PLUS
        The whole movement turns and scales with the displacement (Ginesi et al., 2021): the path is similar to
        the taught one, and shrinks to a point where the goal is the start. Where the recorded ends coincide there is
        no displacement to compare with, and the shape stays as it is.
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
        """Return the default phase of `DMP.fit`: for the forms of the literature, one that falls to a hundredth."""
        return ExponentialPhase() if self is Variant.CLOSED_FORM else ExponentialPhase(alpha=4.6)

    def basis(self, n_basis: int, phase: Phase) -> MotionBasis | RhythmicBasis:
        """Return the matrices from which rollouts of this variant are computed."""
        return _BASES[self](n_basis, phase=phase)

    def scaling(self, learned: Array, displacement: Array, extent: float) -> Array:
        """Return A(d), the matrix that multiplies the learned forcing term; array, shape (n_dims, n_dims).

        Parameters
        ----------
        learned, displacement : arrays, shape (n_dims,), d* and d
        extent : size of the learned movement; displacements far below it count as zero
        """
        n_dims, none = len(learned), NO_WAY * extent
        if self is Variant.CLASSIC:
            taught = np.abs(learned) > none
            return np.diag(np.where(taught, displacement / np.where(taught, learned, 1.0), 0.0))
        if self is Variant.DMP_PLUS_PLUS and np.linalg.norm(learned) > none:
            return similarity(learned, displacement)
        return np.eye(n_dims)


_BASES: dict[Variant, Callable[..., MotionBasis | RhythmicBasis]] = {
    Variant.CLOSED_FORM: motion_basis,
    Variant.CLASSIC: motion_basis,
    Variant.PASTOR: partial(motion_basis, fading_goal=True),
    Variant.DMP_PLUS_PLUS: partial(motion_basis, kernels=mollifiers, fading_goal=True),
    Variant.RHYTHMIC: lambda n_basis, phase: rhythmic_basis(n_basis),
}
