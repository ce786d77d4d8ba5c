"""Cases of which a few are tried always, and all by `make test-all`."""

import pytest


def spread(cases, n):
    """Return all cases for `parametrize`; but for `n` of them, spread evenly over the list, they are slow."""
    cases = list(cases)
    always = {round(i * (len(cases) - 1) / max(n - 1, 1)) for i in range(n)}
    return [
        case if i in always else pytest.param(case, marks=pytest.mark.slow) for i, case in enumerate(cases)
    ]
