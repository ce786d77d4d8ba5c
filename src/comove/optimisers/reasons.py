"""Reasons for the end of a search, with advice."""

from __future__ import annotations

from enum import Enum


class Reason(Enum):
    """Reason for the end of a run or of the whole search; the value describes it and gives advice."""

    CONVERGED = (
        "the steps or the differences between samples are below the tolerance; restarts may find better"
    )
    STAGNATED = "the samples' spread no longer shrinks; give a larger population or restarts"
    ILL_CONDITIONED = "the longest axis is 1e14 times the shortest in variance; rescale the variables"
    DIVERGED = "penalties outgrew the objective; give a smaller sigma0 or a feasible x0"
    STALLED = "resampling found no feasible samples; widen the bands, give a feasible x0 or another method"
    NOT_POSITIVE_DEFINITE = "the printed update lost positive definiteness; use another form"
    NOT_FINITE = "too few finite values; start where the objective and all constraints are finite"
    TARGET = "the target was reached"
    EVALUATIONS = "the evaluations are used up; give more, or a smaller sigma0 to begin nearer"
    SECONDS = "the time is used up; give more"
    CALLBACK = "the callback asked to stop"
