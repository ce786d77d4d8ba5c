"""Hands that hold a load keep their tilt and turn with it, whatever the load does."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning
from comove.model import Scene
from comove.model.constraints import UprightConstraint
from comove.model.coordinates import ANGLE, load_coordinates
from tests.cases import examples

from .test_scene import BAR, quiet, refused, scene_of

ANGLES = st.floats(-7.0, 7.0)


def stick(psi=0.0, tilt=0.0):
    """Both hands (2, 3) of a stick of 0.2 m whose heading is psi, tilted, about (0.5, 0.5, 0.5)."""
    along = np.array([np.cos(tilt) * np.cos(psi), np.cos(tilt) * np.sin(psi), np.sin(tilt)])
    return 0.5 + 0.1 * np.stack([along, -along])


def held(**grasp):
    return quiet(scene_of(stick(), stick(1.0), load=BAR, grasp=grasp))


def rotations(grasp, psi):
    """What the grasp says of a stick of heading psi, as rotations of SciPy, one a hand."""
    return [Rotation.from_matrix(matrix) for matrix in grasp.hand_rotations(stick(psi))]


@given(psi=ANGLES, tilt=st.floats(-1.5, 1.5))
def test_the_heading_points_from_the_second_holder_to_the_first(psi, tilt):
    swapped = quiet(scene_of(stick(), stick(1.0), load={**BAR, "held_by": ["b", "a"]}, grasp={}))
    for grasp, beyond in ((held().grasp, 0.0), (swapped.grasp, np.pi)):
        turn = Rotation.from_rotvec([0.0, 0.0, psi + beyond]).as_matrix()
        for hand in grasp.hand_rotations(stick(psi, tilt)):
            np.testing.assert_allclose(hand, turn @ np.diag([-1.0, 1.0, -1.0]), atol=1e-9)


def test_the_spin_of_a_load_is_how_its_hands_turn():
    grasp, hands, rng = held().grasp, stick(0.7, 0.3), np.random.default_rng(0)
    velocities, step = rng.standard_normal((2, 3, 4)), 1e-6
    ahead, behind = (grasp.hand_rotations(hands + t * np.moveaxis(velocities, -1, 0)) for t in (step, -step))
    turns = Rotation.from_matrix((ahead @ behind.swapaxes(-1, -2))[:, 0]).as_rotvec()
    np.testing.assert_allclose(grasp.spins(hands, velocities), turns.T / (2 * step), atol=1e-7)


def test_down_is_down_and_yaws_with_the_stick():
    """At heading 0 the frame is diag(-1, 1, -1); its z axis, the approach, always points down."""
    grasp = held(orientation="down", yaw="load").grasp
    assert np.array_equal(grasp.hand_rotations(stick()), [np.diag([-1.0, 1.0, -1.0])] * 2)
    for hand in grasp.hand_rotations(stick(0.7)):
        assert np.allclose(hand[:, 2], [0, 0, -1], atol=1e-15)
        assert np.allclose(hand[:, 1], [-np.sin(0.7), np.cos(0.7), 0])  # the fingers open across the stick


def test_forward_is_along_the_heading_with_fingers_that_open_upwards():
    grasp = held(orientation="forward").grasp
    for psi in (0.0, 0.7, -2.0):
        for hand in grasp.hand_rotations(stick(psi)):
            assert np.allclose(hand[:, 2], [np.cos(psi), np.sin(psi), 0.0], atol=1e-14)
            assert np.allclose(hand[:, 1], [0.0, 0.0, 1.0], atol=1e-14)
            assert np.isclose(np.linalg.det(hand), 1.0)


def test_what_a_scene_leaves_open_is_one_of_its_alternatives():
    scene = held(any_of=[{"orientation": "down"}, {"orientation": "forward", "offset_deg": 90}])
    first, second = scene.alternatives
    assert np.array_equal(scene.grasp.at_rest, first.grasp.at_rest)
    same = held(orientation="forward", offset_deg=90)
    assert np.array_equal(second.grasp.at_rest, same.grasp.at_rest)
    assert second.sha256 == same.sha256  # chosen, it is the scene that says so
    assert same.alternatives == (same,)
    assert len({scene.sha256, first.sha256, second.sha256}) == 3


def test_a_free_yaw_is_any_multiple_of_45_degrees_for_all_or_one_against_the_others():
    turned = [
        [np.rad2deg(np.arctan2(hand[1, 2], hand[0, 2])) for hand in choice.grasp.at_rest]
        for choice in held(orientation="forward", yaw="free").alternatives
    ]
    found = {tuple((np.round(angles).astype(int) % 360).tolist()) for angles in turned}
    steps = range(0, 360, 45)
    assert found == {(a, a) for a in steps} | {(a, -a % 360) for a in steps}
    assert len(found) == len(turned)


@given(psi=ANGLES, vector=st.tuples(*[st.floats(-3, 3)] * 3), offset=st.floats(-400, 400))
def test_a_hand_turns_about_the_vertical_by_heading_and_offset(psi, vector, offset):
    at_rest = Rotation.from_rotvec(vector)
    x, y, z, w = at_rest.as_quat()
    grasp = held(quaternion_wxyz=[w, x, y, z], offset_deg={"b": offset}).grasp
    first, second = rotations(grasp, psi)
    assert (first * (Rotation.from_euler("z", psi) * at_rest).inv()).magnitude() < 1e-9
    both = Rotation.from_euler("z", psi + np.deg2rad(offset))
    assert (second * (both * at_rest).inv()).magnitude() < 1e-9


def test_one_offset_serves_all_hands():
    one, each = held(offset_deg=30.0).grasp, held(offset_deg={"a": 30.0, "b": 30.0}).grasp
    assert np.array_equal(one.at_rest, each.at_rest)
    assert np.allclose(one.at_rest[0, :, 1], [-np.sin(np.pi / 6), np.cos(np.pi / 6), 0])


def test_many_instants_at_once():
    """Any leading axes; the same as one by one, and rotations throughout."""
    grasp = held(offset_deg=10.0).grasp
    hands = np.random.default_rng(0).normal(size=(4, 5, 2, 3))
    all_at_once = grasp.hand_rotations(hands)
    assert all_at_once.shape == (4, 5, 2, 3, 3)
    assert grasp.spins(hands, np.zeros((*hands.shape, 7))).shape == (4, 5, 3, 7)
    assert np.array_equal(all_at_once[2, 3], grasp.hand_rotations(hands[2, 3]))
    assert np.allclose(all_at_once @ np.swapaxes(all_at_once, -1, -2), np.eye(3), atol=1e-14)
    assert np.allclose(np.linalg.det(all_at_once), 1.0)


@examples(30)
@given(seed=st.integers(0, 10**6))
def test_hands_are_one_rigid_body_with_the_load(seed):
    """Between any two configurations all hands turn by what the load's block turns by."""
    rng = np.random.default_rng(seed)
    scene = held(offset_deg={"a": 20.0})
    coordinates = load_coordinates(scene)
    assert coordinates.parts[0].kind == ANGLE
    q = rng.uniform(0.0, 3.0, (2, 4))
    hands = coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
    first, second = scene.grasp.hand_rotations(hands)
    turn = Rotation.from_euler("z", q[1, 3] - q[0, 3])
    for a, b in zip(first, second, strict=True):
        assert (Rotation.from_matrix(b) * Rotation.from_matrix(a).inv() * turn.inv()).magnitude() < 1e-9


def test_a_grasp_keeps_the_load_upright():
    """Unless the file says so itself, with its own tolerance."""
    (upright,) = (c for c in held().constraints if isinstance(c, UprightConstraint))
    assert upright == UprightConstraint((0, 1), pytest.approx(np.deg2rad(0.1)))
    data = scene_of(stick(), stick(1.0), load=BAR, grasp={})
    scene = quiet(data | {"constraints": [{"type": "upright", "tolerance_deg": 2.0}]})
    assert [c.tolerance for c in scene.constraints if isinstance(c, UprightConstraint)] == [np.deg2rad(2.0)]
    tilted = refused(scene_of(stick(), stick(1.0, 0.05), load=BAR, grasp={}))
    assert "tilted by 2.86 deg at the goal" in tilted.message
    assert "as grasp implies" in tilted.message
    assert "type: upright" in tilted.way_out
    assert quiet(scene_of(stick(), stick(1.0), load=BAR)).grasp is None


def test_only_who_goes_along_with_the_load_turns():
    """A free hand keeps its orientation; one tied to a holder turns with the load."""
    hands = np.concatenate([stick(), [[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]]])
    goal = np.concatenate([stick(), hands[2:]])
    scene = quiet(
        scene_of(
            hands,
            goal,
            load={**BAR, "held_by": ["a", "b"]},
            grasp={},
            constraints=[{"type": "relative_pose", "between": ["a", "d"]}],
        )
    )
    assert scene.grasp.turning.tolist() == [True, True, False, True]
    moved = np.concatenate([stick(0.5), hands[2:]])
    turned = scene.grasp.hand_rotations(moved)
    assert np.array_equal(turned[2], scene.grasp.at_rest[2])
    assert np.array_equal(turned[3], turned[0])


def test_a_load_on_end_has_no_heading():
    hands = [[0.5, 0.5, 0.6], [0.5, 0.5, 0.4]]
    error = refused(scene_of(hands, np.add(hands, [0.2, 0, 0]), load=BAR, grasp={}))
    assert "'a' and 'b' hold the load one above the other" in error.message
    assert "move one of them aside" in error.way_out
    third = [*hands, [0.6, 0.5, 0.6]]
    frame = {"shape": "frame", "edges": [["a", "b"], ["b", "c"]]}
    scene = quiet(scene_of(third, third, load=frame | {"held_by": ["c", "b", "a"]}, grasp={}))
    np.testing.assert_allclose(
        scene.grasp.hand_rotations(scene.start)[0], np.diag([-1.0, 1.0, -1.0]), atol=1e-12
    )


@pytest.mark.parametrize(
    ("grasp", "key", "message", "way_out"),
    [
        ({"orientation": "up"}, "grasp.orientation", "'up' is not known", "'down'"),
        ({"yaw": "fre"}, "grasp.yaw", "'fre' is not known", "'free'"),
        ({"orientaton": "down"}, "grasp.orientaton", "unknown key", "'orientation'?"),
        ("down", "grasp", "'down' is not a mapping", "'key: value'"),
        (
            {"orientation": "down", "quaternion_wxyz": [0, 1, 0, 0]},
            "grasp",
            "both orientation and quaternion_wxyz",
            "one of the two",
        ),
        ({"quaternion_wxyz": [0, 1, 0, 1]}, "grasp.quaternion_wxyz", "the norm 1.41", "w first"),
        ({"offset_deg": "left"}, "grasp.offset_deg", "'left' is not a number", "plain number"),
        ({"offset_deg": {"a": "x"}}, "grasp.offset_deg.a", "'x' is not a number", "plain number"),
        ({"offset_deg": {"left": 3}}, "grasp.offset_deg.left", "no manipulator 'left'", "a, b"),
        ({"offset_deg": np.nan}, "grasp.offset_deg", "nan is not a finite number", "plain number"),
        ({"any_of": []}, "grasp.any_of", "the list has 0 entries", ""),
        (
            {"any_of": [{"offset_deg": {"c": 1}}]},
            "grasp.any_of[0].offset_deg.c",
            "no manipulator 'c'",
            "a, b",
        ),
        ({"any_of": [{"any_of": [{}]}]}, "grasp.any_of[0].any_of", "unknown key", ""),
    ],
)
def test_what_is_wrong_with_a_grasp(grasp, key, message, way_out):
    error = refused(scene_of(stick(), stick(1.0), load=BAR, grasp=grasp))
    assert error.key == key
    assert message in error.message
    assert way_out in error.way_out


def test_a_grasp_needs_space_and_a_load():
    flat = refused(scene_of([[0, 0], [0.2, 0]], [[1, 0], [1.2, 0]], load=BAR, grasp={}))
    assert (flat.key, flat.way_out) == ("grasp", "leave grasp out")
    assert "the scene is planar" in flat.message
    empty = refused(scene_of(stick(), stick(1.0), grasp={}))
    assert (empty.key, empty.way_out) == ("grasp", "add a load, or leave grasp out")


def test_a_robot_is_named_in_words():
    data = scene_of(stick(), stick(1.0), load=BAR | {"mass": 0.5})
    assert quiet(data | {"robot": "baxter"}).file.robot == "baxter"
    for wrong in ({"model": "baxter"}, 7, "", "a\nb"):
        assert refused(data | {"robot": wrong}).key == "robot"


def test_the_checksum_is_of_what_is_meant():
    """What stands for the default does not change it; another way of holding does."""
    data = scene_of(stick(), stick(1.0), load=BAR)
    plain = quiet(data | {"grasp": {}}).sha256
    assert quiet(data | {"grasp": {"orientation": "down", "yaw": "load", "offset_deg": 0}}).sha256 == plain
    others = [{"offset_deg": 1}, {"quaternion_wxyz": [0, 0, 1, 0]}]
    sums = {plain, quiet(data).sha256, *(quiet(data | {"grasp": grasp}).sha256 for grasp in others)}
    assert len(sums) == 4
    with warnings.catch_warnings():
        warnings.simplefilter("error", ComoveWarning)
        Scene.from_dict({**data, "grasp": None})
