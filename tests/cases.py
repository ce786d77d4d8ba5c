"""Cases and examples of which a few are tried always, and all by `make test-all`."""

import pytest
from hypothesis import settings

OFTEN = 100  # examples that hypothesis tries where a test does not say how many


def leave_few(items):
    """Make the cases of tests marked `few(n)` slow, but for `n` of each, spread evenly over all of them.

    Parameters
    ----------
    items : the collected tests of pytest
    """
    cases = {}
    for item in items:
        if item.get_closest_marker("few"):
            cases.setdefault((item.path, item.originalname), []).append(item)
    for some in cases.values():
        (n,) = some[0].get_closest_marker("few").args
        always = {round(i * (len(some) - 1) / max(n - 1, 1)) for i in range(n)}
        for i, item in enumerate(some):
            if i not in always:
                item.add_marker(pytest.mark.slow)


def examples(n, **others):
    """Return hypothesis's settings for a test that tries `n` examples, or the share of them that the profile has."""
    return settings(max_examples=max(1, round(n * settings().max_examples / OFTEN)), **others)
