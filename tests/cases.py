"""Cases and examples of which a few are tried always, and all by `make test-all`."""

import pytest
from hypothesis import settings

OFTEN = 100  # examples that hypothesis tries where a test does not say how many


def spread(cases, n):
    """Return all cases for `parametrize`; but for `n` of them, spread evenly over the list, they are slow."""
    cases = list(cases)
    always = {round(i * (len(cases) - 1) / max(n - 1, 1)) for i in range(n)}
    return [
        case if i in always else pytest.param(case, marks=pytest.mark.slow) for i, case in enumerate(cases)
    ]


def examples(n, **others):
    """Return hypothesis's settings for a test that tries `n` examples, or the share of them that the profile has."""
    return settings(max_examples=max(1, round(n * settings().max_examples / OFTEN)), **others)
