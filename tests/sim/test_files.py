"""Simulations in result folders."""

import json
from dataclasses import asdict
from functools import lru_cache

import numpy as np
import pytest

from comove.errors import ResultError
from comove.sim import SIMULATION, Friction, Perturbation, Weld, simulate, write_simulation
from tests.sim.benchmark import posts, standing


@lru_cache(maxsize=2)
def execution(grasp):
    robot, motion = standing()
    return simulate(motion, posts(), robot, grasp, Perturbation.drawn(np.random.default_rng(5), 14))


@pytest.mark.parametrize("grasp", [Weld(), Friction()])
def test_what_is_written_is_read_again(tmp_path, grasp):
    written = write_simulation(execution(grasp), tmp_path, seed=5)
    summary, series = SIMULATION.read(tmp_path, whole=True)
    assert summary == json.loads(json.dumps(written))
    for name, array in execution(grasp).series().items():
        assert np.array_equal(series[name], array)


def test_the_summary_says_what_happened_and_how_to_do_it_again(tmp_path):
    summary = write_simulation(execution(Friction()), tmp_path, seed=5)
    assert summary["delivered"] is True and summary["reasons"] == []
    assert summary["grasp"] == {"kind": "friction", "coefficient": 1.0, "force": None, "size": None}
    assert summary["seed"] == 5 and len(summary["perturbation"]["gains"]) == 14
    assert summary["scene_sha256"] == posts().sha256
    assert summary["versions"]["mujoco"]
    assert summary["slip_max"] < 2e-3
    again = Perturbation.drawn(np.random.default_rng(summary["seed"]), 14)
    assert json.loads(json.dumps(asdict(again))) == json.loads(json.dumps(summary["perturbation"]))


def test_nothing_but_the_files_is_left_in_the_folder(tmp_path):
    for _ in range(2):
        write_simulation(execution(Weld()), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"simulation.json", "simulation.npz"}


def test_edited_series_are_refused(tmp_path):
    write_simulation(execution(Weld()), tmp_path)
    with np.load(tmp_path / "simulation.npz") as archive:
        series = dict(archive)
    series["lag"] = series["lag"] * 0.5
    np.savez(tmp_path / "simulation.npz", **series)
    with pytest.raises(ResultError, match=r"its checksum is not the one in simulation\.json"):
        SIMULATION.read(tmp_path, whole=True)


def test_a_folder_without_a_simulation_is_told(tmp_path):
    with pytest.raises(ResultError, match=r"holds no simulation.json"):
        SIMULATION.read(tmp_path, whole=True)


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ResultError):
        write_simulation(execution(Weld()), tmp_path / "none")
