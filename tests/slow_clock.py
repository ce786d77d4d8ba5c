"""A processor clock that ticks by as much as a test likes, as on a machine that is slower, or that others load."""

import itertools
import time


def ticking(monkeypatch, seconds):
    """Let every reading of the processor time come some seconds after the one before."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: seconds * next(ticks))
