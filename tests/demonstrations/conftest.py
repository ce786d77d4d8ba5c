"""Shared by the tests of this room."""

import re

import pytest

from comove.errors import DemonstrationError


@pytest.fixture
def refused():
    """Assert that a reader refuses a file and says where, what and the way out."""

    def check(read, path, *, key, says, way_out):
        with pytest.raises(DemonstrationError) as caught:
            read(path)
        error = caught.value
        assert str(error.file) == str(path)
        assert error.key == key
        assert re.search(says, error.message), error.message
        assert re.search(way_out, error.way_out), error.way_out

    return check
