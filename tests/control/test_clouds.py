"""Obstacles seen as clouds: all points held, motions found, margins that cover the truth, loads that arrive."""

from functools import cache

import numpy as np
import pytest

from benchmarks.random_scenes import moving_scene
from comove.control import Association, Clouds, Executor, Known, Scanned, Scanner
from comove.control.clouds import surface
from comove.control.safety.twists import nodes_of, poses_of
from comove.errors import OptionError
from comove.geometry import distances as sd
from comove.model import Scene
from comove.verification.record import verify_execution
from tests.control.test_executor import crossing, disc
from tests.meshes import hull, write_obj
from tests.verification.random_motions import scene_data

RING = np.stack([np.cos(np.linspace(0, 6.28, 60)), np.sin(np.linspace(0, 6.28, 60))], axis=1)


@cache
def unobstructed():
    """Two hands carry a bar across an empty square."""
    return crossing()


def in_space(*obstacles, load=None, **more):
    """Two hands carry a bar across an empty cube, or another load."""
    hands = [{"name": n, "start": [0.1, y, 0.5], "goal": [0.9, y, 0.5]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "cube",
            "duration": 4.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
            "obstacles": list(obstacles),
            "load": load or {"shape": "bar", "length": 0.2, "radius": 0.005},
            "manipulators": hands,
            "limits": {"speed": 0.5, "acceleration": 2.0, "clearance": 0.01},
            **more,
        }
    )


def seen_spheres(observer, time):
    """Centres, radii with margins, and velocities of what is not the file's."""
    seen, n = observer.observe(time), len(observer.scene.obstacles)
    return seen.table[n:, 1:4], seen.table[n:, sd.SIZE] + seen.margin[n:], seen.velocity[n:]


def uncovered(observer, time, points):
    """How many of some points, spatial, no sphere holds."""
    center, radius, _ = seen_spheres(observer, time)
    if not len(center):
        return len(points)
    return int(((np.linalg.norm(points[:, None] - center, axis=2) - radius).min(axis=1) > 0).sum())


def ring(center, radius=0.06):
    return np.array(center) + radius * RING


# What they see


@pytest.mark.parametrize("n_dims", [2, 3])
def test_all_points_are_held_at_the_instant_of_the_cloud(n_dims):
    rng, scene = np.random.default_rng(0), unobstructed() if n_dims == 2 else in_space()
    observer = Clouds(scene)
    for k in range(4):
        points = rng.uniform(0.0, 1.0, (300, n_dims))
        observer.update(points, 0.1 * k)
        assert uncovered(observer, 0.1 * k, np.pad(points, ((0, 0), (0, 3 - n_dims)))) == 0


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_a_rigid_cloud_gives_its_velocity(n_dims, shape):
    size = {"sphere": {"radius": 0.07}, "box": {"size": [0.15, 0.06, 0.1][:n_dims]}}
    size = size.get(shape, {"radius": 0.04, "length": 0.1})
    velocity = [-0.25, 0.1, -0.15][:n_dims]
    body = {"shape": shape, "center": [0.8, 0.8, 0.8][:n_dims], **size, "motion": {"velocity": velocity}}
    scene = crossing(body) if n_dims == 2 else in_space(body)
    observer = Scanned(Known(scene), scene, Scanner(agility=0.05), np.random.default_rng(0))
    errors = []
    for time in np.arange(0.0, 1.2, 0.01):
        observer.observe(time)
        if time > 0.4:
            found = seen_spheres(observer, time)[2]
            errors.append(np.abs(found[:, :n_dims] - velocity).max())
    assert max(errors) < 0.03
    assert np.mean(errors) < 0.01


MOTIONS = [
    [disc([0.9, 0.9], {"velocity": [-0.4, -0.3]})],
    [disc([0.7, 0.9], {"waypoints": [[0.7, 0.9], [0.7, 0.6], [0.3, 0.6]], "times": [0, 0.8, 1.8]})],
    [
        {
            "shape": "box",
            "center": [0.8, 0.5],
            "size": [0.2, 0.08],
            "motion": {"circle": {"radius": 0.15, "period_s": 3}},
        }
    ],
    [disc([0.4, 0.9], {"velocity": [0, -0.3]}, 0.05), disc([0.53, 0.2], {"velocity": [0, 0.3]}, 0.05)],
]


@pytest.mark.parametrize("obstacles", MOTIONS)
@pytest.mark.parametrize("scanner", [Scanner(), Scanner(noise=0.005, spacing=0.02, detail=0.04)])
def test_margins_cover_the_truth(obstacles, scanner):
    """Straight, round a corner, in a circle, and two that pass each other closely; between the clouds as well."""
    scene, out, total = crossing(*obstacles), 0, 0
    rng, truth = np.random.default_rng(0), Known(scene)
    observer = Scanned(truth, scene, scanner, rng, delay=0.05)
    for time in np.arange(0.0, 2.0, 0.01):
        observer.observe(time)
        if time < 0.15:  # three clouds
            continue
        for row, center in zip(scene.obstacles, truth.ground_truth(np.array([time]))[0], strict=True):
            row = row.copy()
            row[1:4] = center
            points = surface(row, 2, 0.01, rng)
            out, total = out + uncovered(observer, time, points), total + len(points)
    assert out / total < 0.005
    spare = observer.observe(2.0).margin[len(scene.obstacles) :]
    assert spare.max() < 0.1, "and are no excuse"


def test_what_turns_is_covered_too():
    observer, out, total = Clouds(unobstructed()), 0, 0
    bar = np.stack([np.linspace(-0.12, 0.12, 60), np.zeros(60)], axis=1)

    def turned(time):
        c, s = np.cos(2.0 * time), np.sin(2.0 * time)
        return [0.5, 0.5] + bar @ np.array([[c, s], [-s, c]])

    for k in range(200):
        if k % 5 == 0:
            observer.update(turned(0.01 * k), 0.01 * k)
        if k > 15:
            out += uncovered(observer, 0.01 * k, np.pad(turned(0.01 * k), ((0, 0), (0, 1))))
            total += len(bar)
    assert out / total < 0.005


def test_two_that_pass_closely_keep_their_velocities():
    scene = crossing(*MOTIONS[3])
    observer = Scanned(Known(scene), scene, None, np.random.default_rng(1))
    for time in np.arange(0.0, 2.3, 0.01):
        observer.observe(time)
        center, _, velocity = seen_spheres(observer, time)
        if time > 0.3:
            wanted = np.where(center[:, 0] < 0.465, -0.3, 0.3)
            assert np.abs(velocity[:, 1] - wanted).max() < 0.2


def test_two_that_come_apart_are_two():
    """They touch and move alike; then one stays behind."""
    observer = Clouds(unobstructed())
    for k in range(60):
        x = 0.2 + 0.015 * k
        stays = min(x, 0.45)
        observer.update(np.concatenate([ring([x + 0.13, 0.5]), ring([stays, 0.5])]), 0.05 * k)
        if k == 12:
            assert np.abs(seen_spheres(observer, 0.05 * k)[2][:, 0] - 0.3).max() < 0.03
        if k == 45:
            center, _, velocity = seen_spheres(observer, 0.05 * k)
            wanted = np.where(center[:, 0] < 0.6, 0.0, 0.3)
            assert np.abs(velocity[:, 0] - wanted).max() < 0.03


def test_what_goes_out_of_sight_is_kept_for_a_while_with_a_growing_margin():
    observer, scanner = Clouds(unobstructed()), Scanner()
    for k in range(20):
        observer.update(ring([0.3 + 0.01 * k, 0.5]), 0.05 * k)
    last, nothing = 0.95, np.zeros((0, 2))
    margins = []
    for lapse in (0.1, 0.2, 0.4):
        observer.update(nothing, last + lapse)
        center, _, velocity = seen_spheres(observer, last + lapse)
        np.testing.assert_allclose(center, [[0.49 + 0.2 * lapse, 0.5, 0.0]], atol=0.02)
        np.testing.assert_allclose(velocity, [[0.2, 0.0, 0.0]], atol=0.05)
        margins.append(observer.observe(last + lapse).margin[0])
    assert (np.diff(margins) > 0.02).all()
    observer.update(nothing, last + scanner.memory + 0.06)
    assert len(seen_spheres(observer, 2.0)[0]) == 0


def test_what_is_half_hidden_is_kept_whole():
    observer = Clouds(unobstructed())
    wall = np.stack([np.full(60, 0.5), np.linspace(0.2, 0.8, 60)], axis=1)
    for k in range(10):
        observer.update(wall, 0.05 * k)
    observer.update(wall[:30], 0.5)
    assert uncovered(observer, 0.5, np.pad(wall, ((0, 0), (0, 1)))) == 0


def test_a_stray_point_is_forgotten_with_the_next_cloud():
    observer, body = Clouds(unobstructed()), ring([0.3, 0.5])
    for k in range(4):
        extra = [[0.8, 0.8]] if k == 2 else np.zeros((0, 2))
        observer.update(np.concatenate([body, extra]), 0.05 * k)
        assert len(seen_spheres(observer, 0.05 * k)[0]) == (2 if k == 2 else 1)


def test_what_comes_back_is_found_again():
    observer = Clouds(unobstructed())
    for k in range(30):
        hidden = 8 <= k < 13
        observer.update(np.zeros((0, 2)) if hidden else ring([0.2 + 0.015 * k, 0.5]), 0.05 * k)
        if k >= 5:
            center, _, velocity = seen_spheres(observer, 0.05 * k)
            np.testing.assert_allclose(center, [[0.2 + 0.015 * k, 0.5, 0.0]], atol=0.02)
            assert abs(velocity[0, 0] - 0.3) < 0.1


def test_margins_grow_until_a_cloud_comes_but_nothing_is_forgotten():
    observer = Clouds(unobstructed())
    for k in range(5):
        observer.update(ring([0.5, 0.5]), 0.05 * k)
    margins = [observer.observe(time).margin[0] for time in (0.2, 0.3, 1.0, 5.0)]
    assert margins[0] == 0.0
    assert (np.diff(margins) > 0).all()


# What they leave out


def test_the_obstacles_of_the_file_that_stand_remain_and_their_points_are_theirs():
    wall = {"shape": "box", "center": [0.5, 0.1], "size": [0.2, 0.1]}
    scene = crossing(disc([0.5, 0.9], {"velocity": [0, -0.2]}), wall)
    observer = Clouds(scene)
    observer.update(surface(scene.obstacles[1], 2, 0.01, np.random.default_rng(0))[:, :2], 0.0)
    seen = observer.observe(0.0)
    assert len(seen.margin) == 2
    np.testing.assert_array_equal(seen.table[1], scene.obstacles[1])
    assert np.linalg.norm(seen.table[0, 1:4]) > 1e3, "of what moves in the file clouds know nothing"
    assert observer.predict(0.0).name_of(1) == "obstacles[1] (box)"
    observer.update(ring([0.7, 0.7]), 0.1)
    assert observer.predict(0.1).name_of(2) == "something that was seen"
    assert np.isnan(observer.ground_truth(np.array([0.0, 1.0]))[:, 0]).all()


PLATE = {"shape": "box", "size": [0.2, 0.1], "grasps": {"left": [-0.1, 0.0], "right": [0.1, 0.0]}}
SOLID = {"shape": "box", "size": [0.2, 0.1, 0.08], "grasps": {"a": [-0.1, 0, 0], "b": [0.1, 0, 0]}}
LOADS = {
    "bar": unobstructed,
    "plate": lambda: crossing(load=PLATE),
    "bar in space": in_space,
    "solid": lambda: in_space(load=SOLID, constraints=[{"type": "upright"}]),
}


@pytest.mark.parametrize("name", LOADS)
def test_points_of_the_load_and_the_hands_are_left_out(name):
    leaves_out_the_load(LOADS[name]())


def test_points_of_a_mesh_that_is_carried_are_left_out(tmp_path):
    """A wedge, whose six corners are no box."""
    corners = [[x, y, z] for x in (-0.1, 0.1) for y, z in ((-0.05, 0.0), (0.05, 0.0), (0.0, 0.08))]
    write_obj(tmp_path / "wedge.obj", *hull(np.array(corners)))
    wedge = {"shape": "mesh", "file": "wedge.obj", "grasps": {"a": [-0.1, 0, 0], "b": [0.1, 0, 0]}}
    data = scene_data(in_space(constraints=[{"type": "upright"}])) | {"load": wedge}
    leaves_out_the_load(Scene.from_dict(data, folder=tmp_path))


def leaves_out_the_load(scene):
    """All over the load, against points far from it, by distances that are found by brute force."""
    observer, nodes = Clouds(scene, Scanner(own=0.015)), nodes_of(scene, poses_of(scene, "start"))
    observer.carried(0.0, nodes)
    rng, n = np.random.default_rng(0), scene.n_dims
    weights = rng.dirichlet(np.full(len(nodes), 0.3), 1000)
    inside = weights @ nodes  # the load is convex, or a bar
    on_load = inside + 0.01 * rng.uniform(-1, 1, inside.shape) / np.sqrt(3) * ([1, 1, 0] if n == 2 else 1)
    assert len(observer._others(on_load[:, :n], 0.0)) == 0
    around = rng.uniform(scene.lower, scene.upper, (1500, n))
    away = np.linalg.norm(np.pad(around, ((0, 0), (0, 3 - n)))[:, None] - inside, axis=2).min(axis=1)
    left = observer._others(around, 0.0)
    assert len(left) >= (away > 0.045).sum()
    assert np.linalg.norm(left[:, None] - inside, axis=2).min() > 0.014 - 1e-9


def test_late_clouds_are_held_against_where_the_load_was():
    observer = Clouds(unobstructed())
    for k in range(50):
        nodes = nodes_of(unobstructed(), poses_of(unobstructed(), "start"))
        observer.carried(0.01 * k, nodes + [0.005 * k, 0, 0])
    then = 0.353
    bar = np.stack([np.full(40, 0.15 + 0.5 * then), np.linspace(0.4, 0.6, 40)], axis=1)
    observer.update(bar, then)
    assert len(seen_spheres(observer, 0.5)[0]) == 0


def test_the_executor_says_where_the_load_is():
    scene = crossing(disc([0.5, 0.9], {"velocity": [0, -0.1]}))
    observer = Scanned(Known(scene), scene, None, np.random.default_rng(0))
    executor = Executor(scene, observer)
    for _ in range(30):
        executor.step()
        hands = nodes_of(scene, executor.poses)[:2]
        bar = hands[0] + np.linspace(0, 1, 50)[:, None] * (hands[1] - hands[0])
        assert uncovered(observer, executor.time, bar) == 50


# What is no cloud


def test_nan_and_what_is_far_away_are_ignored():
    observer, body = Clouds(unobstructed()), ring([0.3, 0.5])
    noise = [[np.nan, 0.5], [0.5, np.inf], [np.nan, np.nan], [3.0, 0.5], [0.5, -1e300]]
    observer.update(np.concatenate([body, noise]), 0.0)
    alone = Clouds(unobstructed())
    alone.update(body, 0.0)
    np.testing.assert_array_equal(observer.observe(0.1).table, alone.observe(0.1).table)


def test_clouds_from_the_past_are_ignored():
    observer = Clouds(unobstructed())
    observer.update(ring([0.3, 0.5]), 0.2)
    before = observer.observe(0.3)
    for time in (0.2, 0.1, -5.0):
        observer.update(ring([0.8, 0.5]), time)
    np.testing.assert_array_equal(observer.observe(0.3).table, before.table)


@pytest.mark.parametrize("empty", [[], np.zeros((0, 2)), [[np.nan, np.nan]]])
def test_empty_clouds_say_that_nothing_is_there(empty):
    observer = Clouds(unobstructed())
    for k in range(3):
        observer.update(empty, 0.1 * k)
        assert len(observer.observe(0.1 * k).margin) == 0
    assert len(Clouds(unobstructed()).observe(0.0).margin) == 0


@pytest.mark.parametrize(
    ("points", "time", "words"),
    [
        (np.zeros((5, 3)), 0.5, r"a cloud of shape \(5, 3\); give an array of shape \(n_points, 2\)"),
        (np.zeros(4), 0.5, r"a cloud of shape \(4,\)"),
        ("points", 0.5, r"a cloud of shape \(\)"),
        (np.zeros((5, 2)), float("nan"), "a cloud at nan s; give the time"),
        (np.zeros((5, 2)), None, "a cloud at None s"),
        (
            np.zeros((5, 2)),
            1.7e9,
            "lies in the future, it is 0.3 s; give times on the clock of the execution",
        ),
    ],
)
def test_what_is_no_cloud(points, time, words):
    observer = Clouds(unobstructed())
    observer.carried(0.3, nodes_of(unobstructed(), poses_of(unobstructed(), "start")))
    observer.update(ring([0.3, 0.5]), 0.2)
    before = observer.observe(0.4)
    with pytest.raises(OptionError, match=words):
        observer.update(points, time)
    np.testing.assert_array_equal(observer.observe(0.4).table, before.table)


@pytest.mark.parametrize(
    "wrong",
    [
        {"noise": 0.0},
        {"spacing": -1},
        {"own": float("nan")},
        {"memory": "1"},
        {"most": 0},
        {"most": 2.5},
        {"detail": 0.005},
        {"agility": float("inf")},
        {"fastest": True},
        {"deep": 1.5},
    ],
)
def test_scanners_that_are_none(wrong):
    of = Association if "deep" in wrong else Scanner
    with pytest.raises(OptionError, match=f"{next(iter(wrong))} = "):
        of(**wrong)


# What comes of it


@pytest.mark.parametrize(
    "seed", [4, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 5, 6, 7, 8, 9, 10))]
)
def test_a_load_arrives_by_clouds_alone(seed):
    """Discs, boxes and capsules, in the plane and in space; judged by where they really were."""
    scene = moving_scene(seed)
    observer = Scanned(Known(scene), scene, None, np.random.default_rng(seed))
    report = verify_execution(Executor(scene, observer).run(3 * scene.duration))
    assert report.clearance_min >= 0
    assert report.end_error <= 1e-3
    assert report.distance_error_max <= 1e-9


def test_the_same_clouds_give_the_same_execution():
    scene = moving_scene(4)
    first, second = (
        Executor(scene, Scanned(Known(scene), scene, None, np.random.default_rng(5))).run(2.0)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.center, second.center)
