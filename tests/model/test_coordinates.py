"""Whatever q is, distances hold; derivatives are true; hands give q back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import OptionError
from comove.geometry.rotations import quaternion_of_rotation, quaternion_product
from comove.model import Scene, arms_coordinates, load_coordinates, projected_coordinates
from comove.model.blocks import ANGLE, POINT, QUATERNION, place_one, unit_motion
from tests.cases import examples

from .examples import (
    LEVEL,
    MIXED,
    PLANAR_BAR,
    PLANAR_TRAY,
    POLYGON,
    POSE,
    SCENES,
    SPATIAL_BAR,
    SPATIAL_TRIANGLE,
    TRAY,
    TRIANGLE,
    configurations,
    scene_of,
)

seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(sorted(SCENES))


def coordinates_of(name):
    scene, make = SCENES[name]
    return make(scene)


@examples(150)
@given(names, seeds, st.floats(0.01, 100))
def test_distances_hold_whatever_the_configuration(name, seed, spread):
    """Between all points of a group, corners included, to rounding of the positions."""
    coordinates = coordinates_of(name)
    q = configurations(coordinates, np.random.default_rng(seed), 5, spread)
    nodes = coordinates.nodes(q.T[None])[0]
    blocks = coordinates.blocks
    rounding = 1e-15 * max(1.0, np.abs(nodes).max())
    for b, group in enumerate(coordinates.groups):
        own = nodes[:, blocks.node[blocks.first[b] : blocks.first[b + 1]]]
        apart = np.linalg.norm(own[:, :, None] - own[:, None], axis=3)
        true = np.linalg.norm(group.points[:, None] - group.points[None], axis=2)
        assert np.abs(apart - true).max() <= 2 * rounding
        assert np.array_equal(
            blocks.node[blocks.first[b] : blocks.first[b] + len(group.members)], group.members
        )


@examples(60)
@given(names, seeds)
def test_no_group_is_mirrored(name, seed):
    coordinates = coordinates_of(name)
    (q,) = configurations(coordinates, np.random.default_rng(seed), 1)
    nodes, blocks = coordinates.nodes(q[None, :, None])[0, 0], coordinates.blocks
    for b, group in enumerate(coordinates.groups):
        own = nodes[blocks.node[blocks.first[b] : blocks.first[b + 1]]]
        if group.orientation == "plane" and len(own) > 2:
            signed = [np.cross(x[1] - x[0], x[2] - x[0])[2] for x in (own, group.points)]
            assert signed[0] == pytest.approx(signed[1], abs=1e-12)
    if coordinates.n_dims == 2:
        assert not nodes[:, 2].any()


def test_a_tetrahedron_is_not_mirrored():
    held = np.vstack([TRIANGLE, [0.1, 0.05, 0.15]])
    edges = [["a", "b"], ["b", "c"], ["c", "d"]]
    coordinates = load_coordinates(scene_of(held, held + 1.0, load={"shape": "frame", "edges": edges}))
    q = configurations(coordinates, np.random.default_rng(0), 20)
    for nodes in coordinates.nodes(q.T[None])[0]:
        volume = np.linalg.det(nodes[1:] - nodes[0])
        assert volume == pytest.approx(np.linalg.det(held[1:] - held[0]), rel=1e-12)


@examples(60)
@given(names, seeds)
def test_motion_and_nodes_agree(name, seed):
    """The kernel and the array version are written apart: they place the nodes alike."""
    coordinates, rng = coordinates_of(name), np.random.default_rng(seed)
    q = configurations(coordinates, rng, 6)
    nodes = coordinates.nodes(q.T[None])[0]
    motion = coordinates.motion(np.stack([q, *rng.standard_normal((2, *q.shape))]))
    assert np.abs(motion[0] - nodes).max() < 1e-14
    single = np.zeros_like(nodes[0])
    place_one(coordinates.blocks, q[0], 1.0, single)
    assert np.array_equal(single, nodes[0])


@examples(60)
@given(names, seeds)
def test_derivatives_along_a_parabola(name, seed):
    """q(t) = q0 + t q1 + t^2/2 q2: central differences of the nodes."""
    coordinates, rng = coordinates_of(name), np.random.default_rng(seed)
    q = np.stack(
        [configurations(coordinates, rng, 4), *0.3 * rng.standard_normal((2, 4, coordinates.n_columns))]
    )
    _, velocity, acceleration = coordinates.motion(q)

    def nodes(t):
        return coordinates.nodes((q[0] + t * q[1] + t**2 / 2 * q[2]).T[None])[0]

    h = 1e-3
    first = (8 * (nodes(h) - nodes(-h)) - (nodes(2 * h) - nodes(-2 * h))) / (12 * h)
    second = (16 * (nodes(h) + nodes(-h)) - (nodes(2 * h) + nodes(-2 * h)) - 30 * nodes(0)) / (12 * h**2)
    assert np.abs(first - velocity).max() < 1e-7 * (1 + np.abs(velocity).max())
    assert np.abs(second - acceleration).max() < 1e-5 * (1 + np.abs(acceleration).max())


@examples(30)
@given(names, seeds, st.floats(0.0, 1.5))
def test_size_scales_the_groups_about_their_centres(name, seed, size):
    coordinates = coordinates_of(name)
    q = configurations(coordinates, np.random.default_rng(seed), 3).T[None]
    whole, point = coordinates.nodes(q), coordinates.nodes(q, 0.0)
    assert np.abs(coordinates.nodes(q, size) - point - size * (whole - point)).max() < 1e-14


@examples(60)
@given(names, seeds, st.integers(-3, 3))
def test_hands_give_the_configuration_back(name, seed, turns):
    """Along a movement that turns several times: the same nodes, and no jump in q."""
    coordinates, rng = coordinates_of(name), np.random.default_rng(seed)
    t = np.linspace(0, 1, 200)[:, None]
    q = rng.standard_normal(coordinates.n_columns) + t * rng.standard_normal(coordinates.n_columns)
    for kind, columns, *_ in coordinates.parts:
        if kind == POINT:
            continue
        turn, width = columns.start + coordinates.n_dims, columns.stop - columns.start - coordinates.n_dims
        if width == 1:
            q[:, turn] += 2 * np.pi * turns * t[:, 0]
        else:
            angle = np.pi * turns * t if kind == QUATERNION else 2 * np.pi * turns * t
            q[:, turn : turn + 2] = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
            q[:, turn + 2 : columns.stop] = 0.3
    hands = coordinates.nodes(q.T[None])[0][:, : sum(len(g.members) for g in coordinates.groups)]
    back = coordinates.from_hands(hands[:, :, : coordinates.n_dims])
    n_hands = hands.shape[1]
    assert np.abs(coordinates.nodes(back.T[None])[0][:, :n_hands] - hands).max() < 1e-12
    assert np.abs(np.diff(back, axis=0)).max() < 0.3
    for kind, columns, *_ in coordinates.parts:
        if kind == ANGLE:  # it keeps its turns
            own = q[:, columns.stop - 1], back[:, columns.stop - 1]
            assert np.abs(np.subtract(*own) - np.subtract(*own)[0]).max() < 1e-9


@examples(60)
@given(seeds, st.sampled_from([PLANAR_BAR, SPATIAL_BAR]))
def test_the_nearest_bar_to_free_hands(seed, scene):
    """Middle -/+ half the length along the line between them: nothing nearer holds the distance."""
    hands = np.random.default_rng(seed).uniform(-1, 1, (4, 2, scene.n_dims))
    middle, apart = hands.mean(axis=1), hands[:, 1] - hands[:, 0]
    along = 0.1 * apart / np.linalg.norm(apart, axis=1, keepdims=True)
    expected = np.stack([middle - along, middle + along], axis=1)
    loaded, projected = load_coordinates(scene), projected_coordinates(scene)
    for coordinates, q in (
        (projected, hands.reshape(4, -1) @ projected.search.T),
        (projected, projected.from_hands(hands)),
        (loaded, loaded.from_hands(hands)),
    ):
        nodes = coordinates.nodes(q.T[None])[0]
        assert np.abs(nodes[:, :2, : scene.n_dims] - expected).max() < 1e-13


@examples(40)
@given(seeds)
def test_planar_projection_of_three_hands_is_least_squares(seed):
    """The linear driver leads to the rigid triangle nearest to three free hands, any number of groups."""
    held = TRIANGLE[:, :2] - TRIANGLE[:, :2].mean(axis=0)
    edges = [["a", "b"], ["b", "c"], ["c", "a"]]
    scene = scene_of(held, held + 1.0, load={"shape": "frame", "edges": edges})
    coordinates = projected_coordinates(scene)
    hands = np.random.default_rng(seed).uniform(-1, 1, (1, 3, 2))
    driven = coordinates.nodes((hands.reshape(1, -1) @ coordinates.search.T).T[None])[0]
    nearest = load_coordinates(scene)
    nearest = nearest.nodes(nearest.from_hands(hands).T[None])[0]
    assert np.abs(driven - nearest).max() < 1e-12


@pytest.mark.parametrize("name", sorted(SCENES))
@pytest.mark.parametrize("turn", [-2, -1, 0, 1, 2])
def test_the_ends_are_those_of_the_scene_whatever_the_turn(name, turn):
    scene, make = SCENES[name]
    coordinates = make(scene)
    boundary = coordinates.boundary(turn)
    assert not boundary[[1, 3]].any()
    nodes = coordinates.nodes(boundary[[0, 2]].T[None])[0]
    for found, end in zip(nodes, ("start", "goal"), strict=True):
        assert np.abs(found - scene.nodes_at(end)).max() < 1e-14


@pytest.mark.parametrize("turn", [-2, -1, 0, 1, 3])
def test_a_turn_winds_an_angle(turn):
    """0 is the shorter way round; others add whole turns."""
    for scene in (PLANAR_BAR, POLYGON, MIXED):
        coordinates = load_coordinates(scene)
        boundary = coordinates.boundary(turn)
        for kind, columns, *_ in coordinates.parts:
            if kind == ANGLE:
                way = np.subtract(*boundary[[2, 0], columns.stop - 1])
                assert abs(way - 2 * np.pi * turn) <= np.pi + 1e-12


@pytest.mark.parametrize("turn", [-1, 0, 1, 2])
def test_a_turn_takes_the_other_sign_of_a_quaternion(turn):
    """Between q and -q lies a whole turn; even ones go the shorter way."""
    start, goal = load_coordinates(SPATIAL_TRIANGLE).boundary(turn)[[0, 2], 3:]
    assert (start @ goal < 0) == (turn % 2 == 1)


def test_load_configurations_rewritten():
    """Same nodes in other coordinates, for every scene that has both."""
    rng = np.random.default_rng(0)
    for scene in (PLANAR_BAR, SPATIAL_BAR, MIXED, POLYGON, PLANAR_TRAY, LEVEL):
        own = load_coordinates(scene)
        q = configurations(own, rng, 10)
        assert np.array_equal(own.from_load(q, own), q)
        if scene is POLYGON:
            continue
        other = projected_coordinates(scene)
        nodes = own.nodes(q.T[None]), other.nodes(other.from_load(q, own).T[None])
        assert np.abs(nodes[0] - nodes[1]).max() < 1e-14


def test_what_projection_does_not_serve():
    with pytest.raises(OptionError, match="two hands"):
        projected_coordinates(SPATIAL_TRIANGLE)
    with pytest.raises(OptionError, match="no relative poses"):
        projected_coordinates(POSE)
    with pytest.raises(OptionError, match="upright"):
        projected_coordinates(TRAY)
    with pytest.raises(OptionError, match="centred"):
        projected_coordinates(POLYGON)


def test_what_free_hands_do_not_serve():
    tilted = TRAY.file.model_dump(exclude_defaults=True)
    for end in ("start", "goal"):
        x, y, z = tilted["manipulators"][0][end]
        tilted["manipulators"][0][end] = (x, y, z + 1e-4)
    tilted["constraints"] = [{"type": "upright", "tolerance_deg": 20.0}]
    for scene, word in (
        (Scene.from_dict(tilted), "upright"),
        (PLANAR_TRAY, "upright"),
        (POSE, "relative pose"),
    ):
        with pytest.raises(OptionError, match=word):
            arms_coordinates(scene)


@given(seeds, st.floats(0.01, 100))
def test_free_hands_keep_a_level_load_level_whatever_the_configuration(seed, spread):
    coordinates = arms_coordinates(TRAY)
    n_hands = len(TRAY.manipulators)
    assert coordinates.n_columns == 2 * n_hands + 1
    q = np.random.default_rng(seed).normal(0.0, spread, (1, coordinates.n_columns, 5))
    heights = coordinates.nodes(q)[0, :, :n_hands, 2]
    assert (heights == heights[:, :1]).all()
    assert np.ptp(coordinates.nodes(q)[0, :, :n_hands, 0], axis=1).max() > 0


@examples(60)
@given(
    st.sampled_from(["upright", "upright bar", "planar upright", "planar upright projected"]),
    seeds,
    st.floats(0.01, 100),
)
def test_an_upright_load_keeps_its_tilt_whatever_the_configuration(name, seed, spread):
    """All its points, corners included, keep their heights relative to each other; in the plane all of it."""
    coordinates = coordinates_of(name)
    scene, _ = SCENES[name]
    q = configurations(coordinates, np.random.default_rng(seed), 5, spread)
    nodes, start = coordinates.nodes(q.T[None])[0], scene.nodes_at("start")
    kept = slice(2, 3) if coordinates.n_dims == 3 else slice(0, 2)
    own, first = (x - x[..., :1, :] for x in (nodes, start))
    assert np.abs((own - first)[..., kept]).max() <= 4e-15 * max(1.0, np.abs(nodes).max())


@examples(60)
@given(st.sampled_from(["level", "level projected", "planar level", "level arms"]), seeds)
def test_hands_at_one_height_are_there_whatever_the_configuration(name, seed):
    """Exactly, and the others go where they like."""
    coordinates = coordinates_of(name)
    scene, _ = SCENES[name]
    q = configurations(coordinates, np.random.default_rng(seed), 5)
    heights = coordinates.nodes(q.T[None])[0][..., scene.n_dims - 1]
    level = [0, 2, 3] if scene.n_dims == 3 else [0, 2]
    assert (heights[:, level] == heights[:, :1]).all()
    assert (heights[:, 1] != heights[:, 0]).all()
    assert coordinates.n_columns == heights.shape[1] * scene.n_dims - len(level) + 1


@examples(30)
@given(seeds)
def test_projection_onto_one_height_is_least_squares(seed):
    """Hands driven from free ones keep their places and meet at the mean of their heights."""
    coordinates = projected_coordinates(LEVEL)
    hands = np.random.default_rng(seed).uniform(-1, 1, (1, 4, 3))
    expected = hands.copy()
    expected[:, [0, 2, 3], 2] = hands[:, [0, 2, 3], 2].mean()
    for q in (hands.reshape(1, -1) @ coordinates.search.T, coordinates.from_hands(hands)):
        assert np.abs(coordinates.nodes(q.T[None])[0] - expected).max() < 1e-15


def test_a_relative_pose_follows_hands_with_the_least_roll():
    """Along a great circle no roll at all; the ends are those of the scene whatever the way between them."""
    coordinates = load_coordinates(POSE)
    ends = coordinates.boundary()[[0, 2]]
    angle = np.linspace(0.0, np.pi / 2, 300)
    along = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    hands = np.stack([-0.1 * along, 0.1 * along], axis=1)
    quaternions = coordinates.from_hands(hands)[:, 3:]
    assert abs(abs(quaternions[0] @ ends[0, 3:]) - 1) < 1e-12
    assert abs(abs(quaternions[-1] @ ends[1, 3:]) - 1) < 1e-12
    turned = 2 * np.arccos(np.abs((quaternions[1:] * quaternions[:-1]).sum(axis=1)))
    assert turned.sum() == pytest.approx(np.pi / 2, abs=1e-3)


@examples(50)
@given(seeds, st.sampled_from([2, 3, 4]))
def test_unit_motion(seed, width):
    """|u| = 1, so u.u' = 0 and u.u'' = -|u'|^2; and it is blind to the length of v."""
    v = np.random.default_rng(seed).standard_normal((3, 5, width)) + 3 * np.eye(3)[0][:, None, None]
    u, rate, change = unit_motion(v)
    assert np.allclose((u * u).sum(axis=1), 1, atol=1e-15)
    assert np.abs((u * rate).sum(axis=1)).max() < 1e-12
    assert np.allclose((u * change).sum(axis=1), -(rate**2).sum(axis=1), atol=1e-11)
    assert np.allclose(unit_motion(5 * v), [u, rate, change], atol=1e-12)


def test_quaternion_products():
    """i j = k, and the norm of a product is the product of the norms."""
    i, j, k = np.eye(4)[1:]
    assert np.array_equal(quaternion_product(i, j), k)
    assert np.array_equal(quaternion_product(j, i), -k)
    a, b = np.random.default_rng(0).standard_normal((2, 10, 4))
    norms = [np.linalg.norm(x, axis=1) for x in (quaternion_product(a, b), a, b)]
    assert np.allclose(norms[0], norms[1] * norms[2], rtol=1e-14)
    assert quaternion_of_rotation(np.eye(3)).tolist() == [1, 0, 0, 0]
