"""Every job leaves a row, whatever its system does; what is lost otherwise is tested of studies and pools."""

import pytest

from comove.errors import OptionError
from comove.lab.bench.runner import jobs_of, run_all
from comove.lab.bench.sets import scenes_of
from comove.lab.bench.store import RunStore
from tests.lab.bench.systems import Killer, Thrower, Witnessed


def drive(store, *systems):
    """Run the first scenes of the easy set; return what is told of the progress."""
    jobs = jobs_of(scenes_of("easy", 4), {system.name: system for system in systems}, budget=0.1)
    told = []
    run_all(store, jobs, 2, told.append)
    return [progress.done for progress in told]


def told(store):
    """What a store holds but for times, in an order that does not matter."""
    return sorted(
        (r.configuration.system, r.configuration.scene, r.status, r.message, r.figures.cost)
        for r in RunStore.open(store).runs()
    )


@pytest.mark.slow
def test_three_kills_mark_a_run_and_the_rest_goes_on(tmp_path):
    store = tmp_path / "runs.sqlite"
    assert drive(store, Witnessed(), Killer()) == list(range(9))
    rows = told(store)
    assert len(rows) == 8
    assert [row[:4] for row in rows if row[2] != "verified"] == [
        ("killer", "planar-01", "killed", "its process was killed 3 times")
    ]
    assert drive(store, Witnessed(), Killer()) == [8]
    assert told(store) == rows


@pytest.mark.slow
def test_what_throws_refuses_or_offers_nothing_is_a_row(tmp_path):
    store = tmp_path / "runs.sqlite"
    drive(store, Thrower())
    refused = ("thrower", "refused", "it is in space", None)
    assert [(r[0], *r[2:]) for r in told(store)] == [
        ("thrower", "error", "ValueError: no idea", None),
        ("thrower", "error", "SystemExit: gone", None),
        refused,
        refused,
    ]


@pytest.mark.parametrize(
    ("options", "named"),
    [({"seeds": 0}, "--seeds"), ({"budget": 0.0}, "--budget"), ({"budget": float("nan")}, "--budget")],
)
def test_options_that_make_no_sense(options, named):
    with pytest.raises(OptionError, match=named):
        jobs_of(scenes_of("easy", 2), {}, **options)


def test_nothing_to_run(tmp_path):
    with pytest.raises(OptionError, match="nothing to run"):
        run_all(tmp_path / "runs.sqlite", [])
