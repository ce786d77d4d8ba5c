"""Shared by all tests."""

import gc
import os
import re
import signal

import pytest
from hypothesis import settings

from comove.processes import ALONE
from tests.cases import OFTEN, leave_few

MANY = 1000

# Every core runs tests: helpers that compile would only compile the same twice, and threads of linear algebra wait.
for variable in (ALONE, "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A shell starts background jobs, and so these tests perhaps, with interrupts ignored; the commands that tests start
# would inherit it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time; `pytest --hypothesis-profile=explore` looks for new ones.
settings.register_profile("explore", deadline=None, max_examples=OFTEN)
settings.register_profile("thorough", deadline=None, max_examples=OFTEN, derandomize=True)
settings.register_profile("quick", deadline=None, max_examples=OFTEN // 6, derandomize=True)
settings.load_profile("quick")

# What is imported and collected stays to the end: it is no garbage, and need not be searched for any.
gc.disable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark slow tests before pytest looks for marks."""
    leave_few(items)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Share out tests by files, those of the documents by pages, whose blocks use what earlier ones left."""
    from xdist.scheduler import LoadFileScheduling

    class ByPages(LoadFileScheduling):
        def _split_scope(self, nodeid):
            page = re.search(r"test_docs\.py::.*\[([\w-]+\.md)-", nodeid)
            return page[1] if page else super()._split_scope(nodeid)

    return ByPages(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_collection_finish(session):
    """Search for garbage in all that comes; where many tests are shared out, share out what they compile as well."""
    gc.collect()
    gc.freeze()  # all of it joins the oldest generation; what stays frozen is counted at every compilation
    gc.unfreeze()
    gc.enable()
    if len(session.items) > MANY:
        from tests.warming import warm_up

        warm_up(os.environ.get("PYTEST_XDIST_WORKER"))
