"""Efforts of searches that follow one another, against sums over their events."""

from dataclasses import replace
from functools import reduce

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from comove.planning.solution import SearchEffort
from tests.cases import examples
from tests.solved import solved


@examples(50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_of_searches_one_after_the_other_the_first_verified_motion_counts(seed, n):
    """However they are grouped, work adds up, and the time is that of the first verified motion on one clock."""
    rng = np.random.default_rng(seed)
    seconds, found = rng.uniform(0.1, 2.0, n), rng.random(n) < 0.5
    first = rng.uniform(0.0, seconds)
    each = [SearchEffort(i, 2 * i, seconds[i], 0.5 * i, first[i] if found[i] else None) for i in range(n)]
    whole = reduce(lambda earlier, later: later.after(earlier), each)
    grouped = reduce(lambda later, earlier: later.after(earlier), reversed(each))
    total = n * (n - 1) // 2
    assert (whole.evaluations, whole.generations, whole.work) == (total, 2 * total, 0.5 * total)
    clock = (np.cumsum(seconds) - seconds + first)[found]
    for effort in (whole, grouped):
        np.testing.assert_allclose(effort.seconds, seconds.sum(), rtol=1e-12)
        if not found.any():
            assert effort.first_verified is None
        else:
            np.testing.assert_allclose(effort.first_verified, clock.min(), rtol=1e-12)


def test_a_solution_that_is_not_verified_has_no_first_verified_motion():
    """A motion that was verified before, of another duration, is not one of its own."""
    found = solved("wide")
    missed = replace(found, motion=None, effort=replace(found.effort, first_verified=None))
    assert missed.after(found).effort.first_verified is None
    late = found.after(missed).effort
    assert late.first_verified == missed.effort.seconds + found.effort.first_verified
    assert found.after(found).effort.first_verified == found.effort.first_verified
