"""Barriers: whoever approaches as fast as allowed brakes no harder than was assumed, and never arrives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.control.safety.cbf_constraints import against, horizon, rate
from comove.control.safety.qp_workspace import Rates

BRAKING, PASSING = 0.5, 3.0
RATES = Rates(0.004, 10.0, BRAKING, PASSING, 0.25, 0.5, 1.0, 0.01)


@given(st.floats(1e-4, 1.0), st.floats(0.5, 10.0), st.sampled_from([0.0, 0.3]))
def test_nobody_has_to_brake_harder_than_is_assumed(h, gain, fastest):
    own, rates = against(gain, fastest, RATES)
    assumed, step = (PASSING if fastest else BRAKING), 1e-6 * h
    slope = (rate(h + step, own, rates) - rate(h - step, own, rates)) / (2 * step)
    assert slope * rate(h, own, rates) <= assumed * (1 + 1e-6)
    assert 0.0 < rate(h, own, rates) <= np.sqrt(2 * assumed * h) + 1e-12
    assert horizon(rate(h, own, rates), own, rates) == pytest.approx(h, rel=1e-6)


@given(st.floats(-0.1, 1.0), st.floats(0.5, 10.0))
def test_what_stands_is_approached_as_ever_and_what_moves_no_slower(h, gain):
    still, moving = against(gain, 0.0, RATES), against(gain, 0.3, RATES)
    assert rate(h, *still) == rate(h, gain, RATES)
    assert abs(rate(h, *moving)) >= abs(rate(h, *still))
    usual = RATES._replace(passing=BRAKING)
    assert rate(h, *against(gain, 0.3, usual)) == rate(h, gain, usual)
