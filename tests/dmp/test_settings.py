"""Settings of primitives: what cannot be followed is refused at once, by the name of its field."""

from types import SimpleNamespace

import numpy as np
import pytest

from comove.dmp import DMP, PoseProMP, slowed
from comove.dmp.alignment import WarpingSettings
from comove.dmp.estimation import EstimationSettings
from comove.dmp.pacing import PacingSettings
from comove.errors import DemonstrationError, OptionError


@pytest.mark.parametrize(
    ("settings", "name", "value"),
    [
        (PacingSettings, "n_rounds", 0),
        (PacingSettings, "margin", np.nan),
        (WarpingSettings, "n_instants", 2.5),
        (EstimationSettings, "n_folds", 1),
        (EstimationSettings, "lengths", ()),
        (EstimationSettings, "lengths", (0.1, -1.0)),
    ],
)
def test_what_cannot_be_followed_is_refused(settings, name, value):
    with pytest.raises(OptionError) as refused:
        settings(**{name: value})
    assert refused.value.key == name


def test_absurd_limits_end_too():
    """Limits so small that halving them is rounding."""
    still = np.zeros(2)
    dmp = DMP(np.zeros((2, 5)), still, np.ones(2), still, still, 2.0)
    with np.errstate(all="ignore"):
        slowed(dmp, acceleration=1e-307)


def test_an_orientation_that_is_none_is_named():
    takes = [_turning(seed) for seed in range(3)]
    takes[1].orientation[3] = 0.0
    with pytest.raises(DemonstrationError, match="recording 1 has an orientation that is none"):
        PoseProMP.fit(takes, n_basis=5)


def _turning(seed):
    time, angle = np.linspace(0.0, 1.0, 60), 0.1 * np.linspace(0.0, 1.0 + 0.1 * seed, 60)
    zero = np.zeros_like(angle)
    return SimpleNamespace(
        time=time,
        position=np.stack([time, 0.01 * seed * time, zero], axis=1),
        orientation=np.stack([np.cos(angle), np.sin(angle), zero, zero], axis=1),
        unit="m",
    )
