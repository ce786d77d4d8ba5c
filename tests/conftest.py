"""Shared by all tests."""

from hypothesis import settings

# The same examples every time; `pytest --hypothesis-profile=explore` looks for new ones.
settings.register_profile("explore", deadline=None)
settings.register_profile("comove", deadline=None, derandomize=True)
settings.load_profile("comove")
