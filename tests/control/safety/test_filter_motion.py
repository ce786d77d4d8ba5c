"""The safety filter step by step: nothing is touched that can be avoided, and no limit is exceeded.

Clearances are those of plain NumPy along the whole load, from the scene's file.
"""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from benchmarks.random_scenes import moving_scene
from comove.control.safety.cbf_qp import SafetyFilter
from comove.control.safety.twists import nodes_of, poses_of
from tests.cases import examples

from .moving import World, run, scene_of

seeds = st.integers(0, 2**32 - 1)
ROUND = 1e-7
STILL = {
    "disc": {"shape": "circle", "radius": 0.15},
    "small disc": {"shape": "circle", "radius": 0.01},
    "box": {"shape": "box", "size": [0.3, 0.2], "rotation_deg": 20.0},
    "wall": {"shape": "box", "size": [0.1, 2.0]},
    "capsule": {"shape": "capsule", "radius": 0.05, "length": 0.3, "rotation_deg": 70.0},
    "ellipse": {"shape": "ellipse", "radii": [0.1, 0.3], "rotation_deg": 30.0},
}
SOLID = {
    "ball": {"shape": "sphere", "radius": 0.15},
    "box": {"shape": "box", "size": [0.3, 0.2, 0.4], "quaternion_wxyz": [0.9238795, 0.0, 0.3826834, 0.0]},
    "wall": {"shape": "box", "size": [0.1, 2.0, 2.0]},
    "capsule": {"shape": "capsule", "radius": 0.05, "length": 0.3},
    "cylinder": {"shape": "cylinder", "radius": 0.1, "height": 0.3},
    "ellipsoid": {"shape": "ellipsoid", "radii": [0.1, 0.3, 0.2]},
}


def towards(target, turning=0.0):
    """Drive the hands at a point with full speed, and turn the load meanwhile."""

    def wanted(i, nodes):
        hands = nodes[:2]
        way = np.asarray(target) - hands.mean(axis=0)
        spin = turning * np.cross([0.0, 0.0, 1.0], hands - hands.mean(axis=0))
        return 2.0 * way / max(np.linalg.norm(way), 1e-9) + spin

    return wanted


@pytest.mark.parametrize("shape", STILL)
@pytest.mark.parametrize("acceleration", [2.0, None])
@pytest.mark.parametrize("turning", [0.0, 4.0])
@pytest.mark.few(5)
def test_a_bar_driven_at_an_obstacle_never_touches_it(shape, acceleration, turning):
    scene = scene_of([STILL[shape] | {"center": [3.0, 2.05]}], limits={"acceleration": acceleration})
    found = run(World(scene), towards([3.0, 2.05, 0.0], turning), 1500)
    assert found.clearance > 0.0
    assert found.relaxed < 0.01
    assert found.speed <= 1.0 + ROUND
    if acceleration:
        assert found.acceleration <= acceleration * (1 + ROUND)
    if not turning:  # it got there
        assert World(scene).clearance(nodes_of(scene, found.poses)) < 0.02


@pytest.mark.parametrize("acceleration", [2.0, None])
@pytest.mark.parametrize("shape", SOLID)
@pytest.mark.few(3)
def test_nor_in_space(shape, acceleration):
    scene = scene_of(
        [SOLID[shape] | {"center": [3.0, 2.05, 2.1]}], spatial=True, limits={"acceleration": acceleration}
    )
    found = run(World(scene), towards([3.0, 2.05, 2.1], 3.0), 1500)
    assert found.clearance > 0.0
    assert found.relaxed < 0.01
    assert found.speed <= 1.0 + ROUND
    if acceleration:
        assert found.acceleration <= acceleration * (1 + ROUND)


@pytest.mark.parametrize(
    ("load", "spatial", "more"),
    [
        ("overhang", False, {}),
        ("polygon", False, {}),
        ("frame", True, {}),
        ("two bodies", False, {}),
        ("box", True, {"constraints": [{"type": "upright"}]}),
    ],
)
@pytest.mark.parametrize("acceleration", [2.0, None])
@pytest.mark.few(3)
def test_other_loads_driven_about_touch_nothing(load, spatial, more, acceleration):
    """Wanted velocities that no load could have, changing every second, among obstacles."""
    z = [2.1] if spatial else []
    extra = [[2.6, 2.1, *z], [1.5, 1.6, *z], [2.0, 2.7, *z]]
    shapes = [
        SOLID[s] if spatial else STILL[t] for s, t in (("box", "box"), ("ball", "disc"), ("capsule",) * 2)
    ]
    scene = scene_of(
        [s | {"center": c} for s, c in zip(shapes, extra, strict=True)],
        load=load,
        spatial=spatial,
        limits={"acceleration": acceleration, "clearance": 0.005},
        **more,
    )
    rng = np.random.default_rng(0)
    drives = rng.standard_normal((15, 1, 3)) + 0.7 * rng.standard_normal((15, len(scene.manipulators), 3))
    drives[:, :, 2] *= spatial
    found = run(World(scene), lambda i, nodes: drives[i // 100], 1500)
    assert found.clearance >= 0.005
    assert found.relaxed < 0.02
    assert found.speed <= 1.0 + ROUND
    if acceleration:
        assert found.acceleration <= acceleration * (1 + ROUND)


@examples(15)
@given(seeds, st.sampled_from([2, 3]))
@example(54, 2)
@example(5, 3)
def test_limits_hold_in_every_step(seed, n_hands):
    """Loads that spin among moving obstacles: no command exceeds a limit, even where obstacles hit them."""
    rng = np.random.default_rng(seed)
    scene = moving_scene(int(rng.integers(1000)) * 4 + 2 * (n_hands - 2))  # in the plane
    drives = rng.standard_normal((16, 6)) * [0.3, 0.3, 0.0, 0.0, 0.0, 20.0]
    velocity = scene.obstacle_velocities(np.zeros(1))[0][scene.owners]

    def wanted(i, nodes):
        arms = nodes[:n_hands] - nodes[:n_hands].mean(axis=0)
        return drives[i // 25, :3] + np.cross(drives[i // 25, 3:], arms)

    found = run(World(scene, velocity), wanted, 400, look=1000)
    assert found.speed <= scene.speed_limit * (1 + ROUND)
    assert found.acceleration <= scene.acceleration_limit * (1 + ROUND)


@examples(25)
@given(seeds, st.sampled_from([None, 1.0, 4.0]))
def test_random_drives_among_random_obstacles(seed, acceleration):
    """Whatever is wanted: no touch, limits kept."""
    rng = np.random.default_rng(seed)
    obstacles = []
    while len(obstacles) < 4:
        shape = dict(list(STILL.values())[rng.integers(len(STILL))])
        shape["center"] = rng.uniform(0.3, 1.7, 2).tolist()
        try:
            scene = scene_of([*obstacles, shape], side=2.0, limits={"acceleration": acceleration})
        except Exception:
            continue
        obstacles.append(shape)
    drives = rng.standard_normal((6, 1, 3)) + 0.7 * rng.standard_normal((6, 2, 3))
    drives[..., 2] = 0.0
    found = run(World(scene), lambda i, nodes: drives[i // 50], 300)
    assert found.clearance > 0.0
    assert found.relaxed < 0.05
    assert found.speed <= 1.0 + ROUND
    if acceleration:
        assert found.acceleration <= acceleration * (1 + ROUND)


@pytest.mark.parametrize("acceleration", [None, 5.0, 2.0])
@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.few(4)
def test_what_comes_at_nine_tenths_of_the_speed_limit_is_met(acceleration, spatial, turn):
    """At a bar at rest in the open, that wants to stay where it is."""
    z = [10.0] if spatial else []
    shape = dict((SOLID if spatial else STILL)["box"])
    scene = scene_of(
        [shape | {"center": [8.0, 10.02, *z]}],
        side=20.0,
        spatial=spatial,
        limits={"acceleration": acceleration},
    )
    velocity = [[0.9 * np.cos(turn * 0.02), 0.9 * np.sin(turn * 0.02), 0.0]]
    found = run(World(scene, velocity), np.zeros((2, 3)), 800)
    assert found.clearance > 0.0
    assert found.relaxed < 0.01
    assert found.speed <= 1.0 + ROUND
    if acceleration:
        assert found.acceleration <= acceleration * (1 + ROUND)


@pytest.mark.parametrize("acceleration", [None, 2.0])
def test_what_closes_in_from_both_sides_and_stops_does_not_touch(acceleration):
    """Two boxes, at different speeds, until 1 cm is left on either side of the bar."""
    walls = [{"shape": "box", "center": [x, 2.0], "size": [0.2, 1.0]} for x in (1.5, 2.7)]
    scene = scene_of(walls, limits={"acceleration": acceleration})
    world = World(scene, [[0.2, 0, 0], [-0.3, 0, 0]])

    def wanted(i, nodes):
        gap = world.center[1, 0] - world.center[0, 0] - 0.2 - 0.02
        if gap <= 0.02:
            world.velocity[:] = 0.0
        return np.zeros((2, 3))

    found = run(world, wanted, 500)
    assert not world.velocity.any()
    assert found.clearance > 0.0


@pytest.mark.parametrize("spatial", [False, True])
@pytest.mark.parametrize("rate", [-2.0, 1.0, 3.0])
@pytest.mark.few(2)
def test_a_spinning_box_pushes_the_bar_away(spatial, rate):
    """A long blade sweeps over where the bar wants to be."""
    z = [2.0] if spatial else []
    blade = {"shape": "box", "center": [2.5, 2.0, *z], "size": [0.05, 0.7] + [0.3] * spatial}
    scene = scene_of([blade], spatial=spatial, limits={"speed": 3.0})
    found = run(World(scene, spin=[[0.0, 0.0, rate]]), towards([2.3, 2.0, *(z or [0.0])]), 1500, look=1)
    assert found.clearance > 0.0
    assert found.n_relaxed == 0


@pytest.mark.parametrize("rate", [2.0, 4.0])
def test_a_blade_that_turns_far_in_a_step_is_met_by_a_box(rate):
    """By up to 5 degrees: its tip's path bends."""
    blade = {"shape": "box", "center": [2.55, 2.0, 2.0], "size": [0.05, 0.5, 0.3]}
    upright = [{"type": "upright"}]
    scene = scene_of([blade], load="box", spatial=True, limits={"speed": 6.0}, constraints=upright)
    world = World(scene, spin=[[0.0, 0.0, rate]])
    found = run(world, towards([2.4, 2.0, 2.0]), 600, period=0.02, look=1)
    assert found.clearance > 0.0
    assert found.n_relaxed == 0


def test_two_bodies_keep_apart():
    """A free hand and a load, driven at each other, in the order of the scene and the other way round."""
    apart = [{"type": "separation", "between": ["left", "third"], "distance": 0.2}]
    for acceleration in (None, 2.0):
        scene = scene_of(load="two bodies", constraints=apart, limits={"acceleration": acceleration})
        seen = []

        def wanted(i, nodes, seen=seen):
            seen.append(np.linalg.norm(nodes[0] - nodes[2]))
            return np.stack([nodes[2] - nodes[0]] * 2 + [nodes[0] - nodes[2]]) * 5.0

        found = run(World(scene), wanted, 600)
        assert 0.2 < min(seen) < 0.21
        assert found.relaxed < 0.01


def test_upright_loads_keep_their_tilt():
    scene = scene_of(
        [SOLID["ball"] | {"center": [2.6, 2.1, 2.0]}],
        load="box",
        spatial=True,
        constraints=[{"type": "upright"}],
    )
    rng = np.random.default_rng(2)
    drives = rng.standard_normal((10, 2, 3))
    found = run(World(scene), lambda i, nodes: drives[i // 100], 1000)
    first, last = (nodes_of(scene, p) for p in (poses_of(scene, "start"), found.poses))
    corners = scene.body.solids[0]
    up = [(n[corners[4]] - n[corners[0]]) / 0.1 for n in (first, last)]
    np.testing.assert_allclose(up[0], up[1], atol=1e-14)
    assert found.clearance > 0.0


@pytest.mark.parametrize("period", [0.001, 0.02])
def test_other_periods(period):
    scene = scene_of([STILL["box"] | {"center": [2.6, 2.05]}], limits={"acceleration": 3.0})
    found = run(World(scene), towards([2.6, 2.05, 0.0], 4.0), int(3 / period), period=period)
    assert found.clearance > 0.0
    assert found.acceleration <= 3.0 * (1 + ROUND)


@pytest.mark.parametrize("load", ["bar", "box"])
@pytest.mark.few(1)
def test_points_looked_at_before_a_step_alone_would_not_do(load):
    """A load sweeps over a needle's tip at high speed: what bends within a step is seen."""
    solid = load == "box"
    z = [2.0] if solid else []
    needle = {"shape": "box", "center": [2.3, 2.07, *z], "size": [0.2, 0.001, 0.5][: 2 + solid]}
    upright = {"constraints": [{"type": "upright"}]} if solid else {}
    scene = scene_of([needle], load=load, spatial=solid, limits={"speed": 3.0}, **upright)

    def wanted(i, nodes):
        hands = nodes[:2]
        spin = 12.0 * np.sin(i / 15) * np.cross([0.0, 0.0, 1.0], hands - hands.mean(axis=0))
        return np.array([1.0, 0.5 * np.sin(i / 40), 0.0]) + spin

    found = run(World(scene), wanted, 1500, period=0.02, look=1)
    assert found.clearance > 0.0
    assert found.n_relaxed == 0


def test_a_narrow_wedge_is_entered_only_as_fast_as_one_can_stop():
    """Both walls are approached slowly at any speed into the wedge; braking must begin all the same."""
    slope = np.deg2rad(6.0)
    walls = [
        {
            "shape": "box",
            "center": [2.9, 1.8 + side * 0.6 * np.sin(slope)],
            "size": [1.4, 0.02],
            "rotation_deg": -side * 6.0,
        }
        for side in (-1, 1)
    ]
    scene = scene_of(walls, load="hands", limits={"acceleration": 1.0})
    wanted = np.array([[2.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3])
    found = run(World(scene), wanted, 600, look=1)
    assert found.clearance > 0.0
    assert found.relaxed < 0.01
    assert nodes_of(scene, found.poses)[0, 0] > 3.0  # it went in


def test_margins_give_way_before_what_is_certain():
    """Too fast before a wall the load brakes as hard as it can, whatever may be close behind."""
    wall = {"shape": "box", "center": [2.51, 2.0], "size": [0.2, 2.0]}
    disc = {"shape": "circle", "center": [1.5, 2.0], "radius": 0.1}
    scene = scene_of([wall, disc], limits={"acceleration": 2.0})
    world, before = World(scene, velocity=[[0.0] * 3, [0.9, 0.0, 0.0]]), np.tile([0.9, 0.0, 0.0], (2, 1))
    sighting = world.sighting()
    sighting.margin[1] = 0.5
    allowed = SafetyFilter(scene).allowed(poses_of(scene, "start"), before, before, sighting)
    assert allowed.twists[0, 0] == pytest.approx(0.9 - 0.02, abs=1e-3)
