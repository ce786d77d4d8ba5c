"""Shared by the tests of this room."""

import re
import sys

import numpy as np
import pytest

from comove.dmp.demonstrations import Demonstration
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


@pytest.fixture
def cut_anywhere():
    """Assert that a file cut at any place, or at many, is refused in one sentence."""

    def check(read, file, step=1):
        content = file.read_bytes()
        for length in range(0, len(content), step):
            file.write_bytes(content[:length])
            with pytest.raises(DemonstrationError) as caught:
                read()
            assert str(file) in str(caught.value)
            assert "\n" not in str(caught.value)
            assert caught.value.way_out
        file.write_bytes(content)

    return check


@pytest.fixture
def damaged():
    """Assert that damaged bytes are read or told, never a traceback."""

    def check(read, file, n_times=60, seed=0):
        content, rng = file.read_bytes(), np.random.default_rng(seed)
        for _ in range(n_times):
            changed = bytearray(content)
            at = int(rng.integers(len(changed)))
            changed[at : at + int(rng.integers(0, 9))] = rng.choice([rng.bytes(1), rng.bytes(4), b"\xff" * 8])
            file.write_bytes(changed)
            try:
                demos = read()
            except DemonstrationError as error:
                assert error.way_out
                assert "\n" not in str(error)
            else:
                assert all(np.isfinite(demo.position).all() for demo in demos)
        file.write_bytes(content)

    return check


@pytest.fixture
def without(monkeypatch):
    """Make a library look as if it were not installed."""

    def hide(name):
        for module in [module for module in sys.modules if module.partition(".")[0] == name]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, name, None)

    return hide


@pytest.fixture
def hand():
    """Make a movement of a hand that turns, at even steps."""

    def make(seed=0, n_steps=12, rate=20.0, n_dims=3, turned=True, **changes):
        rng = np.random.default_rng(seed)
        position = np.cumsum(rng.normal(scale=0.01, size=(n_steps, n_dims)), axis=0)
        if turned:
            quaternions = np.cumsum(rng.normal(scale=0.05, size=(n_steps, 4)), axis=0) + [1.0, 0.0, 0.0, 0.0]
            changes["orientation"] = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        return Demonstration(np.arange(n_steps) / rate, position, **changes)

    return make
