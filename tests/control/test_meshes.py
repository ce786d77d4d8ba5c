"""Meshes in executions: what is seen and recorded is by obstacle of the file, whatever stands for a mesh."""

import numpy as np
import pytest

from comove.control import Executor, Functions, Measured, Sensor, write_run
from comove.control.observers import Known, going_on
from comove.control.safety.cbf_qp import Sighting
from comove.errors import OptionError
from comove.lab.modulation.obstacles import level_obstacle
from comove.model import Scene
from comove.verification.record import verify_execution
from comove.view.figures.run import draw_run
from tests.meshes import l_profile, ring, write_obj


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Three hands carry an L past a ring that crosses its way, and a ball that stands."""
    folder = tmp_path_factory.mktemp("meshes")
    write_obj(folder / "l.obj", *l_profile())
    write_obj(folder / "ring.obj", *ring(n=10))
    grasps = {"a": [0.02, 0.19, 0.03], "b": [0.29, 0.025, 0.03], "c": [0.02, 0.02, 0.03]}
    return Scene.from_dict(
        {
            "name": "three",
            "duration": 5.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1.6, 1, 0.8]},
            "obstacles": [
                {"shape": "sphere", "center": [0.8, 0.15, 0.4], "radius": 0.05},
                {
                    "shape": "mesh",
                    "file": "ring.obj",
                    "center": [0.8, 0.85, 0.33],
                    "motion": {"velocity": [0.0, -0.08, 0.0]},
                },
            ],
            "load": {"shape": "mesh", "file": "l.obj", "grasps": grasps},
            "manipulators": [
                {
                    "name": n,
                    "start": list(np.add(g, [0.1, 0.4, 0.3])),
                    "goal": list(np.add(g, [1.2, 0.5, 0.3])),
                }
                for n, g in grasps.items()
            ],
            "limits": {"speed": 0.6, "acceleration": 2.0, "clearance": 0.01},
        },
        folder=folder,
    )


def observers(scene):
    true = Functions.of_motions(scene)
    return {
        "known": Known(scene),
        "seen": true,
        "measured": Measured(true, scene, Sensor(noise=0.001), np.random.default_rng(0)),
    }


@pytest.mark.slow
@pytest.mark.parametrize("observer", ["known", "seen"])
def test_executions_among_meshes_arrive_and_are_recorded_by_obstacle(scene, observer, tmp_path):
    executor = Executor(scene, observers(scene)[observer])
    record = executor.run(20.0)
    report = verify_execution(record, executor.blocker)
    assert report.reasons == ()
    assert report.clearance_min >= scene.clearance
    assert report.distance_error_max < 1e-9
    assert record.obstacles.shape == (len(record.time), 2, 3)
    write_run(tmp_path, record, report, executor.log, seed=0, interrupted=False, wall_time_s=1.0)
    with np.load(tmp_path / "run.npz") as arrays:
        centers = arrays["obstacle_center"]
    assert centers.shape == (len(record.time), 2, 3)
    assert centers[-1, 1] == pytest.approx([0.8, 0.85 - 0.08 * record.time[-1], 0.33])
    assert set(executor.log.blocking) <= {-1, 0, 1}
    draw_run(record)


def test_a_sighting_has_a_row_for_each_polytope(scene):
    n = len(scene.obstacles)
    assert n > 2
    for observer in observers(scene).values():
        seen = observer.observe(1.0)
        assert seen.table.shape == scene.obstacles.shape
        assert seen.velocity.shape == seen.spin.shape == (n, 3)
        assert seen.margin.shape == (n,)
        assert seen.velocity[1:] == pytest.approx(np.tile(seen.velocity[1], (n - 1, 1)))
    seen = Known(scene).observe(1.0)
    assert seen.table[1:, 1:4] == pytest.approx(np.tile([0.8, 0.77, 0.33], (n - 1, 1)))
    ahead = going_on(scene, seen, np.zeros_like(seen.velocity), 1.0)
    assert len(ahead.motions) == 2
    assert ahead.obstacles_at(1.0) == pytest.approx(seen.table)
    assert Sighting.still(scene).table is scene.obstacles


def test_triangles_are_predicted_from_where_they_are_seen(scene):
    """Distances are those of the triangles, which the table of polytopes does not tell."""
    nodes = scene.nodes_at("start") + [0.6, 0.1, 0.0]
    for observer in (Known(scene), Functions.of_motions(scene)):
        ahead = going_on(scene, observer.observe(1.0), observer.bends(1.0), 1.0)
        for time in (1.0, 2.5):
            assert ahead.clearance_at(nodes, time)[0] == pytest.approx(
                scene.clearance_at(nodes, time)[0], abs=1e-6
            )


def test_functions_are_by_obstacle(scene):
    with pytest.raises(OptionError, match="3 functions for 2 obstacles"):
        Functions(scene, [None, None, None])


def test_the_modulation_takes_no_meshes(scene):
    level_obstacle(scene, 0)
    with pytest.raises(OptionError, match=r"obstacles\[1\] \(mesh\) has no level function"):
        level_obstacle(scene, 1)
